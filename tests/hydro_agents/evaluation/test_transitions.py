"""Moves after pauses, and controllers that take over in motion."""

import numpy as np
import pandas as pd
import pytest

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.evaluation.sweeps import Experiment
from hydro_agents.evaluation.transitions import TakesOver, moves_after_pauses, taken_over
from hydro_agents.running.folders import config_folder
from hydro_env import TaskConfig
from hydro_env.files import read_yaml

TASK = TaskConfig()


def shipped(kind, gains, make):
    return make(gains(**read_yaml(config_folder() / "agents" / f"{kind}.yaml")), TASK)


FLOW = shipped("flow_linearising", FlowLinearisingGains, FlowLinearising)
DRIVING = shipped("pid", PIDGains, PID)


def test_a_pause_does_not_spoil_the_next_move():
    experiment = Experiment(moves_after_pauses, (0.05, 2.0), plants=3)
    table = experiment(TASK, {"flow": FLOW}, pauses=(0.5, 20.0))
    peak = table.groupby("pause_s")["peak_um"].mean()
    assert peak[20.0] < 1.2 * peak[0.5]
    assert (table["rest_um"] < 40.0).all()


class Constant:
    """Commands one number, and counts in its memory the periods since its start."""

    def __init__(self, command):
        self.command = command

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = np.zeros(len(observation)) if state is None else np.where(episode_start, 0.0, state + 1.0)
        return np.full((len(observation), 1), self.command, np.float32), count


def test_the_second_controller_begins_at_the_change():
    both, memory, commands = TakesOver(Constant(0.1), Constant(-0.2), 3), None, []
    for step in range(6):
        action, memory = both.predict(np.zeros((2, 5), np.float32), memory, np.full(2, step == 0))
        commands.append(action[0, 0])
    assert commands == pytest.approx([0.1, 0.1, 0.1, -0.2, -0.2, -0.2])
    assert memory.first.tolist() == [5.0, 5.0]
    assert memory.second.tolist() == [2.0, 2.0]


def test_taking_over_on_a_ramp_costs_little():
    table = pd.DataFrame(taken_over((DRIVING, FLOW), TASK))
    ramp = table[table["family"] == "ramp"]
    assert ramp["largest_um"].mean() < 1.5 * ramp["never_switched_um"].mean()
    themselves = pd.DataFrame(taken_over((DRIVING, DRIVING), TASK))
    np.testing.assert_array_equal(themselves["handed_over_um"], table["handed_over_um"])
