"""The adaptor keeps to stable-baselines3's contract, and a twin cancels what no controller can help."""

import numpy as np
import pytest

from agents.controllers import PID, ObservationLayout, PIDGains
from agents.learning.features import HISTORY_LAGS, HISTORY_SIGNALS, PolicyFeatures
from agents.learning.vec_env import AxisVecEnv
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
LAYOUT = ObservationLayout.of(CONFIG)
GAINS = PIDGains()


def make(count=6, gains=GAINS, **options):
    return AxisVecEnv(CONFIG, count, PolicyFeatures(LAYOUT, gains, 0.5), **options)


def test_residual_of_zero_is_the_pid():
    env = make(seed=11)
    env.reset()
    plain = ServoHydraulicVectorEnv(6, CONFIG, autoreset_mode="SameStep")
    observation, _ = plain.reset(seed=11)
    pid, memory, ended = PID(GAINS, LAYOUT), None, None
    for _ in range(45):
        inputs, reward, done, _ = env.step(np.zeros((6, 1)))
        action, memory = pid.predict(observation, memory, ended)
        observation, expected, terminated, truncated, _ = plain.step(action)
        ended = terminated | truncated
        np.testing.assert_array_equal(reward, expected.astype(np.float32))
        np.testing.assert_array_equal(done, ended)
        np.testing.assert_array_equal(inputs[:, : len(LAYOUT.names)], observation)


def test_paired_reward_of_the_pid_against_itself_is_zero():
    env = make(paired=True, seed=3)
    env.reset()
    for step in range(50):
        _, reward, _, _ = env.step(np.zeros((6, 1)))
        assert np.all(reward == 0.0), step
    _, reward, _, _ = env.step(np.ones((6, 1)))
    for _ in range(3):
        _, reward, _, _ = env.step(np.ones((6, 1)))
    assert np.all(reward < 0.0)


def test_infos_of_ended_axes():
    env = make(seed=5)
    env.reset()
    for step in range(20):
        inputs, _, done, infos = env.step(np.zeros((6, 1)))
        if step < 19:
            assert not done.any()
            assert all(info == {} for info in infos)
    assert done.all()
    for axis, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["episode"]["l"] == 20
        assert info["terminal_observation"].shape == inputs[axis].shape
        assert not np.array_equal(info["terminal_observation"], inputs[axis])


def test_stagger_spreads_the_ends():
    env = make(count=10, stagger=True)
    env.reset()
    ends = [int(env.step(np.zeros((10, 1)))[2].sum()) for _ in range(20)]
    assert sum(ends) == 10
    assert max(ends) <= 2


def test_history_holds_differences_at_the_lags():
    features = PolicyFeatures(LAYOUT, None)
    generator = np.random.default_rng(1)
    rows = generator.standard_normal((60, 3, len(LAYOUT.names))).astype(np.float32)
    memory = None
    for row in rows:
        inputs, memory = features(row, memory, None)
    past = inputs[:, len(LAYOUT.names) :].reshape(3, len(HISTORY_LAGS), len(HISTORY_SIGNALS))
    columns = [LAYOUT.index(name) for name in HISTORY_SIGNALS]
    for number, lag in enumerate(HISTORY_LAGS):
        np.testing.assert_allclose(past[:, number], rows[-1][:, columns] - rows[-1 - lag][:, columns], rtol=1e-6)


def test_history_restarts_with_the_episode():
    features = PolicyFeatures(LAYOUT, None)
    rows = np.random.default_rng(1).standard_normal((5, 2, len(LAYOUT.names))).astype(np.float32)
    memory = None
    for row in rows[:-1]:
        _, memory = features(row, memory, None)
    inputs, _ = features(rows[-1], memory, np.array([True, False]))
    assert np.all(inputs[0, len(LAYOUT.names) :] == 0.0)
    assert np.any(inputs[1, len(LAYOUT.names) :] != 0.0)


def test_vec_env_methods():
    env = make()
    assert env.get_attr("num_envs") == [6] * 6
    assert env.env_is_wrapped(object) == [False] * 6
    assert env.seed(4) == [4, 5, 6, 7, 8, 9]
    first = env.reset()
    env.seed(4)
    np.testing.assert_array_equal(env.reset(), first)
    env.set_options({"leakage_flow_lpm": 2.0})
    env.reset()
    np.testing.assert_allclose(env.env.axes.column("leak_flow"), 2.0)


def test_pairing_needs_a_pid():
    with pytest.raises(ConfigurationError, match="residual form"):
        make(gains=None, paired=True)
