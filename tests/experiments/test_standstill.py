"""Limit cycles of known loops on the real plant."""

from proportional import Proportional, Relay

from hydro_agents.evaluation.standstill import standstill
from hydro_agents.evaluation.sweeps import HiddenPreview
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig


def test_a_relay_cycles_on_the_real_plant_and_a_soft_loop_does_not():
    task = TaskConfig()
    controllers = {"relay": Relay(0.05, task), "soft": Proportional(100.0, task)}
    table = standstill(task, controllers, [0.01, 1.0], 3, [0.3], VALIDATION_SEEDS.start)
    cycles = table.groupby("controller")["limit_cycle"].mean()
    assert cycles["relay"] == 1.0
    assert cycles["soft"] == 0.0
    assert (table.loc[table["controller"] == "relay", "amplitude_um"] > 30.0).all()
    assert table.loc[table["controller"] == "soft", "frequency_hz"].isna().all()
    assert not table["failed"].any()


def test_the_pid_does_not_cycle_at_a_leak_of_1_l_min_although_noise_moves_it():
    task = TaskConfig()
    table = standstill(task, {"PID": shipped("pid", task)}, [1.0], 4, [0.3], VALIDATION_SEEDS.start)
    assert not table["limit_cycle"].any()
    assert (table["unrest_um"] > table["amplitude_um"]).all()
    assert (table["valve_travel_per_s"] > 0.0).all()


def test_offsets_are_those_of_the_reading():
    """A controller with an integral holds its reading on the reference, whatever the bias of the sensor is."""
    task = TaskConfig()
    pid = HiddenPreview(shipped("pid", task), task)
    table = standstill(task, {"PID": pid}, [0.3], 4, [0.0], VALIDATION_SEEDS.start)
    assert (table["offset_um"] < 10.0).all()  # biases reach 80 µm
