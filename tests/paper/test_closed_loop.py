"""The sampled position loop: closed forms, the nonlinear plant, the figures made from it."""

import math

import numpy as np
import pytest

from hydro_agents.controllers.sampled_loop import CONTROL_PERIOD, SampledLoop, sampled_loop
from hydro_env import PlantParameters
from paper.loop import bandwidth, final_value, response
from paper.rig import simplified, with_leak

SPEED, LATE = 0.2, 1e-3  # m/s per command, s


@pytest.fixture(scope="module")
def integrator():
    """A pure integrator: the position after one period is known by hand."""
    one, zero = np.eye(1), np.zeros(1)
    return SampledLoop(
        one,
        np.array([SPEED * LATE]),
        np.array([SPEED * (CONTROL_PERIOD - LATE)]),
        0.0 * one,
        zero,
        zero,
        1.0,
        CONTROL_PERIOD,
    )


@pytest.fixture(scope="module")
def prompt_integrator():
    one, zero = np.eye(1), np.zeros(1)
    return SampledLoop(one, zero, np.array([SPEED * CONTROL_PERIOD]), 0.0 * one, zero, zero, 1.0, CONTROL_PERIOD)


def step_response(loop, gain, periods):
    """Position after a unit step of the reference, at each sampling instant, (periods + 1,), m per m."""
    state, command, out = np.zeros(len(loop.input_new)), 0.0, [0.0]
    for _ in range(periods):
        new = gain * (1.0 - loop.position_size * state[0])
        state = loop.transition @ state + loop.input_old * command + loop.input_new * new
        command = new
        out.append(loop.position_size * state[0])
    return np.array(out)


def plant(leak):
    return with_leak(simplified(PlantParameters(), "none", True), leak, "laminar")


def test_response_of_an_integrator(integrator):
    gain, hertz = 60.0, np.array([1.0, 20.0, 90.0])
    z = np.exp(2j * math.pi * hertz * CONTROL_PERIOD)
    opened = gain * SPEED * ((CONTROL_PERIOD - LATE) + LATE / z) / (z - 1.0)
    assert response(integrator, gain, hertz) == pytest.approx(opened / (1.0 + opened))
    assert final_value(integrator, gain) == pytest.approx(1.0)


def test_bandwidth_and_steps_of_an_integrator(prompt_integrator):
    gain = 200.0
    k = gain * SPEED * CONTROL_PERIOD  # the error is multiplied by 1 − k in each period
    cosine = (1.0 + (1.0 - k) ** 2 - 2.0 * k**2) / (2.0 * (1.0 - k))
    assert bandwidth(prompt_integrator, gain) == pytest.approx(
        math.acos(cosine) / (2 * math.pi * CONTROL_PERIOD), rel=1e-4
    )
    assert step_response(prompt_integrator, gain, 3) == pytest.approx([1.0 - (1.0 - k) ** n for n in range(4)])
    assert prompt_integrator.largest_stable_gain() == pytest.approx(2.0 / (SPEED * CONTROL_PERIOD), rel=1e-6)


def test_response_is_the_transform_of_the_pulse_response():
    loop, gain = sampled_loop(plant(2.0), 0.02), 300.0
    pulse = np.diff(step_response(loop, gain, 4000), prepend=0.0)
    for hertz in (0.5, 15.0, 66.0, 95.0):
        z = np.exp(-2j * math.pi * hertz * CONTROL_PERIOD * np.arange(len(pulse)))
        assert response(loop, gain, np.array([hertz]))[0] == pytest.approx(pulse @ z, rel=1e-3)
    assert final_value(loop, gain) == pytest.approx(step_response(loop, gain, 4000)[-1], rel=1e-3)
