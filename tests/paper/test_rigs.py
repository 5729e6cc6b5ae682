"""``hydro reproduce --rig``: places and commands of other rigs, pages, what a rig cannot do, wrong files."""

import re
from pathlib import Path

import pandas as pd
import pytest

from hydro_agents.commands.application import main
from hydro_agents.running.folders import config_folder, output_folder
from hydro_env import ConfigurationError, HydroError, PlantParameters
from hydro_env.plant.analysis import reachable_range
from paper import run as command
from paper.loop import closed_bode_table
from paper.moves import displacement_table
from paper.rig import Rig, own_rig, rig_from
from paper.settling import friction_scan_table, settling_table

RIGS = sorted((config_folder() / "rigs").glob("*.yaml"))


@pytest.mark.parametrize("file", RIGS, ids=lambda file: file.stem)
def test_places_lie_within_reach(file):
    rig = rig_from(file)
    low, high = reachable_range(rig.parameters)
    for place in (rig.start, rig.place):
        assert low < place < high
    table = displacement_table(rig)
    true = 1e-3 * table["true_position_mm"]
    assert low < true.min() < true.max() < high
    assert abs(table["command_v"]).max() == pytest.approx(rig.voltage)


def test_the_file_of_the_papers_rig_is_the_papers_rig():
    assert rig_from(next(file for file in RIGS if "kovari" in file.stem)) == rig_from(None) == Rig()


@pytest.fixture(scope="module")
def own_folder(tmp_path_factory, quick_figures):
    path = tmp_path_factory.mktemp("own_rig")
    file = next(file for file in RIGS if "symmetric" in file.stem)
    quick = [entry for entry in quick_figures if entry.key != "sensitivity"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "FIGURES", tuple(quick))
        command.reproduce_to_folder(path, overwrite=False, rig_file=file)
    return path


def test_a_figure_that_a_rig_cannot_do_is_said_in_its_place(own_folder):
    page = (own_folder / "page.html").read_text(encoding="utf-8")
    missing = {key for key in re.findall(r'<section id="(\w+)">', page) if not (own_folder / f"{key}.png").exists()}
    assert missing == {"equations", "friction_scan"}
    section = page[page.index('<section id="friction_scan">') :]
    section = section[: section.index("</section>")]
    assert "no dry friction" in section
    assert "<svg" not in section
    for file in own_folder.glob("*.png"):
        assert len(pd.read_csv(file.with_suffix(".csv"))) > 3


def test_overwriting_removes_what_an_earlier_run_wrote(tmp_path, monkeypatch):
    """Figures that are no longer made go; what the command did not write stays."""
    gone = ["page.html", "gone_figure.png", "gone_figure.svg"]
    with output_folder(tmp_path, "reproduce", gone):
        for name in gone:
            (tmp_path / name).write_text("old", encoding="utf-8")
    (tmp_path / "mine.png").write_text("mine", encoding="utf-8")
    monkeypatch.setattr(command, "FIGURES", ())
    with pytest.raises(ConfigurationError, match="--overwrite"):
        command.reproduce_to_folder(tmp_path, overwrite=False)
    assert (tmp_path / "gone_figure.png").exists()
    command.reproduce_to_folder(tmp_path, overwrite=True)
    written = {"page.html", "equations.csv", "verdicts.csv", ".hydro.json"}
    assert {file.name for file in tmp_path.iterdir()} == {*written, "mine.png"}


def test_the_page_says_whose_rig_it_is(own_folder):
    page = (own_folder / "page.html").read_text(encoding="utf-8")
    assert "another rig" in page
    assert "symmetric_eha.yaml" in page
    assert "The paper, on its rig" in page
    text = re.sub(r"<svg.*?</svg>|<style.*?</style>", "", page, flags=re.S)
    assert "What differs, and why" not in text  # written for the paper's rig
    for row in pd.read_csv(own_folder / "verdicts.csv").itertuples():
        assert f"<li>{row.conclusion}: {row.verdict}. {row.finding}</li>" in text
    assert not {"nan", "inf", "-nan"} & set(re.sub(r"<[^>]*>", " ", text).split())


def test_a_slow_axis_gets_more_time():
    heavy = own_rig(PlantParameters().replace(load={"mass": 1200.0}), "heavy")
    assert heavy.stretch > 3.0
    lasts = {rig.stretch: displacement_table(rig)["time_s"].max() for rig in (Rig(), heavy)}
    assert lasts[heavy.stretch] == pytest.approx(heavy.stretch * lasts[1.0], rel=1e-3)


def test_an_axis_that_is_too_slow_for_the_figures_is_refused():
    with pytest.raises(ConfigurationError, match=r"load\.mass = 1e\+06 kg: .* 0\.5\d* Hz; .* 3\.25 Hz"):
        own_rig(PlantParameters().replace(load={"mass": 1e6}), "too slow")
    slow = own_rig(PlantParameters().replace(load={"mass": 2e4}), "slow")
    assert slow.sample_time == 1e-3
    assert slow.sample_time < 1.0 / (20 * 65.0 / slow.stretch)


def test_a_light_axis_is_sampled_finer():
    light = own_rig(PlantParameters().replace(load={"mass": 3.0}), "light")
    assert light.sample_time < Rig().sample_time
    assert light.stretch == 1.0


def test_a_rig_without_a_stable_gain_says_so(monkeypatch):
    monkeypatch.setattr("hydro_agents.controllers.sampled_loop.SampledLoop.largest_stable_gain", lambda _: float("inf"))
    with pytest.raises(HydroError, match="no sensible gain"):
        closed_bode_table(own_rig(PlantParameters().replace(load={"mass": 61.0}), "unlimited"))


@pytest.mark.parametrize(
    ("text", "words"), [("load: {mass: -1.0}", "load.mass"), ("load: {external_force: 1.0e+6}", "external_force")]
)
def test_a_wrong_rig_is_one_line_and_exit_2(tmp_path, monkeypatch, capsys, text, words):
    file = tmp_path / "rig.yaml"
    file.write_text(text, encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["hydro", "reproduce", "--rig", str(file), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not Path(tmp_path / "out" / "page.html").exists()


def test_a_missing_rig_is_one_line(tmp_path):
    with pytest.raises(ConfigurationError, match="absent"):
        command.reproduce_to_folder(tmp_path, overwrite=False, rig_file=tmp_path / "absent.yaml")


def test_a_stop_too_gentle_to_settle_is_said():
    """A spool that takes seconds to close: nothing swings, and no figure divides by zero."""
    slow = own_rig(PlantParameters().replace(valve={"slew_limit": 0.1}), "slow spool")
    for table in (settling_table, friction_scan_table):
        with pytest.raises(HydroError, match="nothing to settle"):
            table(slow)
