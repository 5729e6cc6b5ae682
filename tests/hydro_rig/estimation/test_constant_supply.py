"""A constant supply has no dynamics: its pressure is a parameter, and the readings tell it."""

import numpy as np

from hydro_agents.detection.detector import measured_run
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.cases import Cases
from hydro_env import TaskConfig
from hydro_rig.estimation.estimate import estimate
from hydro_rig.estimation.search import EstimationSettings
from hydro_rig.estimation.unknowns import LEAKAGE

RANGES = {"supply.pressure": {"factor": [0.9, 1.1]}}
UNKNOWN = (LEAKAGE, "supply.pressure", "start.position", "start.pressure_a", "start.pressure_b", "start.spool_position")


def supplied(pressure, **more):
    """A task without biases whose supply is constant."""
    sensors = {name: {"bias": 0.0} for name in ("position", "pressure_a", "pressure_b", "spool_position")}
    plant = {"supply": {"model": "constant", "pressure": pressure}}
    return TaskConfig(episode_duration=0.8, plant=plant, sensors=sensors, **more)


def test_the_pressure_of_a_constant_supply_is_found():
    """The data sheet says 70 bar, the axis has 73."""
    config = supplied(73e5, randomisation={})
    cases = Cases(np.array([1_300_000, 1_300_001]), np.full(2, 0.5), np.full(2, "multi_sine"))
    signals, _ = measured_run(config, shipped("pid", config), cases)
    quick = EstimationSettings(horizons=(0.2,), restarts=1)
    found = estimate(signals, supplied(70e5, randomisation=RANGES), UNKNOWN, settings=quick)
    deviation = found.deviation("supply.pressure")
    assert (deviation < 0.5e5).all()
    assert (np.abs(found.value("supply.pressure") - 73e5) < 4.0 * deviation + 0.1e5).all()
