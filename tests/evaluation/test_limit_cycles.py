"""Limit cycles: a lasting oscillation is found, a dying one, drift and noise are not; a relay on the plant is found."""

import numpy as np
import pytest

from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation.limit_cycles import (
    LIMIT_CYCLE,
    find_limit_cycle,
    standstill_metrics,
    standstill_task,
)
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicEnv, TaskConfig

PERIOD = 0.005
TIME = PERIOD * np.arange(300)
FLOOR = 15e-6
WAVE = np.sin(2.0 * np.pi * 12.0 * TIME)


def test_a_lasting_sine_is_found_with_amplitude_and_frequency():
    noise = np.random.default_rng(0).normal(scale=5e-6, size=len(TIME))
    cycle = find_limit_cycle(0.03 + 50e-6 * WAVE + noise + 1e-4 * TIME, PERIOD, FLOOR)
    assert cycle.sustained
    assert cycle.amplitude == pytest.approx(50e-6, rel=0.05)
    assert cycle.frequency == pytest.approx(12.0, abs=0.4)


@pytest.mark.parametrize(
    "motion",
    [
        np.zeros(len(TIME)),
        10e-6 * WAVE,  # below the floor
        100e-6 * WAVE * np.exp(-4.0 * TIME),  # dying out
        200e-6 * TIME,  # drift
        100e-6 * np.sin(2.0 * np.pi * 0.5 * TIME),  # slower than three cycles
        np.random.default_rng(1).normal(scale=5e-6, size=len(TIME)),
    ],
)
def test_what_comes_to_rest_is_none(motion):
    assert not find_limit_cycle(motion, PERIOD, FLOOR).sustained


def test_the_task_of_a_standstill_is_the_task_without_noise():
    config = TaskConfig(disturbance={"kind": "step"}, leakage={"schedule": "growth"}, command_latency=0.004)
    still = standstill_task(config)
    assert still.sensors.position.noise == still.sensors.pressure_a.noise == 0.0
    assert still.sensors.position.resolution == config.sensors.position.resolution
    assert still.sensors.position.bias == config.sensors.position.bias
    assert (still.disturbance.kind, still.leakage.schedule) == ("none", "constant")
    assert (still.command_latency, still.randomisation) == (0.004, config.randomisation)
    assert still.references.user[0] == still.references.user[-1] == 0.0
    assert max(still.references.user) == config.references.step_range[0]


class Relay:
    """Full command against the error: it must oscillate."""

    def __init__(self, config):
        self.column = ServoHydraulicEnv(config).observation_names.index("tracking_error")

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return 0.3 * np.sign(observation[:, [self.column]]), state


def test_a_relay_on_the_plant_oscillates_and_a_weak_loop_does_not():
    config = TaskConfig()
    first = VALIDATION_SEEDS.start
    cases = Cases(np.arange(first, first + 3), np.array([0.03, 1.0, 4.0]), None)
    still = standstill_task(config)
    weak = make_controller("pid", config, {"proportional": 10.0, "integral": 1.0})
    found = {}
    for name, controller in {"relay": Relay(config), "weak": weak}.items():
        found[name] = standstill_metrics(run_cases(still, controller, cases), still)
        assert set(found[name]) == set(LIMIT_CYCLE)
    assert found["relay"]["limit_cycle"].tolist() == [1.0] * 3
    assert np.all(found["relay"]["frequency_hz"] > 3.0)
    assert np.all(found["relay"]["amplitude_um"] > 100.0)
    assert found["weak"]["limit_cycle"].tolist() == [0.0] * 3
    assert np.isnan(found["weak"]["frequency_hz"]).all()
    assert np.all(found["weak"]["failed"] == 0.0)
