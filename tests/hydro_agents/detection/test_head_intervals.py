"""Intervals hold the truth in nine of ten cases at every size, whatever the network's own quantiles are like."""

import numpy as np

from hydro_agents.detection.intervals import SIZES, distances, intervals


def answers(count, seed):
    """Sizes, and quantiles of a network that errs: too small where leaks are small, too sure where they are large."""
    generator = np.random.default_rng(seed)
    size = generator.uniform(-2.0, 0.7, count)
    middle = size - 0.03 * (size < -1.0) + np.where(size > 0.0, 0.1, 0.03) * generator.standard_normal(count)
    return size, np.column_stack([middle - 0.05, middle, middle + 0.07])


def test_distances_of_one_give_the_quantiles_themselves():
    quantiles = np.array([[-1.3, -1.0, -0.9], [0.0, 0.3, 0.5]])
    np.testing.assert_allclose(intervals(quantiles, np.ones((2, len(SIZES), 2))), quantiles[:, [1, 0, 2]])


def test_intervals_hold_at_every_size():
    size, quantiles = answers(40_000, 0)
    table = distances(quantiles, size, np.ones(len(size), dtype=bool))
    size, quantiles = answers(40_000, 1)
    _, low, high = intervals(quantiles, np.repeat(table[None], len(size), axis=0)).T
    held = (low <= size) & (size <= high)
    for begin in np.arange(-1.8, 0.5, 0.3):
        if abs(begin + 1.0) > 0.35 and abs(begin) > 0.35:  # where the network's errors jump, the mean of both counts
            assert 0.87 < held[(size >= begin) & (size < begin + 0.3)].mean() < 0.94, begin
    raw = (quantiles[:, 0] <= size) & (size <= quantiles[:, 2])
    assert raw[size > 0.2].mean() < 0.6


def test_a_size_that_the_group_hardly_has_takes_the_windows_of_all_groups():
    size, quantiles = answers(4000, 2)
    few = np.zeros(len(size), dtype=bool)
    few[:50] = True
    np.testing.assert_array_equal(distances(quantiles, size, few), distances(quantiles, size, np.ones_like(few)))
