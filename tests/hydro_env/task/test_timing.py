"""Timing: when a command reaches the valve, and that an episode is the plant's own answer to those inputs."""

import numpy as np
import pytest

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv, equilibrium, simulate
from hydro_env.plant.states import STATE_NAMES

CLEAN = {"sensors": {"enabled": False}}


def commands(count=60, seed=0):
    """Commands with held stretches and jumps, some beyond the limit of ±1."""
    return np.repeat(np.random.default_rng(seed).uniform(-0.7, 1.1, count // 5), 5)


def replay(parameters, position, sequence, latency, period):
    """The states that the plant alone gives: in each period the previous command for the latency, then the new one."""
    state, holding = equilibrium(parameters, position)
    states, previous = [list(state.values())], holding
    for command in sequence:
        acting = 10.0 * np.clip(command, -1.0, 1.0)
        for voltage, duration in ((previous, latency), (acting, period - latency)):
            if duration > 0.0:
                run = simulate(parameters, [voltage], duration, state)
                state = dict(zip(STATE_NAMES, run.states[-1], strict=True))
        states.append(list(state.values()))
        previous = acting
    return np.array(states)


@pytest.mark.parametrize("law", ["laminar", "orifice"])
@pytest.mark.parametrize(("latency", "period"), [(0.0, 5e-3), (1e-3, 5e-3), (5e-3, 5e-3), (0.4e-3, 2e-3)])
def test_an_episode_is_the_plants_answer_to_the_held_commands(latency, period, law):
    env = ServoHydraulicEnv(command_latency=latency, control_period=period, leakage={"law": law}, **CLEAN)
    observation, info = env.reset(seed=21)
    sequence = commands()
    expected = replay(env.parameters, info["position"], sequence, latency, period)
    names = env.observation_names
    places = [names.index(name) for name in ("position", "pressure_a", "pressure_b", "spool_position")]
    size = np.maximum(np.abs(expected).max(axis=0), 1e-9)
    assert np.ptp(expected[:, 0]) > 0.005
    for number, command in enumerate(sequence):
        observation, _, _, _, info = env.step(np.array([command]))
        error = np.abs(env.axes.state[0] - expected[number + 1]) / size
        assert error.max() < 1e-9
        assert info["position"] == pytest.approx(expected[number + 1, 0], abs=1e-9)
        assert info["velocity"] == pytest.approx(expected[number + 1, 1], abs=1e-9)
        seen = (observation * env.observation_scale)[places]
        np.testing.assert_allclose(seen, expected[number + 1][[0, 2, 3, 4]], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("late", [1, 2, 3, 4])
def test_a_latency_of_whole_periods_more_moves_the_commands_by_as_many(late):
    period, steps = 2.0**-8, 40  # whose parts are exact
    common = {"control_period": period, "episode_duration": 2.0, "faults": {"valve_hysteresis": {"probability": 1.0}}}
    usual, slow = (
        ServoHydraulicVectorEnv(3, command_latency=latency, info=False, **common)
        for latency in (0.5 * period, (late + 0.5) * period)
    )
    for env in (usual, slow):
        env.reset(seed=0)
    held = usual.axes.column("command").copy()
    commands = np.random.default_rng(0).uniform(-0.4, 0.4, (steps, 3, 1))
    for step in range(steps):
        usual.step(commands[step - late] if step >= late else held[:, None])
        slow.step(commands[step])
        np.testing.assert_array_equal(slow.axes.state, usual.axes.state)
