"""``hydro bound``: its tables hold what the cases say, and wrong input gets one line."""

import numpy as np
import pandas as pd
import pytest

from hydro_agents.evaluation.best_found import (
    NOMINAL,
    TRUTH,
    ComparisonSettings,
    convergence,
    summary,
    travel,
)
from hydro_agents.report.bounds import convergence_picture
from hydro_agents.running.text import frame_markdown
from hydro_env import TaskConfig
from tests.command_line import assert_one_clear_line, hydro
from tests.published import assert_published


def test_the_command_writes_every_case_and_a_table(tmp_path):
    task = tmp_path / "task.yaml"
    task.write_text("episode_duration: 0.05\n")
    answer = hydro("bound", "--task", task, "--leak", 1, "--leak", 4, "--output", tmp_path / "out")
    assert answer.returncode == 0, answer.stderr
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
