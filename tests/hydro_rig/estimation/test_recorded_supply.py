"""A supply that is constant, moves, or was recorded; and a recorded flow, which needs no valve."""

import numpy as np
import pytest
from recorded import RAM, RAM_COLUMNS, RAM_RIG

from hydro_agents.detection.detector import Windows, measured_run
from hydro_agents.detection.disturbances import SUPPLY, Disturbances, Disturbed
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import DIAGNOSIS
from hydro_env import TaskConfig
from hydro_env.plant.states import State
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS
from hydro_rig.diagnosis.diagnose import diagnose
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.estimation.estimate import EstimationSettings, estimate
from hydro_rig.estimation.estimator import EstimatorDetector, wear_priors
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.recordings.columns import ColumnMap

CONFIG = TaskConfig(episode_duration=2.5)


class Gauge(Disturbed):
    """Notes the supply pressure of every sample."""

    def begin(self, axes):
        super().begin(axes)
        self.seen = []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append(self._axes.state[:, State._fields.index("supply_pressure")].copy())
        return super().predict(observation, state, episode_start, deterministic)


def swinging(leak, axes=2, size=0.05):
    """Windows of 2 s under a supply that swings at 0.5 Hz, with the readings of its gauge, which has an offset."""
    course = np.zeros((axes, 4, CONFIG.steps))
    course[:, SUPPLY] = size * np.sin(np.pi * CONFIG.control_period * np.arange(CONFIG.steps))
    gauge = Gauge(shipped("pid", CONFIG), Disturbances(course, np.zeros(axes, np.bool_)))
    cases = Cases(np.array(DIAGNOSIS.take(axes, 9_000)), np.full(axes, leak), np.full(axes, "multi_sine"))
    signals, _ = measured_run(CONFIG, gauge, cases)
    supply = np.array(gauge.seen).T + np.random.default_rng(0).normal(0.5e5, 0.2e5, (axes, CONFIG.steps))
    unknown, part = np.full(axes, np.nan), slice(100, 501)
    return Windows(signals[:, :, part], unknown, unknown, {"supply_pressure": supply[:, part]})


def constant(pressure, **more):
    """A task whose supply is constant, and whose sensors have no offset."""
    sensors = {name: {"bias": 0.0} for name in SENSORS}
    plant = {"supply": {"model": "constant", "pressure": pressure}}
    return TaskConfig(episode_duration=0.8, plant=plant, sensors=sensors, **more)


def test_the_pressure_of_a_constant_supply_is_found():
    """The data sheet says 70 bar, the axis has 73."""
    config = constant(73e5, randomisation={})
    cases = Cases(np.array([1_300_000, 1_300_001]), np.full(2, 0.5), np.full(2, "multi_sine"))
    signals, _ = measured_run(config, shipped("pid", config), cases)
    expected = constant(70e5, randomisation={"supply.pressure": {"factor": [0.9, 1.1]}})
    starts = ("start.position", "start.pressure_a", "start.pressure_b", "start.spool_position")
    quick = EstimationSettings(horizons=(0.2,), restarts=1)
    found = estimate(signals, expected, (LEAKAGE, "supply.pressure", *starts), settings=quick)
    deviation = found.deviation("supply.pressure")
    assert (deviation < 0.5e5).all()
    assert (np.abs(found.value("supply.pressure") - 73e5) < 4.0 * deviation + 0.1e5).all()
    assert not {"pressure_a_bias", "spool_position_bias"} & set(wear_priors(expected))


@pytest.mark.parametrize("leak", [0.01, 0.3])
def test_a_recorded_supply_gives_the_leak_although_it_swings(leak):
    found = EstimatorDetector().read(swinging(leak), CONFIG)
    assert found.answers.all()
    np.testing.assert_allclose(found.flow_lpm, leak, atol=0.015)
    assert (found.high_lpm - found.low_lpm < 0.03).all()


def test_a_supply_that_moves_is_found_without_its_record():
    windows = swinging(0.3, axes=1)
    found = EstimatorDetector().read(Windows(windows.signals, windows.begin, windows.end), CONFIG)
    assert found.answers.all()
    np.testing.assert_allclose(found.flow_lpm, 0.3, atol=0.03)
    assert (found.low_lpm > 0.2).all()


def test_a_real_ram_with_a_pump_gets_its_verdict_from_the_flow():
    def verdict(task, columns):
        return diagnose(RAM, task, ColumnMap.model_validate(columns)).verdict

    task, without = task_config(None, rig=RAM_RIG), {name: RAM_COLUMNS[name] for name in RAM_COLUMNS if name != "flow"}
    found = verdict(task, RAM_COLUMNS)
    assert found.kind is Kind.LEAK
    assert 0.18 <= found.leak.value <= 0.23
    assert "balance of volumes" in found.line()
    assert verdict(TaskConfig(), RAM_COLUMNS).kind is verdict(task, without).kind is Kind.UNKNOWN
