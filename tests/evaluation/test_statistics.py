"""Intervals and tails against closed forms."""

import math

import numpy as np
import pytest

from hydro_agents.running.statistics import conditional_value_at_risk, mean_interval, ratio_interval, share_interval


def test_mean_interval_is_that_of_the_normal_distribution():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    found = mean_interval(values)
    half = 1.96 * values.std(ddof=1) / math.sqrt(400)
    assert found.value == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.15 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.15 * half)


def test_mean_interval_covers_the_truth_about_as_often_as_it_says():
    generator = np.random.default_rng(2)
    found = [mean_interval(generator.exponential(1.0, 32)) for _ in range(150)]
    assert 0.86 <= np.mean([interval.low <= 1.0 <= interval.high for interval in found]) <= 0.99


def test_mean_interval_leaves_nan_out():
    values = np.array([1.0, 2.0, 4.0, 7.0])
    assert mean_interval(np.array([1.0, np.nan, 2.0, 4.0, np.nan, 7.0])) == mean_interval(values)
    assert all(math.isnan(part) for part in mean_interval(np.array([np.nan, np.nan])))
    assert all(math.isnan(part) for part in mean_interval(np.array([])))


def test_two_plants_give_no_interval():
    found = mean_interval(np.array([1.0, 3.0]))
    assert found.value == 2.0
    assert math.isnan(found.low)
    assert math.isnan(found.high)
    assert math.isnan(ratio_interval(np.array([1.0, 3.0]), np.array([2.0, 2.0])).low)


def test_constant_values_have_no_spread():
    assert mean_interval(np.full(10, 0.25)) == (0.25, 0.25, 0.25)


def test_an_interval_is_the_percentile_bootstrap():
    values = np.random.default_rng(9).lognormal(size=15)
    generator = np.random.default_rng(0)
    means = [generator.choice(values, 15).mean() for _ in range(20_000)]
    found = mean_interval(values)
    spread = np.std(means)
    assert found.low == pytest.approx(np.quantile(means, 0.025), abs=0.1 * spread)
    assert found.high == pytest.approx(np.quantile(means, 0.975), abs=0.1 * spread)


def test_three_plants_are_enough_for_an_interval():
    found = mean_interval(np.array([1.0, 2.0, 6.0]))
    assert (found.low, found.high) == (1.0, 6.0)
    lists = ratio_interval([1, 2, 6], [1, 1, 1])  # whole numbers and lists are numbers too
    assert (lists.value, lists.low, lists.high) == (3.0, 1.0, 6.0)


def test_one_varying_sample_is_enough_for_an_interval():
    found = ratio_interval(np.array([1.0, 2.0, 3.0, 4.0]), np.ones(4))
    assert found.low < found.value < found.high


def test_intervals_are_reproducible():
    values = np.random.default_rng(3).lognormal(size=20)
    assert mean_interval(values) == mean_interval(values)


def test_strata_keep_the_number_of_plants_of_each():
    values, strata = np.repeat([1.0, 9.0], 5), np.repeat(["sine", "step"], 5)
    assert mean_interval(values, strata) == (5.0, 5.0, 5.0)
    assert mean_interval(values).low < 5.0


@pytest.mark.parametrize("factor", [1.0, 0.8, 3.0])
def test_ratio_of_proportional_arrays_is_exact_because_it_is_paired(factor):
    values = np.random.default_rng(6).lognormal(sigma=2.0, size=16)  # unpaired, the interval would be wide
    assert ratio_interval(factor * values, values) == pytest.approx((factor, factor, factor), rel=1e-12)


def test_ratio_is_of_the_means_and_keeps_pairs_together():
    a, b = np.array([1.0, 2.0, np.nan, 6.0]), np.array([1.0, 1.0, 9.0, 1.0])
    found = ratio_interval(a, b)
    assert found.value == pytest.approx(3.0)  # the plant without a value is left out of both
    assert found.low < found.value < found.high
    assert ratio_interval(a[[0, 1, 3]], b[[0, 1, 3]]) == found
    assert all(math.isnan(part) for part in ratio_interval(np.array([np.nan]), np.array([1.0])))


def test_conditional_value_at_risk():
    values = np.random.default_rng(7).permutation(np.arange(1.0, 101.0))
    assert conditional_value_at_risk(values) == pytest.approx(98.0)  # of 96 to 100
    assert conditional_value_at_risk(values, share=0.5) == pytest.approx(75.5)
    assert conditional_value_at_risk(values, share=1.0) == pytest.approx(50.5)
    assert conditional_value_at_risk(np.array([3.0, 8.0, np.nan])) == 8.0  # at least one
    assert math.isnan(conditional_value_at_risk(np.array([np.nan])))


def test_share_interval_is_wilsons():
    hits, total, z = 8, 10, 1.959964
    share = hits / total
    centre = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * math.sqrt(share * (1 - share) / total + z**2 / (4 * total**2))
    assert share_interval(hits, total) == pytest.approx((0.8, centre - half, centre + half), rel=1e-5)
    assert share_interval(0, 50)[:2] == (0.0, 0.0)
    assert share_interval(0, 50).high == pytest.approx(z**2 / (50 + z**2), rel=1e-5)
    assert math.isnan(share_interval(0, 0).value)
