"""What each of several recordings says by itself about the unknowns that a common fit has found."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.types import Floats
from hydro_rig.identification.fit import COVERAGE, DETERMINED, Fit

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
        return float(known.std(ddof=1)) if len(known) > 1 else float("nan")


def repeats_of(fit: Fit, recording: NDArray[np.int64]) -> list[Repeat]:
    """The values of each recording alone: one Gauss–Newton step from the common values with its own windows.

    Args:
        fit: the common fit of B windows.
        recording: number of the recording of each window, (B,).

    Returns:
        One per unknown; empty with fewer than two recordings.
    """
    used = recording[np.isfinite(fit.misfit)]
    numbers = np.unique(used)
    if len(numbers) < 2 or fit.joint is None:
        return []
    joint, own = fit.joint, np.eye(len(fit.names))
    common = joint.scaled[0, joint.shared]
    middle, deviation = np.empty((2, len(numbers), len(common)))
    for row, number in enumerate(numbers):
        information = joint.information[used == number].sum(axis=0) + own
        # The common values are the optimum of all windows and the prior; this recording alone keeps the whole prior.
        step = np.linalg.solve(information, joint.score[used == number].sum(axis=0) - common)
        middle[row] = common + np.clip(step, -FARTHEST, FARTHEST)
        deviation[row] = np.minimum(fit.widening * np.sqrt(np.diag(np.linalg.inv(information))), 1.0)
    reach = COVERAGE * deviation
    repeats = []
    for place, name in enumerate(fit.names):
        values, low, high = (
            fit.priors[name].value(part[:, place]) for part in (middle, middle - reach, middle + reach)
        )
        inside = np.abs(middle[:, place] - common[place]) <= reach[:, place]
        repeats.append(Repeat(name, numbers, values, low, high, deviation[:, place] <= DETERMINED, inside))
    return repeats


def share_inside(repeats: list[Repeat]) -> float:
    """Share of the intervals of single recordings that hold the common value, where they determine it; NaN without."""
    inside = [hold for one in repeats for hold, known in zip(one.inside, one.determined, strict=True) if known]
    return float(np.mean(inside)) if inside else float("nan")
