"""The rehearsal of a folder: what its C code does to the axis, healthy, wrong, and when a cable breaks."""

import shutil

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro

from hydro_env.files import read_yaml, write_yaml
from hydro_rig.export import rehearsal
from hydro_rig.export.c_files import c_compiler
from hydro_rig.export.contract import State
from hydro_rig.export.rehearsal import FILES, SCENES, rehearse, signed

pytestmark = pytest.mark.skipif(c_compiler() is None, reason="this machine has no C compiler")


@pytest.fixture(scope="module")
def played(exported):
    """The task, what was recorded, and the table, of flow linearisation on its own rig."""
    task, takes = rehearse(exported("flow_linearising").folder)
    return task, {take.scene.name: take for take in takes}, signed(task, takes)


def test_the_block_passes_every_scene_on_its_own_rig(played):
    _, takes, table = played
    assert list(takes) == [scene.name for scene in SCENES]
    assert set(table["end"]) == {"passed"}
    assert table.loc["healthy", "peak error, mm"] < 0.2
    assert table.loc["late", "peak error, mm"] > 1.5 * table.loc["healthy", "peak error, mm"]
    assert table.loc["worn", "largest command, V"] > 1.1 * table.loc["healthy", "largest command, V"]


def test_after_a_broken_cable_it_holds_and_after_an_emergency_stop_it_is_off(played):
    task, takes, table = played
    last = {name: State(take.state[-1]) for name, take in takes.items()}
    assert last.pop("broken cable") == State.HOLDING
    assert last.pop("emergency stop") == State.OFF
    assert set(last.values()) == {State.CONTROLLING}
    stop = takes["emergency stop"]
    assert stop.command[stop.event - 1] != 0.0
    assert (stop.command[stop.event + 1 + round(0.01 / task.control_period) :] == 0.0).all()
    states = takes["restart"].state
    assert [State(one) for one in states[np.diff(states, prepend=-1) != 0]] == [
        *(State.READY, State.CONTROLLING, State.OFF, State.READY, State.CONTROLLING)
    ]
    assert 0.0 < table.loc["emergency stop", "travel after the fault, mm"] < 10.0
    assert np.isnan(table.loc["healthy", "travel after the fault, mm"])


def test_on_a_faster_rig_a_move_lasts_as_long_as_the_block_needs(exported, other_rig, tmp_path, monkeypatch):
    """Ranges of the rig of the export, such as those of its hoses, do not matter on a rig that has none."""
    monkeypatch.setattr(rehearsal, "SCENES", SCENES[:1])
    folder = shutil.copytree(exported("flow_linearising").folder, tmp_path / "moved")
    hoses = {"lines.wall_bulk_modulus": {"log_uniform": [1e8, 1e9]}}
    write_yaml(folder / "task.yaml", read_yaml(folder / "task.yaml") | {"randomisation": hoses})
    _, (take,) = rehearse(folder, other_rig)
    ends = [take.reference[end - 1] for end in take.moves[1:]]
    assert ends == pytest.approx(take.targets)


def test_a_block_with_a_wrong_sign_does_not_pass(exported, tmp_path):
    folder = shutil.copytree(exported("pid").folder, tmp_path / "wrong")
    code = (folder / "controller.c").read_text(encoding="utf-8")
    (folder / "controller.c").write_text(code.replace("return self->command;", "return -self->command;"))
    answer = hydro("rehearse", folder, "--output", tmp_path / "out")
    assert answer.returncode == 1
    assert "healthy: end stop hit at speed" in answer.stdout or "healthy: beyond the safe distance" in answer.stdout
    assert all((tmp_path / "out" / name).is_file() for name in FILES)


def test_a_folder_without_a_block_is_one_clear_line(tmp_path):
    assert_one_clear_line(hydro("rehearse", tmp_path, "--output", tmp_path / "out"), "folder of an exported controller")
    assert not (tmp_path / "out").exists()
