"""Bootstrap over plants and training seeds, intervals and tails: closed forms, coverage, strata and pairs that hold."""

import math

import numpy as np
import pytest

from hydro_agents.running.statistics import Weights, interval, means, plant_weights, seed_weights, share_interval


def mean_interval(values):
    """The interval of the mean of one value per plant."""
    drawn = weights(1, ["a"] * len(values), 1000)
    return interval(means(np.array(values)[None, :, None], drawn), len(values))


def test_an_interval_is_the_percentile_bootstrap():
    values = np.random.default_rng(9).lognormal(size=15)
    generator = np.random.default_rng(0)
    means = [generator.choice(values, 15).mean() for _ in range(20_000)]
    found = mean_interval(values)
    spread = np.std(means)
    assert found.low == pytest.approx(np.quantile(means, 0.025), abs=0.1 * spread)
    assert found.high == pytest.approx(np.quantile(means, 0.975), abs=0.1 * spread)


def test_share_interval_is_wilsons():
    hits, total, z = 8, 10, 1.959964
    share = hits / total
    centre = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * math.sqrt(share * (1 - share) / total + z**2 / (4 * total**2))
    assert share_interval(hits, total) == pytest.approx((0.8, centre - half, centre + half), rel=1e-5)
    assert share_interval(0, 50)[:2] == (0.0, 0.0)
    assert share_interval(0, 50).high == pytest.approx(z**2 / (50 + z**2), rel=1e-5)
    assert math.isnan(share_interval(0, 0).value)


def weights(seeds, strata, resamples=400, seed=0):
    return Weights(seed_weights(seeds, resamples, seed), plant_weights(np.array(strata), resamples, seed))


def test_the_first_row_is_the_estimate_itself_and_strata_keep_their_number_of_plants():
    values = np.random.default_rng(0).normal(size=(3, 8, 5))
    drawn = weights(3, ["a"] * 8)
    assert means(values, drawn)[0] == pytest.approx(values.mean())
    strata = np.array(["a", "a", "b", "b", "b"])
    drawn = plant_weights(strata, 200)
    assert [set(drawn[:, strata == name].sum(axis=1)) for name in "ab"] == [{2.0}, {3.0}]
    assert len(np.unique(drawn, axis=0)) > 20
    np.testing.assert_array_equal(drawn, plant_weights(strata, 200))
    assert np.all(seed_weights(4, 50).sum(axis=1) == 4.0)


def test_a_resampling_is_what_repeated_plants_and_seeds_would_give():
    values = np.random.default_rng(1).normal(size=(2, 4, 3))
    drawn = Weights(np.array([[2.0, 0.0]]), np.array([[1.0, 3.0, 0.0, 0.0]]))
    repeated = np.concatenate([values[:1], values[:1]])[:, [0, 1, 1, 1]]
    assert means(values, drawn)[0] == pytest.approx(repeated.mean())


def ones(plants, resamples=1):
    return Weights(np.ones((resamples, 1)), np.ones((resamples, plants)))


def test_missing_cases_do_not_count():
    values = np.array([[[1.0, np.nan], [3.0, 5.0], [np.nan, np.nan]]])
    nothing = np.full((1, 2, 2), np.nan)
    assert means(values, ones(3))[0] == 3.0
    assert np.isnan(means(nothing, ones(2)))[0]


def test_training_seeds_widen_the_interval():
    generator = np.random.default_rng(3)
    plants = generator.normal(size=(1, 20, 4))
    seeds = generator.normal(size=(5, 1, 1))
    drawn = weights(5, ["a"] * 20)
    alike = interval(means(np.repeat(plants, 5, axis=0), drawn), 20)
    scattered = interval(means(plants + seeds, drawn), 20)
    assert scattered.high - scattered.low > 1.5 * (alike.high - alike.low)
