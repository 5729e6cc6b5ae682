"""Files of gains: what an engineer reads in them, and how commands take them."""

from pathlib import Path

import pytest

from hydro_agents.controllers.adrc import ADRC, ADRCGains
from hydro_agents.controllers.pid import PID, PIDGains
from hydro_agents.controllers.registry import controller_from_gains, gain_rows, gains_text
from hydro_agents.learning.opponents import found_in, opponent
from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.commands.export import _task_of_gains


def test_the_file_tells_each_gain_in_the_units_of_a_plc_and_reads_back_unchanged(tmp_path: Path) -> None:
    gains = PIDGains(proportional=20.0, integral=40.0, derivative=0.5, reference_lead=0.012, lead_in_integral=False)
    shown = {row.name: row.in_practice for row in gain_rows(gains)}
    # A command of 1 is 10 V: 20 /m are 200 V/m.
    assert shown["proportional"] == "0.2 V/mm"
    assert shown["integral"] == "0.4 V/(mm s)"
    assert shown["derivative"] == "5 V/(m/s)"
    assert shown["reference_lead"] == "12 ms"
    assert shown["lead_in_integral"] == ""
    file = tmp_path / "gains.yaml"
    file.write_text(gains_text(gains), encoding="utf-8")
    assert "proportional: 20.0  # 0.2 V/mm, on the error" in file.read_text(encoding="utf-8")
    assert PIDGains.from_yaml(file) == gains


def test_the_names_of_the_gains_tell_the_controller(tmp_path: Path) -> None:
    config, file = TaskConfig(), tmp_path / "mine.yaml"
    file.write_text("proportional: 12.0\n", encoding="utf-8")
    controller = opponent(str(file), config, "mine")
    assert isinstance(controller, PID)
    assert controller.gains == PIDGains(proportional=12.0)
    file.write_text(gains_text(ADRCGains()), encoding="utf-8")
    assert isinstance(controller_from_gains(file, config), ADRC)


@pytest.mark.parametrize("text", ["", "speed: 1.0\n", "proportional: 12.0\nspeed: 1.0\n"])
def test_gains_of_no_controller_are_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"mine\.yaml: must hold the gains of one controller \(pid, "):
        controller_from_gains(file, TaskConfig())


def test_a_wrong_gain_is_told_with_its_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("proportional: -1.0\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"mine\.yaml: pid: proportional = -1\.0"):
        controller_from_gains(file, TaskConfig())


def test_the_folder_of_a_controller_stands_for_its_weights_or_gains(tmp_path: Path) -> None:
    assert found_in(tmp_path) == str(tmp_path)
    (tmp_path / "gains.yaml").write_text("proportional: 12.0\n", encoding="utf-8")
    assert found_in(tmp_path) == str(tmp_path / "gains.yaml")
    (tmp_path / "policy.json").write_text("{}", encoding="utf-8")
    assert found_in(str(tmp_path)) == str(tmp_path / "policy")


def test_gains_without_a_study_are_not_exported_for_a_guessed_rig(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="gains belong to a rig"):
        _task_of_gains(tmp_path / "gains.yaml")


def test_gains_of_a_study_are_exported_for_its_rig(tmp_path: Path) -> None:
    (tmp_path / "tuned_study.yaml").write_text(
        "task: {plant: {cylinder: {stroke: 0.6}}}\ncontrollers: {PID: {kind: pid}}\nleakage_head: null\n",
        encoding="utf-8",
    )
    task = _task_of_gains(tmp_path / "controllers" / "PID" / "gains.yaml")
    assert task.plant.cylinder.stroke == 0.6
