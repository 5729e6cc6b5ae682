"""The measurement of speed: rows are sane, take turns, and stand beside each other round by round."""

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.speed import (
    QUICK,
    BareKernel,
    Row,
    inference_rows,
    measured,
    single_rate,
    vector_rate,
)


def test_the_bare_kernel_advances():
    kernel = BareKernel(16, 2)
    first = kernel.state.copy()
    assert kernel.advance() == 16
    assert not np.array_equal(kernel.state, first)
    kernel.close()


def test_rates_of_environments():
    assert single_rate(gym.make("ServoHydraulic-v0"), 0.01, 20) > 100
    env = gym.make_vec("ServoHydraulic-v0", num_envs=2, episode_duration=0.05)
    assert vector_rate(env, 0.01) > 100


def test_inference_takes_time():
    assert all(0.0 < row.measure() < 1000.0 for row in inference_rows(QUICK._replace(calls=200)))


def test_rows_take_turns_and_ratios_are_of_a_round():
    order, values = [], {"peer": [100.0, 200.0, 400.0], "own": [300.0, 400.0, 4000.0]}

    def measure(name):
        order.append(name)
        return values[name][order.count(name) - 1]

    rows = [Row("peer", lambda: measure("peer"), "1/s"), Row("own", lambda: measure("own"), "1/s", "peer")]
    peer, own = measured("g", rows, 3).to_dict("records")
    assert order == ["peer", "own"] * 3
    assert (own["median"], own["lowest"], own["highest"]) == (400.0, 300.0, 4000.0)
    assert own["ratio"] == pytest.approx(3.0)
    assert np.isnan(peer["ratio"])
