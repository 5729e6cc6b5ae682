"""What each of several recordings says by itself about the unknowns that a common fit has found."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hydro_env.types import Floats
from hydro_rig.identification.fit import COVERAGE, DETERMINED, Fit

BY_CHANCE = 0.05  # probability of a disagreement of sound recordings that counts
FARTHEST = 3.0  # standard deviations of the range; a single step of a linear model reaches no further


class Repeat(NamedTuple):
    """One unknown in R recordings, in its unit."""

    name: str
    recordings: NDArray[np.int64]  # (R,), their numbers
    values: Floats  # (R,), from each recording alone
    low: Floats  # (R,), ends of the 95 % intervals
    high: Floats  # (R,)
    determined: NDArray[np.bool_]  # (R,), whether the recording alone determines it
    inside: NDArray[np.bool_]  # (R,), whether the interval of the recording holds the value of the common fit

    @property
    def spread(self) -> float:
        """Standard deviation of the values of the recordings that determine it; NaN of fewer than two."""
        known = self.values[self.determined]
        return float(known.std(ddof=1)) if len(known) > 1 else np.nan


def _alone(fit: Fit, group: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
    """What each of R groups of windows says alone about p unknowns, scaled; ``group``: number of each used window.

    One Gauss–Newton step from the common values gives the values, (R, p), and their deviations without the disagreement
    of the groups, (R, p). The third result, (p,), is this disagreement: the standard deviation between the groups that
    their own uncertainty does not explain.
    """
    joint, numbers, own = fit.joint, np.unique(group), np.eye(len(fit.names))
    middle, deviation = np.empty((2, len(numbers), len(fit.names)))
    for row, number in enumerate(numbers):
        information = joint.information[group == number].sum(axis=0) + own
        # The common values are the optimum of all windows and the prior; this group alone keeps the whole prior.
        step = np.linalg.solve(information, joint.score[group == number].sum(axis=0) - joint.common)
        middle[row] = joint.common + np.clip(step, -FARTHEST, FARTHEST)
        deviation[row] = np.minimum(fit.widening * np.sqrt(np.diag(np.linalg.inv(information))), 1.0)
    disagreement = np.zeros(len(fit.names))
    for place in range(len(fit.names)):
        known = deviation[:, place] <= DETERMINED
        values, variances = middle[known, place], deviation[known, place] ** 2
        if len(values) < 2:
            continue
        mean = np.average(values, weights=1.0 / variances)
        if np.sum((values - mean) ** 2 / variances) > stats.chi2.isf(BY_CHANCE, len(values) - 1):
            disagreement[place] = np.sqrt(max(values.var(ddof=1) - variances.mean(), 0.0))
    return middle, deviation, disagreement


def widened(fit: Fit, recording: NDArray[np.int64]) -> Fit:
    """The fit with intervals at least as wide as the recordings disagree; a single recording is cut in two halves.

    Source: random effects, DerSimonian and Laird, *Controlled Clinical Trials* 7, 1986.

    Args:
        fit: the common fit of B windows.
        recording: number of the recording of each window, (B,).
    """
    group = recording[np.isfinite(fit.misfit)]
    if len(group) < 2:
        return fit
    if len(np.unique(group)) < 2:
        group = np.arange(len(group)) * 2 // len(group)
    unknowns = list(fit.unknowns)
    *_, between = _alone(fit, group)
    for place, one in enumerate(unknowns):
        if between[place] > 0.0 and not one.side:
            middle = fit.joint.common[place]
            reach = np.minimum(np.hypot(COVERAGE * one.remaining, COVERAGE * between[place]), COVERAGE)
            low, high = one.prior.value(np.array([middle - reach, middle + reach])).tolist()
            low, high = min(one.low, low), max(one.high, high)
            unknowns[place] = one._replace(low=low, high=high, remaining=float(reach / COVERAGE))
    return fit._replace(unknowns=tuple(unknowns))


def repeats_of(fit: Fit, recording: NDArray[np.int64]) -> list[Repeat]:
    """The values of each recording alone; empty with fewer than two recordings.

    Args:
        fit: the common fit of B windows.
        recording: number of the recording of each window, (B,).
    """
    used = recording[np.isfinite(fit.misfit)]
    numbers = np.unique(used)
    if len(numbers) < 2:
        return []
    middle, deviation, between = _alone(fit, used)
    reach = COVERAGE * np.minimum(np.hypot(deviation, between), 1.0)
    inside = np.abs(middle - fit.joint.common) <= reach
    repeats = []
    for place, one in enumerate(fit.unknowns):
        values, low, high = (one.prior.value(part[:, place]) for part in (middle, middle - reach, middle + reach))
        repeats.append(
            Repeat(one.name, numbers, values, low, high, deviation[:, place] <= DETERMINED, inside[:, place])
        )
    return repeats


def share_inside(repeats: list[Repeat]) -> float:
    """Share of the intervals of single recordings that hold the common value, where they determine it; NaN without."""
    inside = [hold for one in repeats for hold in one.inside[one.determined].tolist()]
    return float(np.mean(inside)) if inside else np.nan
