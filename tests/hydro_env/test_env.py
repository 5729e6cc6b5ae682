"""The single environment as Gymnasium and stable-baselines3 expect it: checkers, seeds, spec, copies, threads."""

import json
import random
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_equal

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv

ID = "ServoHydraulic-v0"


def rollout(env, steps=60, action_seed=0, **reset):
    """Observations, rewards and flags of one episode's beginning with random actions."""
    rng = np.random.default_rng(action_seed)
    rows = [env.reset(**reset)[0]]
    rest = []
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 1).astype(np.float32))
        rows.append(observation)
        rest.append((reward, terminated, truncated))
    return np.array(rows), np.array(rest)


@pytest.fixture(autouse=True)
def a_warning_is_an_error():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_gymnasium_and_stable_baselines3_find_nothing_to_complain_about():
    env = gym.make(ID)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
    json.dumps(info)  # plain numbers and words
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(ServoHydraulicEnv(), warn=True, skip_render_check=True)


def test_spaces_and_layout_of_the_observation():
    env = ServoHydraulicEnv()
    assert env.action_space == gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    assert env.observation_space.shape == (13,)
    assert env.observation_space.dtype == np.float32
    assert np.isfinite(env.observation_space.high).all()
    np.testing.assert_array_equal(env.observation_space.low, -env.observation_space.high)
    names = env.observation_names
    assert len(set(names)) == 13
    largest = dict(zip(names, env.observation_space.high * env.observation_scale, strict=True))
    assert largest["pressure_b"] >= 400e5 * (1 - 1e-6)  # the transducer's range
    assert largest["position"] >= 0.2
    assert largest["previous_command"] == largest["spool_position"] == 1.0
    units = dict(zip(names, env.observation_units, strict=True))
    assert units["position"] == units["reference"] == units["tracking_error"] == "m"
    assert (units["pressure_a"], units["pressure_b"], units["velocity_estimate"]) == ("Pa", "Pa", "m/s")
    assert (env.observation_scale > 0.0).all()
    vector = ServoHydraulicVectorEnv(2)
    assert vector.observation_names == names
    np.testing.assert_array_equal(vector.observation_scale, env.observation_scale)


def test_the_same_seed_gives_the_same_episode_and_without_a_seed_nothing_repeats():
    env = ServoHydraulicEnv()
    first = rollout(env, seed=5)
    assert_equal(first, rollout(env, seed=5))
    assert_equal(first, rollout(ServoHydraulicEnv(), seed=5))
    others = [env.reset(seed=seed)[0] for seed in range(10)]
    others += [env.reset()[0] for _ in range(5)] + [ServoHydraulicEnv().reset()[0] for _ in range(5)]
    assert len(np.unique(others, axis=0)) == 20
    env.reset(seed=11)
    generator, _ = gym.utils.seeding.np_random(11)
    generator.integers(0, 2**64, dtype=np.uint64)  # the root of the axis
    assert env.np_random.bit_generator.state == generator.bit_generator.state


def test_global_random_generators_stay_untouched():
    env, states = ServoHydraulicEnv(), []
    random.seed(1)
    np.random.seed(1)
    for _ in range(2):
        states.append((random.getstate(), np.random.get_state()))
        rollout(env, seed=None)
        first = rollout(env, seed=3)
    assert_equal(*states)
    # And the other way round: they have no influence.
    random.seed(2)
    np.random.seed(2)
    assert_equal(first, rollout(ServoHydraulicEnv(), seed=3))


def test_no_leak_is_told_as_none():
    envs = ServoHydraulicVectorEnv(2, leakage={"schedule": "growth"}, autoreset_mode="Disabled")
    _, info = envs.reset(seed=1, options={"leakage_flow_lpm": 0.0})
    assert envs.axes.parameters(0).leakage.internal_resistance == np.inf
    for _ in range(400):
        assert (info["leakage_flow_lpm"] == 0.0).all()
        assert (info["leakage_resistance"] == np.inf).all()
        assert (info["leakage_class"] == 0).all()
        observation, _, _, _, info = envs.step(np.full((2, 1), 0.1))
        assert np.isfinite(observation).all()


def test_whoever_steps_on_after_the_end_is_told_so_each_time():
    env = ServoHydraulicEnv(episode_duration=0.05, references={"preview_times": []})
    env.reset(seed=0, options={"reference": 0.001 * np.arange(30)})
    for step in range(1, 40):
        observation, _, terminated, truncated, info = env.step(np.zeros(1))
        assert truncated == (step >= 10)
        assert not terminated
        assert info["reference"] == pytest.approx(0.001 * min(step, 10))
        assert env.observation_space.contains(observation)
