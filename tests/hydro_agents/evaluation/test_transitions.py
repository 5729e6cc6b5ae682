"""Standstill under noise, moves after pauses, and controllers that take over in motion."""

import numpy as np
import pandas as pd
import pytest
from proportional import Constant, Proportional, Relay

from hydro_agents.evaluation import transitions
from hydro_agents.evaluation.experiments import EXPERIMENTS, taken_over
from hydro_agents.evaluation.sweeps import HiddenPreview
from hydro_agents.evaluation.transitions import TakesOver
from hydro_agents.learning.opponents import shipped
from hydro_env import TaskConfig

TASK = TaskConfig()
PID, FLOW = shipped("pid", TASK), shipped("flow_linearising", TASK)


def held(controller, leaks, place, plants, monkeypatch):
    monkeypatch.setattr(transitions, "PLACES", (place,))
    return EXPERIMENTS["hold"]._replace(leaks=leaks, plants=plants)(TASK, controller)


def test_a_relay_cycles_on_the_real_plant_and_a_soft_loop_does_not(monkeypatch):
    relay, soft = (
        held(each, [0.01, 1.0], 0.3, 2, monkeypatch) for each in (Relay(0.05, TASK), Proportional(100.0, TASK))
    )
    assert relay["limit_cycle"].all()
    assert (relay["amplitude_um"] > 30.0).all()
    assert not soft["limit_cycle"].any()
    assert soft["frequency_hz"].isna().all()
    assert not (relay["failed"] | soft["failed"]).any()


def test_the_pid_does_not_cycle_and_its_offsets_are_those_of_the_reading(monkeypatch):
    """Noise moves it; with an integral it holds its reading on the reference, whatever the bias of the sensor is."""
    table = held(PID, [1.0], 0.3, 3, monkeypatch)
    assert not table["limit_cycle"].any()
    assert (table["unrest_um"] > table["amplitude_um"]).all()
    assert (table["valve_travel_per_s"] > 0.0).all()
    table = held(HiddenPreview(PID, TASK), [0.3], 0.0, 4, monkeypatch)
    assert (table["offset_um"] < 10.0).all()  # biases reach 80 µm


def test_a_pause_does_not_spoil_the_next_move(monkeypatch):
    monkeypatch.setattr(transitions, "PAUSES", (0.5, 20.0))
    table = EXPERIMENTS["pause"]._replace(plants=3)(TASK, FLOW)
    peak = table.groupby("pause_s")["peak_um"].mean()
    assert peak[20.0] < 1.2 * peak[0.5]
    assert (table["rest_um"] < 40.0).all()


def test_the_second_controller_begins_at_the_change():
    both, memory, commands = TakesOver(Constant(0.1), Constant(-0.2), 3), None, []
    for step in range(6):
        action, memory = both.predict(np.zeros((2, 5), np.float32), memory, np.full(2, step == 0))
        commands.append(action[0, 0])
    assert commands == pytest.approx([0.1, 0.1, 0.1, -0.2, -0.2, -0.2])
    assert memory.first.tolist() == [5.0, 5.0]
    assert memory.second.tolist() == [2.0, 2.0]


def test_taking_over_on_a_ramp_costs_little():
    table = pd.DataFrame(taken_over((PID, FLOW), TASK))
    ramp = table[table["family"] == "ramp"]
    assert ramp["largest_um"].mean() < 1.5 * ramp["never_switched_um"].mean()
    themselves = pd.DataFrame(taken_over((PID, PID), TASK))
    np.testing.assert_array_equal(themselves["handed_over_um"], table["handed_over_um"])
