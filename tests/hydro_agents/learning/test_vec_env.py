"""The adaptor keeps to stable-baselines3's contract, and a twin cancels what no controller can help."""

import copy

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.learning.features import HISTORY_LAGS, HISTORY_SIGNALS, PolicyFeatures
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
LAYOUT = ObservationLayout.of(CONFIG)
BASE = PID(PIDGains(), CONFIG)


def make(count=6, base=BASE, **options):
    return AxisVecEnv(CONFIG, count, PolicyFeatures(CONFIG, base, 0.5), **options)


def test_paired_reward_of_the_pid_against_itself_is_zero():
    env = make(paired=True, seed=3)
    env.reset()
    assert all((env.step(np.zeros((6, 1)))[1] == 0.0).all() for _ in range(50))
    rewards = [env.step(np.ones((6, 1)))[1] for _ in range(4)]
    assert np.all(rewards[-1] < 0.0)
    with refused("residual form"):
        make(base=None, paired=True)


def test_stagger_spreads_the_ends_and_inputs_are_cut_off():
    env = make(count=10, stagger=True)
    env.reset()
    ends = [int(env.step(np.zeros((10, 1)))[2].sum()) for _ in range(20)]
    assert sum(ends) == 10
    assert max(ends) <= 2
    bare = make(base=None)
    bare.features = PolicyFeatures(CONFIG, None)
    bare.reset()
    cut = [bare._inputs(np.full((6, len(LAYOUT.names)), far, np.float32), None) for far in (1e6, -1e6)]
    assert (cut[0].max(), cut[1].min()) == (50.0, -50.0)


def test_history_holds_differences_at_the_lags_and_restarts_with_the_episode():
    features = PolicyFeatures(CONFIG, None)
    rows = np.random.default_rng(1).standard_normal((60, 3, len(LAYOUT.names))).astype(np.float32)
    memory = None
    for row in rows[:-1]:
        _, memory = features(row, memory, None)
    inputs, _ = features(rows[-1], memory, np.array([False, True, False]))
    past = inputs[:, len(LAYOUT.names) :].reshape(3, len(HISTORY_LAGS), len(HISTORY_SIGNALS))
    columns = [LAYOUT.index(name) for name in HISTORY_SIGNALS]
    for number, lag in enumerate(HISTORY_LAGS):
        differences = rows[-1][:, columns] - rows[-1 - lag][:, columns]
        np.testing.assert_allclose(past[[0, 2], number], differences[[0, 2]], rtol=1e-6)
    assert (past[1] == 0.0).all()


SHORT_STROKE = {
    "plant": {"cylinder": {"stroke": 0.06}, "load": {"spring_stiffness": 0.0}},
    "randomisation": {},
    "references": {"largest_amplitude": 0.01},
    "failure": {"end_stop_speed": 0.01},
    "initial_position_range": (0.0, 0.0),
}
"""Axes that hit an end stop within 0.2 s of full command."""


def test_a_physical_failure_is_no_time_limit():
    env = AxisVecEnv(TaskConfig(episode_duration=0.9, **SHORT_STROKE), 3, PolicyFeatures(CONFIG, None), seed=1)
    env.reset()
    rewards, ended = np.zeros(3), []
    for _ in range(env.env.config.steps - 1):
        _, reward, done, infos = env.step(np.ones((3, 1)))
        rewards += reward
        for axis in np.flatnonzero(done):
            ended.append(infos[axis])
            assert infos[axis]["TimeLimit.truncated"] is False
            assert infos[axis]["episode"]["r"] == pytest.approx(rewards[axis], rel=1e-5)
            assert 10 < infos[axis]["episode"]["l"] < 300
            rewards[axis] = 0.0
    assert len(ended) >= 3
    assert all(info["episode"]["r"] < -env.env.config.reward.failure for info in ended)


@pytest.mark.parametrize("kind", ["plain", "features", "paired"])
def test_state_goes_back_and_into_another_adaptor(kind):
    def build(seed):
        features = None if kind == "plain" else PolicyFeatures(CONFIG, BASE, 0.5)
        return AxisVecEnv(CONFIG, 4, features, seed=seed, paired=kind == "paired")

    def run(env):
        generator = np.random.default_rng(0)
        return [env.step(generator.uniform(-1, 1, (4, 1)).astype(np.float32)) for _ in range(30)]

    env, other = build(1), build(2)
    env.reset()
    other.reset()
    run(env)
    state = env.get_state()
    kept = copy.deepcopy(state)
    first = run(env)
    np.testing.assert_equal(state, kept)
    for again in (env, other):
        again.set_state(state)
        for (inputs, reward, done, infos), (inputs2, reward2, done2, infos2) in zip(first, run(again), strict=True):
            np.testing.assert_array_equal(inputs, inputs2)
            np.testing.assert_array_equal(reward, reward2)
            np.testing.assert_array_equal(done, done2)
            assert [info.get("episode") for info in infos] == [info.get("episode") for info in infos2]
