"""Means and paired ratios with bootstrap intervals over plants, means over seeds, value at risk, shares."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, bootstrap, ttest_1samp

Array = NDArray[np.floating[Any]]
CONFIDENCE = 0.95
RESAMPLES = 2000
LEAST_SAMPLES = 3
"""Smallest number of samples for an interval."""


class Interval(NamedTuple):
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float

    def columns(self, name: str) -> dict[str, float]:
        """Columns of a table: the value under its name, ``low`` and ``high``."""
        return {name: self.value, "low": self.low, "high": self.high}


def mean_interval(per_plant: Array, seed: int = 0) -> Interval:
    """Mean over plants with a 95 % bootstrap interval (percentile); NaNs are left out."""
    values = np.asarray(per_plant, dtype=np.float64)
    values = values[~np.isnan(values)]
    if len(values) == 0:
        return Interval(np.nan, np.nan, np.nan)
    return _interval((values,), lambda x, axis: np.mean(x, axis=axis), seed)


def seeds_interval(per_seed: Array) -> Interval:
    """Mean over training seeds with a 95 % interval of Student's t: too few values for a bootstrap."""
    values = np.asarray(per_seed, dtype=np.float64)
    mean = float(values.mean()) if len(values) else np.nan
    if len(values) < LEAST_SAMPLES:
        return Interval(mean, np.nan, np.nan)
    if np.ptp(values) == 0.0:
        return Interval(mean, mean, mean)
    interval = ttest_1samp(values, 0.0).confidence_interval(CONFIDENCE)
    return Interval(mean, float(interval.low), float(interval.high))


def ratio_interval(per_plant: Array, reference_per_plant: Array, seed: int = 0) -> Interval:
    """Ratio of two means on the same plants, with a paired 95 % bootstrap interval."""
    a, b = np.asarray(per_plant, dtype=np.float64), np.asarray(reference_per_plant, dtype=np.float64)
    kept = ~(np.isnan(a) | np.isnan(b))
    if not kept.any():
        return Interval(np.nan, np.nan, np.nan)
    return _interval((a[kept], b[kept]), lambda x, y, axis: np.mean(x, axis=axis) / np.mean(y, axis=axis), seed)


def geometric_ratio_interval(per_plant: Array, reference_per_plant: Array, seed: int = 0) -> Interval:
    """Geometric mean over groups of the ratio of means, (groups, plants) each, with a paired 95 % bootstrap interval.

    All groups have the same weight, independent of the size of their values.
    """
    a, b = np.asarray(per_plant, dtype=np.float64), np.asarray(reference_per_plant, dtype=np.float64)
    groups = len(a)

    def statistic(*samples: Array, axis: int) -> Any:
        logs = [
            np.log(np.mean(mine, axis=axis) / np.mean(theirs, axis=axis))
            for mine, theirs in zip(samples[:groups], samples[groups:], strict=True)
        ]
        return np.exp(sum(logs) / groups)

    return _interval((*a, *b), statistic, seed)


def _interval(samples: tuple[Array, ...], statistic: Any, seed: int) -> Interval:
    value = float(statistic(*samples, axis=0))
    if len(samples[0]) < LEAST_SAMPLES:
        return Interval(value, np.nan, np.nan)
    if all(np.ptp(sample) == 0.0 for sample in samples):
        return Interval(value, value, value)
    result = bootstrap(
        samples,
        statistic,
        paired=len(samples) > 1,
        vectorized=True,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    )
    return Interval(value, float(result.confidence_interval.low), float(result.confidence_interval.high))


def conditional_value_at_risk(values: Array, share: float = 0.05) -> float:
    """Mean of the worst ``share`` of the values (at least one); larger is worse. NaNs are left out."""
    ordered = np.sort(np.asarray(values, dtype=np.float64)[~np.isnan(values)])[::-1]
    if len(ordered) == 0:
        return float("nan")
    return float(ordered[: max(int(np.ceil(share * len(ordered))), 1)].mean())


def share_interval(hits: int, total: int) -> Interval:
    """A share with its 95 % Wilson interval."""
    if total == 0:
        return Interval(np.nan, np.nan, np.nan)
    interval = binomtest(int(hits), int(total)).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(hits / total, float(interval.low), float(interval.high))
