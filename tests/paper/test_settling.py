"""Settling times: the detectors against known answers, the trend of Fig. 13, linear theory."""

import math

import numpy as np
import pytest

from hydro_env import PlantParameters, resistance_from_flow, simulate
from hydro_env.plant.analysis import closed_port_natural_frequency
from paper.rig import SAMPLE_TIME
from paper.settling import drift, last_above, swing_envelope


def test_a_drift_does_not_fool_the_detector():
    time = np.arange(6000) * SAMPLE_TIME
    frequency, decay, start = 400.0, 4.0, 10.0
    wave = start * np.exp(-decay * time) * np.cos(frequency * time)
    slow = 0.5 * np.exp(-time / 2.0)
    exact = math.log(start / 0.1) / decay
    assert last_above(time, np.abs(wave + slow)) > 2.5  # what a naive detector says
    assert last_above(time, swing_envelope(time, wave + slow, frequency)) == pytest.approx(exact, abs=0.02)
    assert drift(wave + slow, SAMPLE_TIME, frequency)[1000:-200] == pytest.approx(slow[1000:-200], abs=0.05)


@pytest.mark.parametrize(("flow_lpm", "seconds"), [(0.03, 3.80), (0.25, 1.41), (1.0, 0.45), (3.0, 0.16)])
def test_known_settling_times(flow_lpm, seconds):
    """The published-order case of tests/hydro_env/plant/test_known_answers.py, by the detector of this package."""
    parameters = PlantParameters().replace(
        cylinder={"dead_volume": 40e-6, "piston_mass": 3.0},
        valve={"underlap": 0.0},
        fluid={"bulk_modulus": 1.0e9, "air_fraction": 0.0},
        load={"mass": 60.0, "spring_stiffness": 0.0, "viscous_damping": 100.0},
        friction={"model": "none"},
        leakage={"internal_resistance": resistance_from_flow(flow_lpm)},
    )
    start = {"position": -0.1, "velocity": 0.03, "pressure_a": 10e5, "pressure_b": 19.606e5}
    run = simulate(parameters, np.zeros(10000), SAMPLE_TIME, start)
    outline = swing_envelope(run.time, run.acceleration, closed_port_natural_frequency(parameters, -0.1))
    fell = last_above(run.time, outline, 0.1) - last_above(run.time, outline, 5.0)
    assert fell == pytest.approx(seconds, rel=0.03, abs=0.012)
