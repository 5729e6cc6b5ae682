"""The vector environment is N single environments, bit for bit, in each way of restarting."""

import copy
import pickle

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv

CRASHING = {
    "episode_duration": 0.25,
    "plant": {"cylinder": {"stroke": 0.12}, "load": {"spring_stiffness": 0.0}},
    "randomisation": {"load.mass": {"uniform": [40.0, 80.0]}, "supply.pressure": {"uniform": [60e5, 100e5]}},
}
"""Short strokes and no spring: some axes meet an end stop before the clock ends their episode."""


def actions_of(count, steps, seed=0):
    """Per axis a different mixture of noise and full commands held for a while."""
    rng = np.random.default_rng(seed)
    held = np.repeat(np.sign(rng.uniform(-1, 1, (steps // 50 + 1, count))), 50, axis=0)[:steps]
    noise = rng.uniform(-1, 1, (steps, count))
    return np.where(np.arange(count) % 3 == 0, noise, 0.2 * noise + held)[..., None].astype(np.float32)


def assert_equal_infos(native, sync, path="info"):
    """Same keys, same masks, same values; and the same kind of array."""
    assert set(native) == set(sync), path
    for key in native:
        mine, other = native[key], sync[key]
        if isinstance(other, dict):
            assert_equal_infos(mine, other, f"{path}.{key}")
        elif key == "final_obs":
            for a, b in zip(mine, other, strict=True):
                assert (a is None) == (b is None), path
                if a is not None:
                    np.testing.assert_array_equal(a, b)
        else:
            assert mine.shape == other.shape, f"{path}.{key}"
            assert mine.dtype == other.dtype, f"{path}.{key}"
            np.testing.assert_array_equal(mine, other, err_msg=f"{path}.{key}")


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_equal_to_single_environments_bit_for_bit(mode):
    count = 9
    native = ServoHydraulicVectorEnv(count, autoreset_mode=mode, **CRASHING)
    sync = SyncVectorEnv([lambda: ServoHydraulicEnv(**CRASHING)] * count, autoreset_mode=mode)
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"] == mode
    first, second = native.reset(seed=100), sync.reset(seed=100)
    np.testing.assert_array_equal(first[0], second[0])
    assert_equal_infos(first[1], second[1])
    terminations = truncations = 0
    for action in actions_of(count, 160):
        mine, other = native.step(action), sync.step(action)
        for a, b in zip(mine[:4], other[:4], strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        assert_equal_infos(mine[4], other[4])
        terminations += int(mine[2].sum())
        truncations += int(mine[3].sum())
        ended = mine[2] | mine[3]
        if mode == AutoresetMode.DISABLED and ended.any():
            mine, other = (env.reset(options={"reset_mask": ended.copy()}) for env in (native, sync))
            np.testing.assert_array_equal(mine[0], other[0])
            assert_equal_infos(mine[1], other[1])
    assert terminations > 0
    assert truncations > count  # more than one episode each


def test_seeds():
    def first(seed, count=4):
        envs = ServoHydraulicVectorEnv(count)
        return envs.reset(seed=seed)[0], envs

    rows, envs = first(10)
    np.testing.assert_array_equal(rows, first(10)[0])
    np.testing.assert_array_equal(rows, first([10, 11, 12, 13])[0])
    np.testing.assert_array_equal(rows[1:], first(11, 3)[0])
    assert len(np.unique(rows, axis=0)) == 4
    assert (first(None)[0] != first(None)[0]).any()
    # One seed per axis, None where the axis goes on.
    again, _ = envs.reset(seed=[None, 11, None, 13])
    np.testing.assert_array_equal(again[[1, 3]], rows[[1, 3]])
    assert (again[[0, 2]] != rows[[0, 2]]).any(axis=1).all()
    single = ServoHydraulicEnv()
    single.reset(seed=10)
    np.testing.assert_array_equal(again[0], single.reset()[0])
    partly = np.concatenate([first([3, None, None, None])[0] for _ in range(2)])
    assert len(np.unique(partly[:, 5])) == 7  # only the seeded axis repeats
    np.testing.assert_array_equal(partly[0], partly[4])


def numbers(info):
    """All arrays and numbers of an info, also inner ones, as they are now."""
    return copy.deepcopy({name: value for name, value in info.items() if name != "final_obs"})


BOTH = pytest.mark.parametrize(
    "make",
    [ServoHydraulicEnv, lambda **task: ServoHydraulicVectorEnv(130, autoreset_mode="SameStep", threads=2, **task)],
)


@BOTH
def test_what_is_returned_is_fresh_and_what_is_given_is_left_alone(make):
    env = make(**CRASHING)
    kept = [env.reset(seed=0)]
    copies = [(kept[0][0].copy(), numbers(kept[0][1]))]
    for number in range(60):
        action = np.full(env.action_space.shape, 0.1 * number - 3.0, np.float32)
        observation, *_, info = env.step(action)
        assert (action == np.float32(0.1 * number - 3.0)).all()
        assert not any(np.shares_memory(observation, row) for row, _ in kept)
        kept.append((observation, info))
        copies.append((observation.copy(), numbers(info)))
    for (observation, info), (before, info_before) in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(observation, before)
        np.testing.assert_equal(numbers(info), info_before)
    # What a caller writes into its arrays does not come back.
    observation[:] = 9.0
    info["reward_terms"]["effort"] = 7.0
    observation, *_ = env.step(np.zeros(env.action_space.shape))
    assert np.abs(observation[..., 0]).max() < 9.0
    if env.action_space.shape != (1,):
        observation[:] = 9.0
        partly, _ = env.reset(options={"reset_mask": np.arange(130) == 0})
        assert np.abs(partly[:, 0]).max() < 9.0


@BOTH
@pytest.mark.parametrize("duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy])
def test_a_copy_goes_on_like_the_original_and_both_may_be_closed_twice(make, duplicate):
    env = make()
    env.reset(seed=0)
    env.step(np.ones(env.action_space.shape))
    other = duplicate(env)
    for number in range(5):
        mine, copied = (each.step(np.full(env.action_space.shape, 0.1 * number)) for each in (env, other))
        np.testing.assert_equal(mine[:4], copied[:4])
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])
    for each in (env, env, other):
        each.close()
    assert np.isfinite(env.reset(seed=0)[0]).all()
