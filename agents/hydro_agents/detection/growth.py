"""The trend of a growing leak, and the time until its size reaches a limit.

The trend is that of log10 of the estimated size, averaged over blocks that are long against a window: the residuals of
a straight line through the blocks are nearly independent. The time to a limit has the interval of Fieller (*Some
problems in interval estimation*, J. Royal Statistical Society B 16, 1954): all times at which the limit lies within the
confidence band of the line.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hydro_agents.running.statistics import CONFIDENCE, Interval

BLOCK, LEAST_BLOCKS = 10.0, 5  # s, length of the blocks of looks for the trend of a growing leak; fewest of them


class Growth(NamedTuple):
    """Trend of one axis; NaN where there are too few looks, infinity where the limit is never reached."""

    decades_per_hour: Interval
    hours_to_limit: Interval  # from the last look on; 0: reached already


def growth(time: NDArray[Any], flow_lpm: NDArray[Any], limit_lpm: float, least_lpm: float = 0.0) -> Growth:
    """Growth of the leak of one axis.

    Args:
        time: (L,), s, of the looks.
        flow_lpm: (L,), estimated leak, l/min at 100 bar; NaN: no estimate.
        limit_lpm: the limit, l/min at 100 bar.
        least_lpm: smallest size that the detector can read; blocks up to the last one below it are left out.
    """
    unknown = Interval(np.nan, np.nan, np.nan)
    flow = np.asarray(flow_lpm, dtype=np.float64)
    known = np.isfinite(flow) & (flow > 0.0)
    hours, size = np.asarray(time, dtype=np.float64)[known] / 3600.0, np.log10(flow[known])
    if not len(hours):
        return Growth(unknown, unknown)
    which = np.unique(((hours - hours[0]) * 3600.0 / BLOCK).astype(np.int64), return_inverse=True)[1]
    counts = np.bincount(which)
    x, y = np.bincount(which, hours) / counts, np.bincount(which, size) / counts
    below = np.flatnonzero(y < np.log10(max(least_lpm, 1e-12)))
    x, y = (values[below[-1] + 1 :] if len(below) else values for values in (x, y))
    if len(x) < LEAST_BLOCKS:
        return Growth(unknown, unknown)
    centre, spread = x.mean(), float(((x - x.mean()) ** 2).sum())
    slope = float(((x - centre) * y).sum() / spread)
    level = float(y.mean())
    freedom = len(x) - 2
    variance = float(((y - level - slope * (x - centre)) ** 2).sum()) / freedom
    factor = float(student.ppf(0.5 * (1.0 + CONFIDENCE), freedom))
    half = factor * np.sqrt(variance / spread)
    missing = float(np.log10(limit_lpm)) - level
    end = float(hours[-1] - centre)
    low, high = _crossing(slope, missing, factor**2 * variance, len(x), spread)
    expected = missing / slope if slope > 0.0 else (-np.inf if missing <= 0.0 else np.inf)
    ahead = [max(value - end, 0.0) for value in (expected, low, high)]
    return Growth(Interval(slope, slope - half, slope + half), Interval(*ahead))


def _crossing(slope: float, missing: float, width: float, count: int, spread: float) -> tuple[float, float]:
    """Times x after the centre that bound (missing − slope · x)² ≤ width · (1/count + x²/spread)."""
    a = slope**2 - width / spread
    b = -2.0 * slope * missing
    c = missing**2 - width / count
    inside = b * b - 4.0 * a * c
    if a > 0.0 and slope > 0.0:  # the trend is significant: two ends
        root = np.sqrt(max(inside, 0.0))
        return (-b - root) / (2.0 * a), (-b + root) / (2.0 * a)
    if a > 0.0:  # it falls significantly
        return (-np.inf, -np.inf) if missing <= 0.0 else (np.inf, np.inf)
    if inside < 0.0 or c <= 0.0:  # nothing excluded
        return -np.inf, np.inf
    root = np.sqrt(inside)  # a < 0: outside both roots
    return max((-b - root) / (2.0 * a), (-b + root) / (2.0 * a)), np.inf
