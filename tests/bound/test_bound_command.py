"""``hydro bound``, ``leak-bound`` and ``test-move``: their files say what was computed; wrong input gets one line."""

import numpy as np
import pandas as pd
import pytest

from hydro_agents.estimation.information import TASK
from hydro_agents.evaluation.best_found import (
    NOMINAL,
    TRUTH,
    ComparisonSettings,
    convergence,
    summary,
    travel,
)
from hydro_agents.evaluation.leak_bound import COLUMNS, sensor_choices
from hydro_agents.report.bounds import convergence_picture
from hydro_agents.running.text import frame_markdown
from hydro_env import TaskConfig
from tests.command_line import assert_one_clear_line, done, hydro
from tests.published import assert_published


def test_the_command_writes_every_case_and_a_table(tmp_path):
    task = tmp_path / "task.yaml"
    task.write_text("episode_duration: 0.05\n")
    answer = done("bound", "--task", task, "--leak", 1, "--leak", 4, "--output", tmp_path / "out")
    assert_published("bound", tmp_path / "out")
    cases = pd.read_csv(tmp_path / "out" / "bound.csv")
    shipped = {"PID", "PID mended", "ADRC", "LQG", "Flow linearisation", "PPO"}
    assert set(cases["controller"]) == {*shipped, TRUTH, NOMINAL}
    assert len(cases) == (len(shipped) + 2) * 2 * 6 * 3  # controllers, leaks, families, plants
    mean = cases[cases["controller"] == TRUTH]["error_mm"].mean()
    assert f"| {mean:.4f} |" in answer.stdout
    assert (tmp_path / "out" / "bound.md").read_text(encoding="utf-8").count("| mean |") == 3
    assert_one_clear_line(hydro("bound", "--task", task, "--output", tmp_path / "out"), "holds results already")


def test_wrong_input_gets_one_line(tmp_path):
    assert_one_clear_line(hydro("bound", "--task", "none.yaml", "--output", tmp_path / "out"), "none.yaml")
    wrong = hydro("bound", "--leak", "-1", "--output", tmp_path / "out")
    assert_one_clear_line(wrong, "leak_levels", "-1")
    assert not (tmp_path / "out").exists()


def test_the_summary_has_both_frames():
    rows = [
        {
            "controller": name,
            "family": family,
            "error_mm": error,
            "true_error_mm": error + 0.03,
            "valve_travel_per_s": 2.0,
        }
        for name, error in (("PID", 0.2), (NOMINAL, 0.1), (TRUTH, 0.0))
        for family in ("step", "sine")
    ]
    table = summary(pd.DataFrame(rows), "family")
    assert list(table.columns) == ["PID", NOMINAL, TRUTH, "PID, true position", "floor, true position"]
    np.testing.assert_allclose(table.loc["mean"], [0.2, 0.1, 0.0, 0.23, 0.03])
    assert frame_markdown(travel(pd.DataFrame(rows)), 1).splitlines()[-1] == "| mean | 2.0 | 2.0 | 2.0 |"
    assert frame_markdown(table).splitlines()[-1] == "| mean | 0.2000 | 0.1000 | 0.0000 | 0.2300 | 0.0300 |"


def test_convergence_varies_one_setting_at_a_time():
    settings = ComparisonSettings(leak_levels=(1.0,), families=("step", "sine"), validation=True)
    short = TaskConfig(episode_duration=0.05)
    table = convergence(short, settings, {"horizon": (5, 20), "samples": (0, 8)})
    assert table[["setting", "value"]].to_numpy().tolist() == [
        ["horizon", 5], ["horizon", 20], ["samples", 0], ["samples", 8]
    ]  # fmt: skip
    assert table["mean"][1] == table["mean"][3] == pytest.approx(table.loc[1, ["step", "sine"]].mean())
    assert convergence_picture(table).startswith(b"\x89PNG")


def test_leak_bound_writes_every_number_and_a_table(tmp_path):
    out = tmp_path / "out"
    options = ("--leak", 0, "--leak", 1, "--window", 0.2, "--window", 0.4, "--plants", 3)
    answer = done("leak-bound", *options, "--unknown", "valve.null_shift", "--output", out)
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
    answer = done("test-move", *options, "--output", out)
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
