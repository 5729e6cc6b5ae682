"""Drawn rigs are rigs of this world, and the judgement of gains on them counts what it says."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.no_tuning import family_errors, judged_rig, summary
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config


def test_errors_are_those_of_the_sensor_and_a_failure_costs_the_stroke():
    task = TaskConfig(episode_duration=0.3)

    class Open:
        """Opens the valve and never closes it: the axis hits its end stop."""

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.ones((len(observation), 1), np.float32), None

    held, none = family_errors(FlowLinearising(FlowLinearisingGains(), task), task, 0)
    assert none == 0
    assert max(held.values()) < 5e-3
    assert held["pause"] < 60e-6  # the bias of the sensor, up to 80 µm, is none of the controller's
    free = task_config(task, plant={"load": {"spring_stiffness": 0.0}})
    lost, failures = family_errors(Open(), free, 0)
    assert failures > 0
    assert lost["pause"] == pytest.approx(task.plant.cylinder.stroke)


def test_a_rig_gives_a_row_per_controller_and_the_summary_counts_them(tmp_path):
    rows = pd.DataFrame(judged_rig(2, tmp_path, 0))
    assert rows["controller"].iloc[0] == "untuned"
    assert (rows["error_um"] > 0.0).all()
    other = rows.assign(rig=3, error_um=2.0 * rows["error_um"], limit_cycles=5, largest_amplitude_um=70.0)
    line = summary(pd.concat([rows, other]))[0]
    assert line[:4] == ["untuned", "2", "1.00 (1.00–1.00)", "1.00–1.00"]
    assert line[5].endswith(f"on {1 + int(rows['limit_cycles'][0] > 0)} rigs")
    assert line[6] == "70"
