"""Rewards and ends of episodes: named terms that add up, failures that are physical, truncation by the clock."""

import numpy as np
import pytest

from hydro_env import ServoHydraulicEnv
from hydro_env.plant.kernel import PEAK_PRESSURE
from hydro_env.task.rewards import REWARD_TERMS

FREE = {"load": {"spring_stiffness": 0.0}}


def rollout(env, policy, seed=0, options=None):
    """Rewards, infos and flags of one episode."""
    env.reset(seed=seed, options=options)
    rows, step = [], 0
    while True:
        _, reward, terminated, truncated, info = env.step(np.array([policy(step)]))
        rows.append((reward, info, terminated, truncated))
        step += 1
        if terminated or truncated:
            return rows


def test_the_reward_is_the_sum_of_its_terms_and_each_is_what_the_configuration_says():
    reward = {"tracking": 2.0, "error_scale": 0.004, "error_limit": 3.0, "effort": 0.5}
    commands = np.append(np.zeros(20), np.random.default_rng(1).uniform(-1.5, 1.5, 380))
    env = ServoHydraulicEnv(reward=reward)
    env.reset(seed=1)
    previous, limited = env.axes.column("command")[0], 0
    for command in commands:
        _, total, terminated, _, info = env.step(np.array([command]))
        assert not terminated
        error, acting, terms = abs(info["tracking_error"]), np.clip(command, -1.0, 1.0), info["reward_terms"]
        assert info["tracking_error"] == info["reference"] - info["position"]
        assert tuple(terms) == REWARD_TERMS == ("tracking", "effort", "failure")
        assert total == pytest.approx(sum(terms.values()), rel=1e-12, abs=1e-15)
        assert terms["tracking"] == pytest.approx(-2.0 * min(error / 0.004, 3.0), rel=1e-12)
        assert terms["effort"] == pytest.approx(-0.5 * (acting - previous) ** 2, rel=1e-9, abs=1e-15)
        assert terms["failure"] == 0.0
        limited += error > 0.012
        previous = acting
    assert 0 < limited < 400  # the limit was met, and not always
    rows = rollout(ServoHydraulicEnv(reward=dict.fromkeys(REWARD_TERMS, 0.0)), lambda _: 0.5)
    assert {row[0] for row in rows} == {0.0}


@pytest.mark.parametrize(("side", "start"), [(1.0, 0.08), (-1.0, -0.09)])
def test_an_end_stop_met_at_speed_terminates_and_is_paid_once(side, start):
    env = ServoHydraulicEnv(plant=FREE, randomisation={}, reward={"failure": 123.0})
    *before, last = rollout(env, lambda _: side, options={"initial_position": start, "reference": "step"})
    assert all(info["failure"] == "none" and info["reward_terms"]["failure"] == 0.0 for _, info, _, _ in before)
    assert not any(terminated or truncated for _, _, terminated, truncated in before)
    reward, info, terminated, truncated = last
    assert (terminated, truncated, info["failure"]) == (True, False, "end stop hit at speed")
    assert info["reward_terms"]["failure"] == -123.0 > reward
    # It was this end of the stroke, within the way of one period.
    assert side * info["position"] == pytest.approx(0.2, abs=1e-3)
    assert side * before[-1][1]["velocity"] > 0.05
    assert side * before[-1][1]["position"] < 0.2


@pytest.mark.parametrize("allowed", [0.05, 0.01])
def test_an_end_stop_met_slowly_is_no_failure(allowed):
    """Also: whoever rests against the stop goes on until the clock."""
    env = ServoHydraulicEnv(plant=FREE, randomisation={}, episode_duration=4.0, failure={"end_stop_speed": allowed})
    rows = rollout(env, lambda _: 0.2, options={"initial_position": 0.17, "reference": "step"})
    _, info, terminated, truncated = rows[-1]
    if allowed == 0.01:  # the same move is a failure where less speed is allowed
        assert info["failure"] == "end stop hit at speed"
        return
    assert (terminated, truncated, len(rows)) == (False, True, 800)
    assert info["position"] == pytest.approx(0.2, abs=2e-3)
    assert max(row[1]["position"] for row in rows) > 0.2  # it presses into the stop


def test_the_rated_pressure_is_watched_between_the_samples():
    """A peak shorter than the control period counts: the rating lies between the highest sample and the peak."""
    slow = {"control_period": 0.02, "command_latency": 0.0, "randomisation": {}}
    options = {"initial_position": 0.0, "reference": "step"}

    def policy(step):
        return 1.0 if step % 4 < 2 else -1.0

    env = ServoHydraulicEnv(**slow)
    env.reset(seed=0, options=options)
    peaks, samples = [], []
    for step in range(40):
        env.step(np.array([policy(step)]))
        peaks.append(env.axes.peaks[0, PEAK_PRESSURE])
        samples.append(max(env.axes.state[0, 2:4]))
    highest = int(np.argmax(peaks))
    assert peaks[highest] > max(samples) + 1e3
    rating = 0.5 * (peaks[highest] + max(samples))
    assert max(samples) < rating < peaks[highest]
    rows = rollout(ServoHydraulicEnv(**slow, failure={"pressure_rating": rating}), policy, options=options)
    assert len(rows) <= highest + 1
    assert rows[-1][1]["failure"] == "pressure above the rating"
