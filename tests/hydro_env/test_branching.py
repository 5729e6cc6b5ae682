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


def continued(env, steps=70):
    """All numbers of a single environment over several episodes: the rest of this one, resets, and the next."""
    rows = []
    for action in ACTIONS[:steps, 0]:
        observation, reward, terminated, truncated, info = env.step(action)
        rows += [observation, reward, terminated, truncated, info["leakage_flow_lpm"], info["tracking_error"]]
        if terminated or truncated:
            observation, info = env.reset()
            rows += [observation, info["reference"]]
    return rows


def continued_many(envs, steps=70, axes=slice(None)):
    rows = []
    for action in ACTIONS[:steps]:
        observation, reward, terminated, truncated, info = envs.step(action[: envs.num_envs])
        rows += [array[axes] for array in (observation, reward, terminated, truncated, info["leakage_flow_lpm"])]
    return rows


def begun(**options):
    env = ServoHydraulicEnv(**TASK)
    env.reset(seed=3, options=options or None)
    for action in ACTIONS[:12, 1]:
        env.step(action)
    return env


@pytest.mark.parametrize("options", [{}, OPTIONS, {"reference": [0.0, 0.01]}], ids=["drawn", "leak", "reference"])
def test_an_episode_and_all_that_follow_repeat_from_a_saved_state(options):
    env = begun(**options)
    state = env.get_state()
    first = continued(env)
    env.set_state(state)
    assert_equal(continued(env), first)
    env.reset(seed=99)
    env.set_state(pickle.loads(pickle.dumps(state)))
    assert_equal(continued(env), first)
    fresh = ServoHydraulicEnv(**TASK)  # never reset
    fresh.set_state(state)
    assert_equal(continued(fresh), first)


def test_a_state_is_a_copy_and_holds_the_generator():
    env = begun()
    state = env.get_state()
    before, drawn = pickle.dumps(state), env.np_random.random(3)
    continued(env)
    env.set_state(state)
    assert_equal(env.np_random.random(3), drawn)
    continued(env)
    assert pickle.dumps(state) == before


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_vector_environment_repeats_with_its_automatic_resets(mode):
    envs = ServoHydraulicVectorEnv(6, autoreset_mode=mode, **TASK)
    envs.reset(seed=1)
    continued_many(envs, 40)  # ends in the step in which all axes have ended
    state = envs.get_state()
    first = continued_many(envs)
    envs.set_state(state)
    assert_equal(continued_many(envs), first)
    fresh = ServoHydraulicVectorEnv(6, autoreset_mode=mode, **TASK)
    fresh.set_state(state)
    assert_equal(continued_many(fresh), first)


def test_some_axes_go_back_while_the_others_go_on():
    envs, undisturbed = ServoHydraulicVectorEnv(6, **TASK), ServoHydraulicVectorEnv(6, **TASK)
    for each in (envs, undisturbed):
        each.reset(seed=1)
        continued_many(each, 10)
    state = envs.get_state([4, 1])
    first = continued_many(envs, 20)
    continued_many(undisturbed, 20)
    envs.set_state(state, [4, 1])
    again, rest = continued_many(envs, 20), continued_many(undisturbed, 20)
    for row, of_first, other in zip(again, first, rest, strict=True):
        np.testing.assert_array_equal(row[[1, 4]], of_first[[1, 4]])
        np.testing.assert_array_equal(row[[0, 2, 3, 5]], other[[0, 2, 3, 5]])


def test_states_move_between_single_and_vector_environments():
    env = begun()
    envs = ServoHydraulicVectorEnv(3, **TASK)
    envs.reset(seed=50)
    state = env.get_state()
    generator = envs.np_random.bit_generator.state
    envs.set_state(state)  # one state for all axes
    assert envs.np_random.bit_generator.state == generator
    for action in ACTIONS[:25, 0]:
        mine = env.step(action)
        others = envs.step(np.repeat(action[None], 3, axis=0))
        for axis in range(3):
            np.testing.assert_array_equal(others[0][axis], mine[0])
            assert others[1][axis] == mine[1]
    back = ServoHydraulicEnv(**TASK)
    back.set_state(envs.get_state([2]))
    assert_equal(continued(back), continued(env))
    envs.set_state([state, envs.get_state([0]), state])  # a list with one for each
    rows = envs.step(np.repeat(ACTIONS[:1, 0], 3, axis=0))[0]
    np.testing.assert_array_equal(rows[0], rows[2])
    assert (rows[0] != rows[1]).any()


def test_the_drawn_past_belongs_to_the_state():
    env = ServoHydraulicEnv(render_mode="rgb_array", **TASK)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.ones(1))
    state, picture = env.get_state(), env.render()
    env.step(-np.ones(1))
    env.set_state(state)
    np.testing.assert_array_equal(env.render(), picture)
    env.close()


def test_wrong_states_are_answered_with_one_line():
    env, envs = begun(), ServoHydraulicVectorEnv(3, **TASK)
    state = env.get_state()
    with refused("get_state: call reset first"):
        envs.get_state()
    with refused("set_state: call reset first, or give all axes a state"):
        envs.set_state(state, [0])
    envs.reset(seed=0)
    for each in (env, envs):
        for wrong in (None, 3, "state", [], [None], {"arrays": 1}):
            with refused("set_state: must be a state from get_state"):
                each.set_state(wrong)
    for each, given, axes, message in (
        (ServoHydraulicEnv(), state, (), "set_state: this is the state of another task"),
        (env, envs.get_state(), (), "set_state: the state of 3 axes for 1: must be as many, or one"),
        *((envs, state, ([axis],), r"axes = .*: must be a whole number within 0 to 2") for axis in (3, -1, 0.5)),
        *((envs, state, (axes,), r"axes = .*: must be numbers of axes, each named once") for axes in ([], [1, 1])),
    ):
        with refused(message):
            each.set_state(given, *axes)
        if axes:
            with refused(message):
                each.get_state(*axes)
