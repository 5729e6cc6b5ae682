"""The sampled position loop: against the nonlinear plant, and against the continuous rule of thumb."""

import numpy as np
import pytest

from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_env import PlantParameters, equilibrium, resistance_from_flow, simulate
from hydro_env.plant.states import STATE_NAMES
from paper.loop import final_value, response


def leaking(flow, **groups):
    """The paper's rig without dry friction, at a leak in l/min at 100 bar."""
    groups = {"friction": {"model": "none"}} | groups
    return PlantParameters().replace(leakage={"internal_resistance": resistance_from_flow(flow)}, **groups)


def closed_loop_errors(parameters, gain, periods, start=1e-6):
    """Position errors (m) of the nonlinear plant under sampled proportional control from a small deviation."""
    rest, holding = equilibrium(parameters, 0.0)
    state, command, errors = rest | {"position": start}, 0.0, []
    for _ in range(periods):
        errors.append(state["position"])
        new = -gain * state["position"]
        voltages = np.clip(holding + 10.0 * np.array([command, new, new, new, new]), -10.0, 10.0)  # 1 of 5 ms late
        run = simulate(parameters, voltages, 1e-3, state)
        state = {name: float(run[name][-1]) for name in STATE_NAMES}
        command = new
    return np.abs(errors)


@pytest.mark.parametrize("leak", [0.01, 1.0, 4.0])
def test_below_the_largest_gain_the_plant_settles_and_above_it_swings_up(leak):
    parameters = leaking(leak)
    loop = sampled_loop(parameters)
    largest = loop.largest_stable_gain()
    assert loop.spectral_radius(0.999 * largest) < 1.0 < loop.spectral_radius(1.001 * largest)
    for share in (0.95, 1.05):
        errors = closed_loop_errors(parameters, share * largest, 200)
        early, late = errors[40:80].max(), errors[-40:].max()
        assert (late < 0.5 * early) if share < 1.0 else (late > 2.0 * early)


def test_sampling_is_exact():
    """Two halves of a period make a whole one; the latency only moves input from the new to the old command."""
    half, whole = (sampled_loop(leaking(1.0), 0.0, period, 0.0) for period in (2.5e-3, 5e-3))
    assert np.allclose(half.transition @ half.transition, whole.transition, atol=1e-9)
    assert np.allclose(half.transition @ half.input_new + half.input_new, whole.input_new, atol=1e-9)
    late = sampled_loop(leaking(1.0), 0.0, 5e-3, 1e-3)
    assert np.allclose(late.input_old + late.input_new, whole.input_new, atol=1e-9)


def test_static_stiffness_is_what_the_plant_shows():
    parameters = leaking(1.0)
    gain, force = 200.0, 20.0
    pushed = parameters.replace(load={"external_force": force})
    rest, holding = equilibrium(parameters, 0.0)
    state, command = dict(rest), 0.0
    for _ in range(200):
        new = -gain * state["position"]
        run = simulate(pushed, holding + 10.0 * np.array([command, new, new, new, new]), 1e-3, state)
        state, command = {name: float(run[name][-1]) for name in STATE_NAMES}, new
    assert -force / state["position"] == pytest.approx(sampled_loop(parameters).static_stiffness(gain), rel=0.02)


def test_whole_periods_of_latency_only_turn_the_phase_and_cost_gain():
    frequencies = np.array([1.0, 5.0, 20.0, 60.0])
    loops = [sampled_loop(leaking(1.0), 0.0, 2e-3, latency) for latency in (1e-3, 3e-3, 5e-3)]
    opened = [answer / (1.0 - answer) for answer in (response(loop, 20.0, frequencies) for loop in loops)]
    turn = np.exp(-2j * np.pi * frequencies * 2e-3)
    np.testing.assert_allclose(opened[1], opened[0] * turn)
    np.testing.assert_allclose(opened[2], opened[0] * turn**2)
    largest = [loop.largest_stable_gain() for loop in loops]
    assert largest == sorted(largest, reverse=True)
    for loop, gain in zip(loops, largest, strict=True):  # at the limit the open loop passes through −1
        values = np.linalg.eigvals(loop.closed(gain))
        frequency = np.abs(np.angle(values[np.argmax(np.abs(values))])) / (2.0 * np.pi * 2e-3)
        answer = response(loop, gain * (1.0 - 1e-6), np.array([frequency]))
        assert abs((answer / (1.0 - answer))[0] + 1.0) < 1e-3
        assert final_value(loop, 0.5 * gain) == pytest.approx(final_value(loops[0], 0.5 * gain))


@pytest.mark.parametrize("latency", [1e-3, 7e-3])
def test_step_and_frequency_response_tell_the_same(latency):
    """The step's increments are the impulse response, whose transform is g G/(1 + g G)."""
    loop, gain, count = sampled_loop(leaking(4.0), latency=latency), 20.0, 4096
    increments = np.diff(loop.step_response(gain, count), prepend=0.0)
    opened = gain * loop.frequency_response(np.arange(1, count // 2, 97) / (count * loop.control_period))
    assert np.allclose(np.fft.fft(increments)[1 : count // 2 : 97], opened / (1.0 + opened), atol=1e-6)
