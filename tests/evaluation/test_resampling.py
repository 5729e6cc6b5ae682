"""Bootstrap over plants and training seeds: estimates by hand, intervals that cover, strata and pairs that hold."""

import numpy as np
import pytest
from scipy.stats import trim_mean

from hydro_agents.running.statistics import (
    Weights,
    improvements,
    interquartile_means,
    interval,
    means,
    plant_weights,
    seed_weights,
)


def weights(seeds, strata, resamples=400, seed=0):
    return Weights(seed_weights(seeds, resamples, seed), plant_weights(np.array(strata), resamples, seed))


def test_the_first_row_is_the_estimate_itself():
    values = np.random.default_rng(0).normal(size=(3, 8, 5))
    drawn = weights(3, ["a"] * 8)
    assert means(values, drawn)[0] == pytest.approx(values.mean())
    # 120 values: the middle half is exactly the one of scipy.
    assert interquartile_means(values, drawn)[0] == pytest.approx(trim_mean(values.ravel(), 0.25))


def test_a_resampling_is_what_repeated_plants_and_seeds_would_give():
    values = np.random.default_rng(1).normal(size=(2, 4, 3))
    drawn = Weights(np.array([[2.0, 0.0]]), np.array([[1.0, 3.0, 0.0, 0.0]]))
    repeated = np.concatenate([values[:1], values[:1]])[:, [0, 1, 1, 1]]
    assert means(values, drawn)[0] == pytest.approx(repeated.mean())
    assert interquartile_means(values, drawn)[0] == pytest.approx(trim_mean(repeated.ravel(), 0.25))


def test_missing_cases_do_not_count():
    values = np.array([[[1.0, np.nan], [3.0, 5.0], [np.nan, np.nan]]])
    ones = Weights(np.ones((1, 1)), np.ones((1, 3)))
    assert means(values, ones)[0] == 3.0
    assert interquartile_means(values, ones)[0] == pytest.approx(3.0)
    assert np.isnan(means(np.full((1, 2, 2), np.nan), Weights(np.ones((1, 1)), np.ones((1, 2)))))[0]
    assert np.isnan(interquartile_means(np.full((1, 2, 2), np.nan), Weights(np.ones((4, 1)), np.ones((4, 2))))).all()


def test_the_interquartile_mean_takes_parts_of_the_values_at_its_edges():
    values = np.array([0.0, 1.0, 2.0, 3.0, 100.0]).reshape(1, 5, 1)  # the middle 2.5 of 5: 0.75 · 1, 2, 0.75 · 3
    found = interquartile_means(values, Weights(np.ones((1, 1)), np.ones((1, 5))))[0]
    assert found == pytest.approx((0.75 + 2.0 + 2.25) / 2.5)


def test_each_stratum_keeps_its_number_of_plants():
    strata = np.array(["a", "a", "b", "b", "b"])
    drawn = plant_weights(strata, 200)
    assert np.all(drawn[:, :2].sum(axis=1) == 2.0)
    assert np.all(drawn[:, 2:].sum(axis=1) == 3.0)
    assert len(np.unique(drawn, axis=0)) > 20
    np.testing.assert_array_equal(drawn, plant_weights(strata, 200))
    assert np.all(seed_weights(4, 50).sum(axis=1) == 4.0)


def test_intervals_cover_the_true_mean_of_plants():
    generator = np.random.default_rng(2)
    drawn = weights(1, ["a"] * 30, 300)
    hits = 0
    for _ in range(200):
        values = generator.exponential(size=(1, 30, 1))
        _, low, high = interval(means(values, drawn), 30)
        hits += low <= 1.0 <= high
    assert 0.86 <= hits / 200 <= 0.98


def test_training_seeds_widen_the_interval():
    generator = np.random.default_rng(3)
    plants = generator.normal(size=(1, 20, 4))
    seeds = generator.normal(size=(5, 1, 1))
    drawn = weights(5, ["a"] * 20)
    alike = interval(means(np.repeat(plants, 5, axis=0), drawn), 20)
    scattered = interval(means(plants + seeds, drawn), 20)
    assert scattered.high - scattered.low > 1.5 * (alike.high - alike.low)


def test_pairs_cancel_what_plants_have_in_common():
    generator = np.random.default_rng(4)
    hard = generator.exponential(size=(1, 12, 1)) + 0.1
    drawn = weights(1, ["a"] * 12)
    ratio = interval(means(0.5 * hard, drawn) / means(hard, drawn), 12)
    assert (ratio.low, ratio.high) == (pytest.approx(0.5), pytest.approx(0.5))


def test_probability_of_improvement_counts_pairs_of_training_seeds():
    mine = np.array([1.0, 3.0]).reshape(2, 1, 1)
    theirs = np.array([2.0, 3.0, 4.0]).reshape(3, 1, 1)
    ones = Weights(np.ones((1, 2)), np.ones((1, 1)))
    # 1 beats all three; 3 loses, ties, wins.
    assert improvements(mine, theirs, ones, np.ones((1, 3)))[0] == pytest.approx((3 + 1.5) / 6)
    assert improvements(mine, theirs, Weights(np.array([[0.0, 2.0]]), ones.plants), np.array([[3.0, 0, 0]]))[0] == 0.0


def test_too_few_plants_have_no_interval():
    value, low, high = interval(np.array([1.0, 0.9, 1.1]), 2)
    assert value == 1.0
    assert np.isnan([low, high]).all()
    assert np.isnan(interval(np.array([1.0, np.nan, np.inf]), 9)[1:]).all()
