"""Intervals without a bootstrap: means over training seeds, shares; and the value at risk."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, ttest_1samp

Array = NDArray[np.floating[Any]]
CONFIDENCE = 0.95
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

    def named(self, name: str) -> dict[str, float]:
        """Columns of a table with several intervals: ``low`` and ``high`` follow the name of the value."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


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
