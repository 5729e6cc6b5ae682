"""Timing: when a command reaches the valve, and that an episode is the plant's own answer to those inputs."""

import numpy as np
import pytest

from hydro_env import ServoHydraulicEnv, equilibrium, simulate
from hydro_env.plant.states import STATE_NAMES

PERIOD = 5e-3
CLEAN = {"sensors": {"enabled": False}}


def commands(count=60, seed=0):
    """Commands with held stretches and jumps, some beyond the limit of ±1."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-0.7, 1.1, count // 5), 5)


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


def positions(latency, sequence, seed=4):
    env = ServoHydraulicEnv(command_latency=latency, **CLEAN)
    _, info = env.reset(seed=seed)
    hold = env.axes.column("command")[0]
    return np.array([info["position"]] + [env.step(np.array([u]))[-1]["position"] for u in sequence]), hold


def test_a_latency_of_one_period_delays_the_answer_by_one_period():
    sequence = commands()
    prompt, hold = positions(0.0, np.append([positions(0.0, [])[1]], sequence))
    late, _ = positions(PERIOD, sequence)
    assert abs(prompt[1] - prompt[0]) < 1e-9  # held at first
    # Late by one period: the same numbers with the holding command put in front.
    np.testing.assert_allclose(late, prompt[:-1], rtol=0, atol=1e-12)
    without, _ = positions(0.0, sequence)
    assert np.abs(late - without).max() > 1e-4
    assert hold == pytest.approx(positions(PERIOD, [])[1])


def test_more_latency_means_a_later_answer():
    answers = [positions(latency, np.full(10, 1.0))[0] for latency in (0.0, 1e-3, 2.5e-3, PERIOD)]
    ends = [answer[-1] for answer in answers]
    assert np.all(np.diff(ends) < 0.0)


def test_commands_beyond_the_limit_act_as_the_limit():
    (far, _), (edge, _) = (positions(1e-3, np.full(20, value)) for value in (7.0, 1.0))
    np.testing.assert_array_equal(far, edge)


def test_the_inner_step_is_fine_enough():
    """A tolerance a thousand times tighter moves the position by far less than the noise of 30 µm in half a second."""
    ends = []
    for settings in ({}, {"tolerance": 1e-9, "maximum_step": 0.125e-3}):
        env = ServoHydraulicEnv(**settings, **CLEAN)
        env.reset(seed=3)
        ends.append([env.step(np.array([u]))[-1]["position"] for u in commands(100)])
    assert np.abs(np.subtract(*ends)).max() < 1e-7
    assert np.ptp(ends[0]) > 0.01


def test_time_does_not_depend_on_the_control_period():
    """A command held over 20 ms does the same in four periods of 5 ms as in one of 20 ms."""
    ends = []
    for period in (5e-3, 10e-3, 20e-3):
        env = ServoHydraulicEnv(control_period=period, command_latency=0.0, **CLEAN)
        env.reset(seed=5)
        values = np.repeat([0.4, -0.2, 0.8], round(20e-3 / period))
        ends.append([env.step(np.array([u]))[-1]["position"] for u in values][-1])
    assert ends == pytest.approx([ends[0]] * 3, abs=1e-7)
