"""Intervals: of shares, and by a bootstrap over plants and training seeds at once.

The bootstrap is stratified by family. Values of one controller are an array (S, U, K): S training seeds, U plants (each
belongs to one family of references), K situations of each plant (condition and leak); NaN if a plant was not run. A
resampling is a table of weights: how often each plant, and each training seed, is drawn. The first row has only weights
of 1 and gives the estimate; the others give the interval. Two controllers share the weights of plants: comparisons are
paired.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from hydro_env.types import Array, Floats

CONFIDENCE = 0.95
LEAST_SAMPLES = 3  # for an interval
RESAMPLES = 1000


class Interval(NamedTuple):
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float

    def named(self, name: str) -> dict[str, float]:
        """Columns of a table with several intervals: ``low`` and ``high`` follow the name of the value."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


UNKNOWN = Interval(np.nan, np.nan, np.nan)


def share_interval(hits: int, total: int) -> Interval:
    """A share with its 95 % Wilson interval."""
    if total == 0:
        return UNKNOWN
    interval = binomtest(hits, total).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(hits / total, interval.low, interval.high)


# Bootstrap ----------------------------------------------------------------------------------------------------------


class Weights(NamedTuple):
    """Weights of R resamplings, after a row of ones."""

    seeds: Floats  # (R + 1, S)
    plants: Floats  # (R + 1, U)


def plant_weights(strata: Array, resamples: int = RESAMPLES, seed: int = 0) -> Floats:
    """Draw plants with replacement within each stratum; (resamples + 1, U)."""
    generator = np.random.default_rng(seed)
    weights = np.ones((resamples + 1, len(strata)))
    for stratum in dict.fromkeys(strata):
        members = np.flatnonzero(strata == stratum)
        weights[1:, members] = generator.multinomial(len(members), np.full(len(members), 1 / len(members)), resamples)
    return weights


def seed_weights(count: int, resamples: int, seed: int = 0) -> Floats:
    """Draw training seeds with replacement; (resamples + 1, count)."""
    drawn = np.random.default_rng([seed, count, 1]).multinomial(count, np.full(count, 1.0 / count), resamples)
    return np.concatenate([np.ones((1, count)), drawn])


def means(values: Floats, weights: Weights) -> Floats:
    """Weighted mean of values (S, U, K) in every resampling, (R + 1,); NaN without values."""
    total, count = np.nansum(values, axis=2), np.sum(~np.isnan(values), axis=2)
    with np.errstate(invalid="ignore"):
        return _weighted(total, weights) / _weighted(count, weights)


def _weighted(values: Array, weights: Weights) -> Floats:
    """Σ over seeds and plants of weight · weight · value (S, U)."""
    return np.sum(weights.seeds * (weights.plants @ values.T), axis=1)


def interval(resampled: Floats, plants: int) -> Interval:
    """The estimate (first) and the percentiles of the resamplings; no interval with too few plants."""
    values = resampled[1:][np.isfinite(resampled[1:])]
    if plants < LEAST_SAMPLES or not len(values):
        return Interval(resampled[0], np.nan, np.nan)
    low, high = np.quantile(values, [0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)])
    return Interval(resampled[0], low, high)
