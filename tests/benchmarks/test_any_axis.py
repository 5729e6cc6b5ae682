"""The judgement of controllers on drawn rigs counts what it says."""

from functools import partial

import numpy as np
import pandas as pd
import pytest

from benchmarks import any_axis, kept_rows
from benchmarks.any_axis import POLICY, SEARCHED, against, measured, summary
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.evaluation.drawn_rigs import UNTUNED, cases_of
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(any_axis, "cases_of", partial(cases_of, plants=1))
    monkeypatch.setattr(any_axis, "STANDSTILLS", 2)


def test_errors_are_those_of_the_sensor_and_a_failure_costs_the_stroke():
    task = TaskConfig(episode_duration=0.3)

    class Open:
        """Opens the valve and never closes it: the axis hits its end stop."""

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.ones((len(observation), 1), np.float32), None

    held = measured(FlowLinearising(FlowLinearisingGains(), task), task, 0)
    assert held["failures"] == 0
    assert held["ramp_um"] < 500.0
    free = task_config(task, episode_duration=3.0, plant={"load": {"spring_stiffness": 0.0}})
    lost = measured(Open(), free, 0)
    assert lost["failures"] > 0
    assert lost["error_um"] > 0.6e6 * task.plant.cylinder.stroke  # at the end stop it is half the stroke


def test_the_summary_compares_rig_by_rig():
    rows = pd.DataFrame(
        [
            {
                "rig": rig,
                "controller": name,
                "error_um": error,
                "travel": 1.0,
                "failures": 0,
                "limit_cycles": cycles,
                "ringing": cycles,
            }
            for rig, own in ((0, 10.0), (1, 30.0))
            for name, error, cycles in ((UNTUNED, own, 0), (SEARCHED, 2.0 * own, 3), (POLICY, 3.0, 0))
        ]
    )
    untuned, other, _ = summary(rows)
    assert untuned[:5] == [UNTUNED, "2", "1.000 (1.000–1.000)", "1.000", "0"]
    assert other[2] == "2.000 (2.000–2.000)"
    assert other[-1] == "6"
    assert next(against(rows)) == [f"{POLICY} ÷ {SEARCHED}", "2", "0.100 (0.050–0.150)", "0.087", "2", "0.050–0.150"]


def test_rows_are_kept_and_what_is_missing_is_computed(tmp_path):
    asked = []

    def rows_of(number):
        asked.append(number)
        return [{"rig": number, "value": 10 * number + part} for part in range(2)]

    file = tmp_path / "new" / "rows.csv"
    assert len(kept_rows(file, "rig", [3, 4], rows_of)) == 4
    again = kept_rows(file, "rig", [4, 5], rows_of)
    assert asked == [3, 4, 5]
    assert list(again["value"]) == [40, 41, 50, 51]
