"""get_state and set_state: an episode that goes on from a saved state repeats bit for bit, wherever it goes on."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_equal
from refusal import refused

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv

TASK = {
    "episode_duration": 0.2,
    "leakage": {"schedule": "growth"},
    "disturbance": {"kind": "sine"},
    "references": {"weights": {"sine": 1.0, "step": 1.0, "user": 1.0}, "user": [0.0, 0.001, 0.003]},
}
ACTIONS = np.random.default_rng(8).uniform(-1, 1, (70, 6, 1))
OPTIONS = {"leakage_flow_lpm": 1.5}


def three(**settings):
    return ServoHydraulicVectorEnv(3, **settings)


def continued(env, steps=70):
    """All numbers over several episodes: the rest of this one, resets, and the next."""
    rows, single = [], isinstance(env, ServoHydraulicEnv)
    for action in ACTIONS[:steps]:
        observation, reward, terminated, truncated, info = env.step(action[0] if single else action[: env.num_envs])
        rows += [observation, reward, terminated, truncated, info["leakage_flow_lpm"], info["tracking_error"]]
        if single and (terminated or truncated):
            observation, info = env.reset()
            rows += [observation, info["reference"]]
    return rows


def begun(make=ServoHydraulicEnv, **options):
    env = make(**TASK)
    env.reset(seed=3, options=options or None)
    continued(env, 12)
    return env


CASES = [(ServoHydraulicEnv, options) for options in ({}, OPTIONS, {"reference": [0.0, 0.01]})]
CASES += [(three, {}), (lambda **task: three(autoreset_mode="SameStep", **task), OPTIONS)]


@pytest.mark.parametrize(("make", "options"), CASES)
def test_an_episode_and_all_that_follow_repeat_from_a_saved_state(make, options):
    env = begun(make, **options)
    continued(env, 28)  # of many axes, the step in which all have ended is the last one
    state = env.get_state()
    before, drawn = pickle.dumps(state), env.np_random.random(3)
    first = continued(env)
    env.set_state(state)
    assert_equal(env.np_random.random(3), drawn)
    env.set_state(state)
    assert_equal(continued(env), first)
    env.reset(seed=99)
    env.set_state(pickle.loads(pickle.dumps(state)))
    assert_equal(continued(env), first)
    fresh = make(**TASK)  # never reset
    fresh.set_state(state)
    assert_equal(continued(fresh), first)
    assert pickle.dumps(state) == before  # a copy, whatever has happened


def test_the_state_of_one_axis_goes_on_on_all_axes_of_another_environment():
    env, envs = begun(), three(**TASK)
    envs.reset(seed=50)
    generator = envs.np_random.bit_generator.state
    envs.set_state(env.get_state())
    assert envs.np_random.bit_generator.state == generator
    for action in ACTIONS[:25, 0]:
        mine = env.step(action)
        others = envs.step(np.repeat(action[None], 3, axis=0))
        for axis in range(3):
            np.testing.assert_array_equal(others[0][axis], mine[0])
            assert others[1][axis] == mine[1]


def test_wrong_states_are_answered_with_one_line():
    env, envs = begun(), three(**TASK)
    with refused("get_state: call reset first"):
        envs.get_state()
    envs.reset(seed=0)
    for each in (env, envs):
        for wrong in (None, [], {"arrays": 1}):
            with refused("set_state: must be a state from get_state"):
                each.set_state(wrong)
    with refused("set_state: this is the state of another task"):
        ServoHydraulicEnv().set_state(env.get_state())
    with refused("set_state: the state of 3 axes for 1"):
        env.set_state(envs.get_state())
