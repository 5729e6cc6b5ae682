"""The trend of a growing leak, and the time until its size reaches a limit.

The model: log10 of the size is level, then from a knee on rises in a straight line. The errors of the readings have two
parts, one that is independent from reading to reading, and one that lasts (an exponential correlation): readings in one
manner of operation err alike. Knee, share and length of the lasting part are averaged over, each weighted by how well
it explains the readings (Bayes, with flat priors of level and slope); level and slope are then Student's t. A straight
line with independent errors, without this average, gives intervals that are too narrow. An error that all readings
share, as of a thermometer, moves the level, and widens what is said about it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hydro_agents.running.statistics import UNKNOWN, Interval
from hydro_env.types import Floats, Mask

QUANTILES = (0.5, 0.05, 0.95)  # of the intervals
EARLIEST = 0.01  # probability that the limit is reached before "not before"
FEWEST, MOST = 5, 150  # readings for a trend; older ones are left out
LASTING = (0.3, 0.6, 0.9)  # shares of the lasting errors in the variance, beside none
LENGTHS = (0.03, 0.1, 0.3)  # of the lasting errors, as a share of the time between the first and the last reading
KNEES = 10  # places of the knee, beside the first reading
AFTER_KNEE = 3  # fewest readings after the knee
KNOWN_FREEDOM = 4.0  # degrees of freedom that standard deviations of the readings are worth
FARTHEST = 100.0  # time to the limit that counts as never, as a multiple of the time of the readings
NEIGHBOURS, FAR, MOST_USUAL = 8, 4.0, 0.7  # of a line beside a reading; standard deviations; least share inside
LEAST_ERROR = 0.01  # decades, standard deviation that no reading beats
DRAWS = 20_000  # of level and slope


class Growth(NamedTuple):
    """Trend of one axis in the caller's unit of time; NaN where there are too few readings."""

    rate: Interval  # decades per unit of time
    ahead: Interval  # from now to the limit; 0: reached already, infinity: never
    not_before: float  # the same, which the limit is reached before with a probability of EARLIEST
    grows: float  # probability that it grows
    level: Interval  # size now


NO_GROWTH = Growth(UNKNOWN, UNKNOWN, np.nan, np.nan, UNKNOWN)


def growth(
    time: ArrayLike, size: ArrayLike, limit: float, deviation: ArrayLike, common: float = 0.0, now: float | None = None
) -> Growth:
    """Growth of the leak of one axis.

    ``time``, rising, ``size``, also about zero, and its standard ``deviation`` are (L,); NaN: no reading. ``common``:
    standard deviation of an error that all readings share, decades; ``now``: from which on the trend looks ahead;
    default: the last time.
    """
    when, what, sigma = (np.asarray(values, float) for values in (time, size, deviation))
    root = np.hypot(what, 0.02 * limit)
    y, error = np.log10(0.5 * (what + root)), np.hypot(sigma / root / np.log(10.0), LEAST_ERROR)
    kept = np.flatnonzero(np.isfinite(what) & np.isfinite(sigma))[-MOST:]
    kept = kept[_usual(when[kept], y[kept], error[kept])]
    if len(kept) < FEWEST or np.ptp(when[kept]) <= 0.0:
        return NO_GROWTH
    now = when[-1] if now is None else now
    span = np.ptp(when[kept])
    level, slope = _drawn((when[kept] - now) / span, y[kept], error[kept], common)
    left = np.log10(limit) - level
    ahead = np.full(DRAWS, np.inf)
    rises = (slope > 0.0) & (left < FARTHEST * slope)
    ahead[rises] = span * left[rises] / slope[rises]
    ahead[left <= 0.0] = 0.0
    return Growth(
        rate=Interval(*np.quantile(slope / span, QUANTILES)),
        ahead=Interval(*np.quantile(ahead, QUANTILES, method="nearest")),
        not_before=np.quantile(ahead, EARLIEST, method="nearest"),
        grows=(slope > 0.0).mean(),
        level=Interval(*np.quantile(10.0**level, QUANTILES)),
    )


def _usual(x: Floats, y: Floats, error: Floats) -> Mask:
    """Readings that are not far from the line through their neighbours (Theil and Sen: medians of slope and level)."""
    everyone = np.ones(len(x), bool)
    if len(x) <= NEIGHBOURS:
        return everyone
    own, (one, two) = np.arange(len(x))[:, None], np.triu_indices(NEIGHBOURS, 1)
    near = np.clip(own - NEIGHBOURS // 2, 0, len(x) - 1 - NEIGHBOURS) + np.arange(NEIGHBOURS)
    near += near >= own  # without the reading itself
    distance, height = x[near] - x[own], y[near]
    step, rise = distance[:, two] - distance[:, one], height[:, two] - height[:, one]
    slope = np.median(rise / np.where(step > 0.0, step, np.inf), axis=1, keepdims=True)
    rest = np.abs(y - np.median(height - slope * distance, axis=1))
    inside = rest <= FAR * np.maximum(1.483 * np.median(rest), error)
    return inside if inside.mean() >= MOST_USUAL else everyone


def _drawn(x: Floats, y: Floats, error: Floats, common: float) -> tuple[Floats, Floats]:
    """Level now (log10) and slope per span, (DRAWS,) each; ``x`` is in spans of the readings, 0 now."""
    scale = np.sqrt(np.mean(error**2))
    share = np.array([0.0, *np.repeat(LASTING, len(LENGTHS))])[:, None, None]
    length = np.array([1.0, *np.tile(LENGTHS, len(LASTING))])[:, None, None]
    lasting = np.exp(-np.abs(x[:, None] - x) / length)
    covariance = (1.0 - share) * np.diag((error / scale) ** 2) + share * lasting  # (kinds of errors, L, L)
    inverse = np.linalg.inv(covariance)[:, None]
    later = np.arange(1, len(x) - AFTER_KNEE)
    places = np.unique(later[np.linspace(0, len(later) - 1, KNEES).astype(np.int64)])
    after = np.maximum(x, x[[0, *places]][:, None])  # level before the knee; 0 now
    design = np.stack([np.ones_like(after), after], axis=-1)  # (knees, L, 2)
    weighted = inverse @ design
    information = design.mT @ weighted
    mean = np.linalg.solve(information, weighted.mT @ y[:, None])  # (kinds, knees, 2, 1)
    rest = y[:, None] - design @ mean
    freedom = len(x) - 2 + KNOWN_FREEDOM
    squares = (rest.mT @ inverse @ rest)[..., 0, 0] + KNOWN_FREEDOM * scale**2 + 1e-12
    spread = squares[..., None, None] / freedom * np.linalg.inv(information)

    determinants = np.linalg.slogdet(covariance)[1][:, None] + np.linalg.slogdet(information)[1]
    likely = -0.5 * (determinants + freedom * np.log(squares))
    weight = np.exp(likely - likely.max())
    weight[1:] /= len(share) - 1  # beforehand, lasting errors are as probable as none, and a knee as none
    weight[:, 1:] /= len(places)
    generator = np.random.default_rng(0)
    which = generator.choice(weight.size, DRAWS, p=weight.ravel() / weight.sum())
    root = np.linalg.cholesky(spread).reshape(-1, 2, 2)[which]
    normal = (root @ generator.standard_normal((DRAWS, 2, 1)))[:, :, 0]
    student = normal * np.sqrt(freedom / generator.chisquare(freedom, (DRAWS, 1)))
    level, slope = (mean.reshape(-1, 2)[which] + student).T
    return level + common * generator.standard_normal(DRAWS), slope
