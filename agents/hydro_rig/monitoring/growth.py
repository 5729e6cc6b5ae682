"""The trend of a growing leak, and the time until its size reaches a limit.

The model: log10 of the size is level, then from a knee on rises in a straight line. The errors of the readings have two
parts, one that is independent from reading to reading, and one that lasts (an exponential correlation): readings in one
manner of operation err alike. Knee, share and length of the lasting part are averaged over, each weighted by how well
it explains the readings (Bayes, with flat priors of level and slope); level, slope and size of the errors have closed
forms (Student's t). A straight line with independent errors, without this average, gives intervals that are too narrow.
A reading far from the line through its neighbours is left out. An error that all readings share, as of a thermometer,
moves the level, and widens what is said about it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import t as student

from hydro_agents.running.statistics import Interval
from hydro_env.types import Floats

INSIDE = 0.9  # probability of the intervals
EARLIEST = 0.01  # probability that the limit is reached before "not before"
FEWEST = 5  # readings, for a trend
MOST = 150  # readings; more are averaged
LASTING = (0.3, 0.6, 0.9)  # shares of the lasting errors in the variance, beside none
LENGTHS = (0.03, 0.1, 0.3)  # of the lasting errors, as a share of the time between the first and the last reading
KNEES = 10  # places of the knee, beside the first reading
STRAIGHT = 0.5  # probability beforehand of no knee, and of no lasting errors
AFTER_KNEE = 3  # fewest readings after the knee
KNOWN_FREEDOM = 4.0  # degrees of freedom that standard deviations of the readings are worth
FARTHEST = 100.0  # time to the limit that counts as never, as a multiple of the time of the readings
NEIGHBOURS, FAR, MOST_USUAL = 4, 4.0, 0.7
"""Readings on either side with which one is compared; largest distance in standard deviations; least share inside."""
NEGLIGIBLE = 1e-4  # weight relative to the largest one
LEAST_ERROR = 0.01  # decades, standard deviation that no reading beats


class Growth(NamedTuple):
    """Trend of one axis in the caller's unit of time; NaN where there are too few readings."""

    rate: Interval  # decades per unit of time
    ahead: Interval  # from the last time to the limit; 0: reached already, infinity: never
    not_before: float  # the same, which the limit is reached before with a probability of EARLIEST
    grows: float  # probability that it grows
    level: Interval  # size at the last time
    odd: bool  # whether the last size is far from the others and left out


UNKNOWN = Interval(np.nan, np.nan, np.nan)
NO_GROWTH = Growth(UNKNOWN, UNKNOWN, np.nan, np.nan, UNKNOWN, odd=False)


class _Mixture(NamedTuple):
    """K Student distributions of level and slope, one for each knee and kind of errors; times in spans of the readings.

    The level is log10 of the size now, the slope that per span.
    """

    mean: Floats  # (K, 2)
    spread: Floats  # (K, 2, 2)
    weight: Floats  # (K,), sum 1
    freedom: float

    def quantiles(self, column: int) -> Interval:
        """Of the level (0) or the slope (1)."""
        half = np.sqrt(self.spread[:, column, column])
        ends = self.mean[:, column] + np.outer([-12.0, 12.0], half)
        grid = np.linspace(ends.min(), ends.max(), 1001)
        below = student.cdf((grid[:, None] - self.mean[:, column]) / half, self.freedom) @ self.weight
        low, value, high = np.interp([0.5 - 0.5 * INSIDE, 0.5, 0.5 + 0.5 * INSIDE], below, grid)
        return Interval(float(value), float(low), float(high))

    def beyond(self, ahead: Floats, logarithm: float) -> Floats:
        """Probability that the trend is above a size at times from now on, (T,)."""
        row = ahead[:, None]
        middle = self.mean[:, 0] + row * self.mean[:, 1]
        variance = self.spread[:, 0, 0] + 2.0 * row * self.spread[:, 0, 1] + row**2 * self.spread[:, 1, 1]
        return np.asarray(student.cdf((middle - logarithm) / np.sqrt(variance), self.freedom) @ self.weight)

    def grows(self) -> float:
        """Probability that the slope is positive."""
        slopes = student.cdf(self.mean[:, 1] / np.sqrt(self.spread[:, 1, 1]), self.freedom)
        return float(slopes @ self.weight)


def growth(time: ArrayLike, size: ArrayLike, limit: float, deviation: ArrayLike, common: float = 0.0) -> Growth:
    """Growth of the leak of one axis.

    Args:
        time: (L,), rising, of the readings; the last one is "now", whether it has a size or not.
        size: (L,), the leak, also about zero; NaN: no reading.
        limit: of the size, in its unit.
        deviation: (L,), standard deviation of the size.
        common: standard deviation of an error that all readings share, decades.
    """
    when, what, sigma = (np.asarray(values, dtype=np.float64) for values in (time, size, deviation))
    root = np.hypot(what, 0.02 * limit)
    y, error = np.log10(0.5 * (what + root)), np.hypot(sigma / root / np.log(10.0), LEAST_ERROR)
    known = np.isfinite(what) & np.isfinite(when) & np.isfinite(sigma)
    usual = _usual(when[known], y[known], error[known])
    known[known] = usual
    if known.sum() < FEWEST or np.ptp(when[known]) <= 0.0:
        return NO_GROWTH
    x, y, error = _averaged(when[known], y[known], error[known])
    now, span = float(np.nanmax(when)), float(x[-1] - x[0])
    found = _mixture((x - now) / span, y, error)
    found.spread[:, 0, 0] += common**2
    ahead = np.concatenate([[0.0], np.geomspace(1e-4, FARTHEST, 700)])
    reached = np.maximum.accumulate(found.beyond(ahead, float(np.log10(limit))))

    def when_reached(probability: float) -> float:
        place = int(np.searchsorted(reached, probability))
        if place in (0, len(ahead)):
            return np.inf if place else 0.0
        return span * float(np.interp(probability, reached[place - 1 : place + 1], ahead[place - 1 : place + 1]))

    low, value, high = (when_reached(share) for share in (0.5 - 0.5 * INSIDE, 0.5, 0.5 + 0.5 * INSIDE))
    return Growth(
        rate=Interval(*(part / span for part in found.quantiles(1))),
        ahead=Interval(value, low, high),
        not_before=when_reached(EARLIEST),
        grows=found.grows(),
        level=Interval(*(float(10.0**part) for part in found.quantiles(0))),
        odd=not usual[-1],
    )


def _usual(x: Floats, y: Floats, error: Floats) -> NDArray[np.bool_]:
    """Readings that are not far from the line through their neighbours (Theil and Sen: medians of slope and level)."""
    count, reach = len(x), 2 * NEIGHBOURS
    if count <= reach:
        return np.ones(count, dtype=np.bool_)
    rest = np.empty(count)
    for k in range(count):
        first = min(max(k - NEIGHBOURS, 0), count - 1 - reach)
        near = np.delete(np.arange(first, first + reach + 1), k - first)
        one, two = np.triu_indices(reach, 1)
        step = x[near][two] - x[near][one]
        slopes = (y[near][two] - y[near][one])[step > 0.0] / step[step > 0.0]
        slope = float(np.median(slopes)) if len(slopes) else 0.0
        rest[k] = y[k] - np.median(y[near] - slope * (x[near] - x[k]))
    usual = 1.483 * float(np.median(np.abs(rest)))
    inside = np.abs(rest) <= FAR * np.fmax(usual, np.nan_to_num(error))
    return inside if inside.mean() >= MOST_USUAL else np.ones(count, dtype=np.bool_)


def _averaged(x: Floats, y: Floats, error: Floats) -> tuple[Floats, Floats, Floats]:
    """At most MOST readings, each the mean of neighbours."""
    if len(x) <= MOST:
        return x, y, error
    groups = np.array_split(np.arange(len(x)), MOST)
    means = [np.array([values[group].mean() for group in groups]) for values in (x, y, error)]
    return means[0], means[1], means[2]


def _mixture(x: Floats, y: Floats, error: Floats) -> _Mixture:
    """The trend over all knees and kinds of errors; ``x`` is in spans of the readings, 0 now."""
    scale = float(np.sqrt(np.mean(error**2)))
    own = np.diag((error / scale) ** 2)
    later = np.flatnonzero(np.arange(len(x)) <= len(x) - AFTER_KNEE - 1)[1:]
    places = x[np.unique(later[np.linspace(0, len(later) - 1, min(KNEES, len(later))).astype(np.int64)])]
    knees = [(x[0], STRAIGHT), *((place, (1.0 - STRAIGHT) / len(places)) for place in places)]
    kinds = [(0.0, 1.0, STRAIGHT)]
    kinds += [(share, length, (1.0 - STRAIGHT) / 9.0) for share in LASTING for length in LENGTHS]
    distance = np.abs(x[:, None] - x)
    means, spreads, logarithms = [], [], []
    freedom = len(x) - 2 + KNOWN_FREEDOM
    for share, length, kind in kinds:
        factor = cho_factor((1.0 - share) * own + share * np.exp(-distance / length), lower=True)
        for knee, first in knees:
            bent = np.maximum(x, knee)  # level before the knee; 0 now
            design = np.column_stack([np.ones(len(x)), bent])
            weighted = cho_solve(factor, design)
            information = design.T @ weighted
            mean = np.linalg.solve(information, weighted.T @ y)
            rest = y - design @ mean
            squares = float(rest @ cho_solve(factor, rest)) + KNOWN_FREEDOM * scale**2 + 1e-12
            likely = np.log(kind * first) - np.log(np.diag(factor[0])).sum()
            likely -= 0.5 * np.linalg.slogdet(information)[1]
            means.append(mean)
            spreads.append(squares / freedom * np.linalg.inv(information))
            logarithms.append(likely - 0.5 * freedom * np.log(squares))
    weight = np.exp(np.array(logarithms) - max(logarithms))
    kept = np.flatnonzero(weight > NEGLIGIBLE)
    weight = weight[kept] / weight[kept].sum()
    return _Mixture(np.array(means)[kept], np.array(spreads)[kept], weight, freedom)
