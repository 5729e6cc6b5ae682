"""The trend of a growing leak, and the time until its size reaches a limit.

The model: log10 of the size is level, then from a knee on rises in a straight line. The errors of the readings have two
parts, one that is independent from reading to reading, and one that lasts (an exponential correlation): readings in one
manner of operation err alike. Knee, share and length of the lasting part are averaged over, each weighted by how well
it explains the readings (Bayes, with flat priors of level and slope); level and slope are then Student's t. A straight
line with independent errors, without this average, gives intervals that are too narrow. An error that all readings
share, as of a thermometer, moves the level, and widens what is said about it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from hydro_agents.running.statistics import Interval
from hydro_env.types import Floats

QUANTILES = (0.5, 0.05, 0.95)  # of the intervals
EARLIEST = 0.01  # probability that the limit is reached before "not before"
FEWEST, MOST = 5, 150  # readings for a trend; older ones are left out
LASTING = (0.3, 0.6, 0.9)  # shares of the lasting errors in the variance, beside none
LENGTHS = (0.03, 0.1, 0.3)  # of the lasting errors, as a share of the time between the first and the last reading
KNEES = 10  # places of the knee, beside the first reading
STRAIGHT = 0.5  # probability beforehand of no knee, and of no lasting errors
AFTER_KNEE = 3  # fewest readings after the knee
KNOWN_FREEDOM = 4.0  # degrees of freedom that standard deviations of the readings are worth
FARTHEST = 100.0  # time to the limit that counts as never, as a multiple of the time of the readings
NEIGHBOURS, FAR, MOST_USUAL = 8, 4.0, 0.7
"""Readings with whose line one is compared; largest distance in standard deviations; least share inside."""
LEAST_ERROR = 0.01  # decades, standard deviation that no reading beats
DRAWS = 20_000  # of level and slope


class Growth(NamedTuple):
    """Trend of one axis in the caller's unit of time; NaN where there are too few readings."""

    rate: Interval  # decades per unit of time
    ahead: Interval  # from now to the limit; 0: reached already, infinity: never
    not_before: float  # the same, which the limit is reached before with a probability of EARLIEST
    grows: float  # probability that it grows
    level: Interval  # size now


UNKNOWN = Interval(np.nan, np.nan, np.nan)
NO_GROWTH = Growth(UNKNOWN, UNKNOWN, np.nan, np.nan, UNKNOWN)


def growth(
    time: ArrayLike,
    size: ArrayLike,
    limit: float,
    deviation: ArrayLike,
    common: float = 0.0,
    now: float | None = None,
) -> Growth:
    """Growth of the leak of one axis.

    Args:
        time: (L,), rising, of the readings.
        size: (L,), the leak, also about zero; NaN: no reading.
        limit: of the size, in its unit.
        deviation: (L,), standard deviation of the size.
        common: standard deviation of an error that all readings share, decades.
        now: from which on the trend looks ahead; default: the last time.
    """
    when, what, sigma = (np.asarray(values, dtype=np.float64) for values in (time, size, deviation))
    root = np.hypot(what, 0.02 * limit)
    y, error = np.log10(0.5 * (what + root)), np.hypot(sigma / root / np.log(10.0), LEAST_ERROR)
    kept = np.flatnonzero(np.isfinite(what) & np.isfinite(sigma))[-MOST:]
    kept = kept[_usual(when[kept], y[kept], error[kept])]
    if len(kept) < FEWEST or np.ptp(when[kept]) <= 0.0:
        return NO_GROWTH
    now = float(when[-1]) if now is None else now
    span = float(when[kept[-1]] - when[kept[0]])
    level, slope = _drawn((when[kept] - now) / span, y[kept], error[kept], common)
    left = np.log10(limit) - level
    ahead = np.full(DRAWS, np.inf)
    rises = (slope > 0.0) & (left < FARTHEST * slope)
    ahead[rises] = span * left[rises] / slope[rises]
    ahead[left <= 0.0] = 0.0
    return Growth(
        rate=Interval(*np.quantile(slope / span, QUANTILES)),
        ahead=Interval(*np.quantile(ahead, QUANTILES, method="nearest")),
        not_before=float(np.quantile(ahead, EARLIEST, method="nearest")),
        grows=float((slope > 0.0).mean()),
        level=Interval(*np.quantile(10.0**level, QUANTILES)),
    )


def _usual(x: Floats, y: Floats, error: Floats) -> NDArray[np.bool_]:
    """Readings that are not far from the line through their neighbours (Theil and Sen: medians of slope and level)."""
    everyone = np.ones(len(x), dtype=np.bool_)
    if len(x) <= NEIGHBOURS:
        return everyone
    rest, (one, two) = np.empty(len(x)), np.triu_indices(NEIGHBOURS, 1)
    for k in range(len(x)):
        first = min(max(k - NEIGHBOURS // 2, 0), len(x) - 1 - NEIGHBOURS)
        near = np.delete(np.arange(first, first + NEIGHBOURS + 1), k - first)
        step, rise = x[near][two] - x[near][one], y[near][two] - y[near][one]
        slope = float(np.median(rise[step > 0.0] / step[step > 0.0])) if (step > 0.0).any() else 0.0
        rest[k] = abs(y[k] - np.median(y[near] - slope * (x[near] - x[k])))
    inside = rest <= FAR * np.maximum(1.483 * np.median(rest), error)
    return inside if inside.mean() >= MOST_USUAL else everyone


def _drawn(x: Floats, y: Floats, error: Floats, common: float) -> tuple[Floats, Floats]:
    """Level now (log10) and slope per span, (DRAWS,) each; ``x`` is in spans of the readings, 0 now."""
    scale = float(np.sqrt(np.mean(error**2)))
    later = np.arange(1, len(x) - AFTER_KNEE)
    places = np.unique(later[np.linspace(0, len(later) - 1, KNEES).astype(np.int64)])
    knees = [(x[0], STRAIGHT)]
    knees += [(place, (1.0 - STRAIGHT) / len(places)) for place in x[places]]
    kinds = [(0.0, 1.0, STRAIGHT)]
    kinds += [(share, length, (1.0 - STRAIGHT) / 9.0) for share in LASTING for length in LENGTHS]
    distance = np.abs(x[:, None] - x)
    freedom = len(x) - 2 + KNOWN_FREEDOM
    means, spreads, logarithms = [], [], []
    for share, length, kind in kinds:
        own = (1.0 - share) * np.diag((error / scale) ** 2)
        factor = cho_factor(own + share * np.exp(-distance / length), lower=True)
        for knee, first in knees:
            design = np.column_stack([np.ones(len(x)), np.maximum(x, knee)])  # level before the knee; 0 now
            weighted = cho_solve(factor, design)
            information = design.T @ weighted
            mean = np.linalg.solve(information, weighted.T @ y)
            rest = y - design @ mean
            squares = float(rest @ cho_solve(factor, rest)) + KNOWN_FREEDOM * scale**2 + 1e-12
            likely = np.log(kind * first) - np.log(np.diag(factor[0])).sum()
            likely -= 0.5 * np.linalg.slogdet(information)[1] + 0.5 * freedom * np.log(squares)
            means.append(mean)
            spreads.append(squares / freedom * np.linalg.inv(information))
            logarithms.append(likely)
    generator = np.random.default_rng(0)
    weight = np.exp(np.array(logarithms) - max(logarithms))
    which = generator.choice(len(weight), DRAWS, p=weight / weight.sum())
    spread = np.linalg.cholesky(np.array(spreads))[which]
    normal = (spread @ generator.standard_normal((DRAWS, 2, 1)))[:, :, 0]
    student = normal * np.sqrt(freedom / generator.chisquare(freedom, (DRAWS, 1)))
    level, slope = (np.array(means)[which] + student).T
    return level + common * generator.standard_normal(DRAWS), slope
