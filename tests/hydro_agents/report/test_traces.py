"""The worst cases: which ones, run again, and drawn on the page of a whole report."""

import numpy as np
import pytest
from made_up_tables import cases, protocol_tables
from proportional import Proportional

from hydro_agents.report.content import Content
from hydro_agents.report.traces import with_traces, worst_rows
from hydro_agents.running.cases import Cases, run_cases
from hydro_env import TaskConfig


@pytest.fixture
def config():
    return TaskConfig(episode_duration=0.2)


@pytest.fixture
def controllers(config):
    return {"PID": Proportional(100.0, config), "Good": Proportional(50.0, config), "Fair": Proportional(20.0, config)}


@pytest.fixture
def replay(config, controllers):
    def run(row):
        one = Cases(np.array([row["seed"]]), np.array([row["leakage_flow_lpm"]]), np.array([row["family"]]))
        return run_cases(config, controllers[row["controller"]], one)

    return run


def test_each_controller_has_the_case_in_which_its_rival_is_most_better():
    table = worst_rows(cases(), "PID", 1).set_index("controller")
    assert list(table.index) == ["Good", "Fair", "PID"]
    assert table.loc["Good", ["rival", "seed", "ratio"]].tolist() == ["PID", 2_200_007, 2.0]
    assert table.loc["Fair", ["rival", "seed", "ratio"]].tolist() == ["PID", 2_200_007, 1.25]
    assert table.loc["PID", ["rival", "seed"]].tolist() == ["Good", 2_200_009]
    assert table.loc["PID", "ratio"] == pytest.approx(3.0)


def test_a_condition_shows_its_worst_case_only():
    table = worst_rows(cases(), "PID", 2)
    assert table.loc[table["controller"] == "Good", "seed"].tolist() == [2_200_007]  # at 8 l/min it wins


def test_cases_that_a_controller_wins_are_no_failures():
    won = cases()
    won.loc[won["controller"] == "Good", "mean_error_mm"] = 0.1
    assert list(worst_rows(won, "PID")["controller"].unique()) == ["Fair", "PID"]


def test_worst_cases_are_run_again_with_the_rival_beside_them(replay):
    good, fair, pid = with_traces(Content(protocol_tables()), replay, 1).others["traces"]
    assert [list(run.position) for run in (good, fair, pid)] == [["Good", "PID"], ["Fair", "PID"], ["PID", "Good"]]
    assert good.title == (
        "Worst case 1 of Good: 2.00 times the error of PID (latency 5 ms, steps, leak of 4 l/min, seed 2200007)"
    )
    assert pid.title.endswith("(8 l/min, ramps, seed 2200009)")
    assert list(good.command) == ["Good", "PID"]
    assert good.position["Good"].shape == good.time.shape == (40,)
    assert not np.array_equal(good.position["Good"], good.position["PID"])
