"""Control metrics against closed forms: step responses, standstills, integrals."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from hydro_agents.evaluation.metrics import (
    SETTLING_BAND,
    case_metrics,
    reversals,
    rollout_metrics,
    settling_time,
    standstills,
)
from hydro_agents.running.cases import Rollout

PERIOD = 1e-4
SIZE = 0.02  # m
FREQUENCY = 40.0  # rad/s


def second_order(time, damping):
    """Unit step response of a second-order lag with ω_n = FREQUENCY."""
    root = math.sqrt(1.0 - damping**2)
    wave = np.cos(FREQUENCY * root * time) + damping / root * np.sin(FREQUENCY * root * time)
    return 1.0 - np.exp(-damping * FREQUENCY * time) * wave


def step_run(damping, size=SIZE, start=0.0, before=0.05, after=0.9):
    """Reference and position of an axis that answers a step like a second-order lag."""
    wait, count = round(before / PERIOD), round(after / PERIOD)
    time = PERIOD * np.arange(count)
    reference = np.concatenate([np.full(wait, start), np.full(count, start + size)])
    position = np.concatenate([np.full(wait, start), start + size * second_order(time, damping)])
    return reference, position


def rollout_of(reference, position, command=None, **values):
    """Episodes (N, T) with these values, zeros otherwise."""
    zeros = np.zeros(np.shape(reference))
    traces = dict.fromkeys(("spool", "supply_power", "reward"), zeros)
    traces |= {"position": position, "reference": reference, "command": zeros if command is None else command}
    known = {"time": None, "signals": None, "leakage_flow_lpm": None, "position_bias": np.zeros(len(zeros))}
    return Rollout(**traces | known | {"failed_at": np.full(len(zeros), -1)} | values)


def metrics_of(reference, position, period=PERIOD, is_step=True, command=None, preview=0.0):
    command = None if command is None else np.asarray(command)[None]
    return case_metrics(rollout_of(reference[None], position[None], command), 0, period, is_step, preview)


@pytest.mark.parametrize("damping", [0.2, 0.3, 0.6, 0.7])
@pytest.mark.parametrize("size", [SIZE, -SIZE])
def test_overshoot_and_settling_time_of_a_second_order_lag(damping, size):
    overshot = 100.0 * math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    for step, start in ((size, -0.03), (0.001, 0.0)):
        found = metrics_of(*step_run(damping, step, start))
        assert found["overshoot_percent"] == pytest.approx(overshot, rel=1e-3)
    # |error| peaks at multiples of π/ω_d; it settles on the way from the last peak outside the band to the next zero.
    damped = FREQUENCY * math.sqrt(1.0 - damping**2)
    peaks = math.pi / damped * np.arange(20)
    outside = peaks[SIZE * np.abs(1.0 - second_order(peaks, damping)) > SETTLING_BAND][-1]
    expected = brentq(
        lambda t: SIZE * abs(1.0 - second_order(np.array(t), damping)) - SETTLING_BAND,
        outside,
        outside + (math.pi - math.acos(damping)) / damped,
    )
    found = metrics_of(*step_run(damping, size))
    assert found["settling_time_s"] == pytest.approx(expected, abs=1.5 * PERIOD)
    assert found["unsettled_share"] == 0.0


def test_settling_time_of_a_first_order_lag():
    time = PERIOD * np.arange(5000)
    error = SIZE * np.exp(-time / 0.03)
    assert settling_time(error, PERIOD) == pytest.approx(0.03 * math.log(SIZE / SETTLING_BAND), abs=1.5 * PERIOD)
    assert settling_time(-error, PERIOD) == settling_time(error, PERIOD)
    assert settling_time(0.9 * SETTLING_BAND / SIZE * error, PERIOD) == 0.0
    again = np.isin(np.arange(100), [0, 40])  # leaves the band again
    assert settling_time(1.0 * again, 0.005) == pytest.approx(41 * 0.005)


def test_never_settled_is_nan_and_counted():
    reference, position = step_run(0.5, after=0.03)
    position = np.concatenate([position, np.full(3000, SIZE + 1.01 * SETTLING_BAND)])
    reference = np.concatenate([reference, np.full(3000, SIZE)])
    found = metrics_of(reference, position)
    assert math.isnan(found["settling_time_s"])
    assert found["unsettled_share"] == 1.0
    assert found["steady_state_error_mm"] == pytest.approx(1.01e3 * SETTLING_BAND)


def test_setting_off_before_a_step_that_is_seen_is_no_fault():
    reference = np.repeat([0.0, 0.01, 0.02], [10, 40, 40])
    position = reference.copy()
    position[44:50] = np.linspace(0.0105, 0.014, 6)  # towards the next target, 30 ms early
    blind, seeing = metrics_of(reference, position, 0.005), metrics_of(reference, position, 0.005, preview=0.04)
    assert (blind["unsettled_share"], seeing["unsettled_share"]) == (0.5, 0.0)
    assert seeing["steady_state_error_mm"] == seeing["overshoot_percent"] == 0.0
    assert blind["steady_state_error_mm"] > 0.5
    assert blind["overshoot_percent"] == pytest.approx(20.0)
    assert seeing["mean_error_mm"] == blind["mean_error_mm"]  # tracking errors count everywhere


def test_standstills():
    assert standstills(np.zeros(100), 0.005) == []  # it has never moved
    ramp = np.concatenate([np.zeros(5), np.linspace(0.001, 0.01, 10), np.full(30, 0.01)])
    assert standstills(ramp, 0.005) == [(14, 45)]
    assert standstills(np.arange(50.0), 0.005) == []
    pulses = np.repeat([0.0, 1.0, 0.0, 1.0], [30, 20, 19, 25])
    assert standstills(pulses, 0.005) == [(30, 50), (69, 94)]  # 20 samples are 0.1 s, 19 are not


def test_errors_and_reversals_of_a_sine():
    time = 0.001 * np.arange(1, 2001)
    error = 0.003 * np.sin(2.0 * math.pi * 5.0 * time)
    found = metrics_of(error, np.zeros(2000), period=0.001, command=100.0 * error)
    assert found["mean_error_mm"] == pytest.approx(3.0 * 2.0 / math.pi, rel=1e-3)
    assert found["peak_error_mm"] == pytest.approx(3.0, rel=1e-6)
    assert found["reversals_per_s"] == pytest.approx(10.0)  # two in a period
    for name in ("settling_time_s", "unsettled_share", "steady_state_error_mm", "overshoot_percent"):
        assert math.isnan(metrics_of(np.arange(50.0), np.arange(50.0), period=0.005)[name])  # it never stands still


def test_every_case_of_a_rollout():
    reference = np.tile(np.repeat([0.0, 0.01], [10, 90]), (2, 1))
    position = reference.copy()
    position[:, 30:40] += 0.001
    rollout = rollout_of(
        reference.astype(np.float32),
        position.astype(np.float32),
        supply_power=np.full(reference.shape, 200.0),
        reward=np.full(reference.shape, -0.5),
        failed_at=np.array([-1, 99]),
        position_bias=np.array([0.0001, 0.0]),
    )
    found = rollout_metrics(rollout, np.array(["step", "ramp"]), 0.005)
    assert found["overshoot_percent"][0] == pytest.approx(10.0, rel=1e-4)
    assert math.isnan(found["overshoot_percent"][1])
    np.testing.assert_array_equal(found["failed"], [0.0, 1.0])
    np.testing.assert_allclose(found["mean_error_mm"], 0.1, rtol=1e-4)
    np.testing.assert_allclose(found["settling_time_s"], 30 * 0.005)
    np.testing.assert_allclose(found["supply_energy_j"], 200.0 * 0.5)
    np.testing.assert_allclose(found["return"], -50.0)
    # The sensor of the first axis reads 0.1 mm too much: seen from it, the axis is 0.1 mm beside its target.
    np.testing.assert_allclose(found["steady_state_error_sensor_mm"], [0.1, 0.0], atol=1e-6)
    np.testing.assert_allclose(found["mean_error_sensor_mm"], [0.09 + 0.11 * 10 / 10, 0.1], rtol=1e-3)


@pytest.mark.parametrize(
    ("command", "count"),
    [
        ([0.0, 0.0, 0.0], 0),
        (np.linspace(-1.0, 1.0, 50), 0),
        ([0.0, 0.1, 0.0, 0.1, 0.0], 3),
        ([0.0, 0.1, 0.097, 0.2, 0.1], 1),  # a swing of 0.003 is below the valve's threshold
        ([0.1, 0.0, 0.05, 0.06, 0.02], 2),
        ([0.0, 0.002, 0.0, 0.002, 0.0], 0),
        (np.repeat([0.0, 0.1, 0.0], 10), 1),
        ([0.0, 0.004, 0.008, 0.012, 0.008, 0.004, 0.0], 1),  # small steps add up to a swing
    ],
)
def test_reversals_are_turning_points_of_swings_that_a_valve_follows(command, count):
    assert reversals(np.array(command)) == count
    assert reversals(-np.array(command)) == count
