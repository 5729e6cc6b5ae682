"""``hydro leak-bound`` and ``hydro test-move``: their files say what was computed, and wrong input gets one line."""

import numpy as np
import pandas as pd
import pytest

from hydro_agents.estimation.information import TASK
from hydro_agents.evaluation.leak_bound import COLUMNS, sensor_choices
from hydro_env import TaskConfig
from tests.command_line import assert_one_clear_line, hydro


def test_leak_bound_writes_every_number_and_a_table(tmp_path):
    out = tmp_path / "out"
    options = ("--leak", 0, "--leak", 1, "--window", 0.2, "--window", 0.4, "--plants", 3)
    answer = hydro("leak-bound", *options, "--unknown", "valve.null_shift", "--output", out)
    assert answer.returncode == 0, answer.stderr
    table = pd.read_csv(out / "leak_bound.csv")
    assert tuple(table.columns) == COLUMNS
    # motions, leaks, plants, windows; six sets of unknowns, and the choices of sensors with one of them
    assert len(table) == 3 * 2 * 3 * 2 * (6 + len(sensor_choices(TaskConfig())) - 1)
    assert (table["sigma_lpm"] > 0.0).all()
    mine = table[
        (table["motion"] == "ordinary motion")
        & (table["leakage_flow_lpm"] == 1.0)
        & (table["unknowns"] == TASK)
        & (table["sensors"] == "all sensors")
    ]
    median = mine.groupby("window_s")["sigma_lpm"].median()
    assert median[0.4] < median[0.2]
    text = (out / "leak_bound.md").read_text(encoding="utf-8")
    assert f"{median[0.4]:.2g}" in text
    assert text.splitlines()[-1] in answer.stdout
    assert (out / "leak_bound.png").read_bytes().startswith(b"\x89PNG")
    assert_one_clear_line(hydro("leak-bound", "--output", out), "holds results already")


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--leak", -1), ("--leak -1", "within 0 to 20 l/min")),
        (("--window", 0.001), ("--window 0.001", "must be within")),
        (("--window", 1, "--window", 1), ("--window 1", "given twice")),
        (("--window", "nan"), ("--window nan",)),
        (("--unknown", "load.color"), ("load.color",)),
        (("--unknown", "load.mass"), ("load.mass", "among the unknowns of the task")),
        (("--controller", "nobody"), ("--controller nobody",)),
        (("--rig", "none.yaml"), ("none.yaml",)),
    ],
)
def test_leak_bound_refuses_in_one_line(tmp_path, options, parts):
    assert_one_clear_line(hydro("leak-bound", *options, "--output", tmp_path / "out"), *parts)
    assert not (tmp_path / "out").exists()


def test_test_move_writes_the_move_and_reads_the_leak(tmp_path):
    out = tmp_path / "out"
    options = ("--duration", 0.5, "--travel", 5, "--leak", 1, "--plants", 3, "--evaluations", 1)
    answer = hydro("test-move", *options, "--output", out)
    assert answer.returncode == 0, answer.stderr
    move = pd.read_csv(out / "move.csv")
    assert list(move.columns) == ["time_s", "reference_m"]
    assert move["time_s"].iloc[-1] == pytest.approx(0.5)
    assert np.ptp(move["reference_m"]) <= 5e-3 + 1e-6
    trial = pd.read_csv(out / "trial.csv")
    assert set(trial["motion"]) == {"ordinary motion", "slow motion", "at rest", "test move"}
    assert set(trial["leakage_flow_lpm"]) == {0.0, 1.0}
    read = trial[(trial["motion"] == "test move") & trial["holds"]]
    assert len(read) >= 4
    error = (read["estimate_lpm"] - read["leakage_flow_lpm"]).abs()
    assert (error < 5.0 * read["sigma_lpm"]).all()
    assert "| test move | 1 |" in answer.stdout
    assert (out / "test_move.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--travel", 900), ("--travel 900 mm", "at most")),
        (("--travel", -3), ("travel",)),
        (("--speed", 5000), ("--speed 5000 mm/s",)),
        (("--duration", 0), ("duration",)),
        (("--leak", "nan"), ("leak",)),
        (("--duration", 0.3, "--travel", 40, "--evaluations", 1), ("--duration 0.3 s", "no move")),
    ],
)
def test_test_move_refuses_in_one_line(tmp_path, options, parts):
    assert_one_clear_line(hydro("test-move", *options, "--output", tmp_path / "out"), *parts)
    assert not (tmp_path / "out").exists()
