"""The measurement of speed: rows are sane, take turns, and stand beside each other round by round."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import speed


def test_rates_are_sane(monkeypatch):
    monkeypatch.setattr(speed, "SECONDS", 0.01)
    monkeypatch.setattr(speed, "CALLS", 200)
    assert speed.kernel_rate(16, 2) > 100
    assert speed.single_rate(speed.single_axis) > 100
    assert speed.vector_rate(partial(gym.make_vec, "ServoHydraulic-v0", num_envs=2, episode_duration=0.05)) > 100
    assert 0.0 < speed.call_of_the_policy() < 1000.0


def test_rows_take_turns_and_ratios_are_of_a_round(monkeypatch):
    monkeypatch.setattr(speed, "ROUNDS", 3)
    order, values = [], {"peer": [100.0, 200.0, 400.0], "own": [300.0, 400.0, 4000.0]}

    def measure(name):
        order.append(name)
        return values[name][order.count(name) - 1]

    rows = [
        speed.Row("peer", partial(measure, "peer"), "1/s"),
        speed.Row("own", partial(measure, "own"), "1/s", "peer"),
    ]
    peer, own = speed.measured("g", rows).to_dict("records")
    assert order == ["peer", "own"] * 3
    assert (own["median"], own["lowest"], own["highest"]) == (400.0, 300.0, 4000.0)
    assert own["ratio"] == pytest.approx(3.0)
    assert np.isnan(peer["ratio"])
