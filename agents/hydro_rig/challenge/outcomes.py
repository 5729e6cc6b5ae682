"""What a detector made of each recording, and the figures that follow from it for any threshold.

A recording gives at most one false alarm: at any look before the seal leaks, or at any look of an axis whose seal never
leaks. A leak is found if the first alarm comes after its onset. The ranked figure is that of the free-response ROC
(Bunch et al. 1978): the mean share of leaks found at the false-alarm rates :data:`BUDGETS`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import threshold_at_false_alarm_rate
from hydro_agents.running.statistics import Interval, interval, plant_weights
from hydro_env.types import Floats

BUDGETS = (1.0, 2.0, 5.0, 10.0, 20.0)
"""False alarms per hour of the ranked figure."""

RESAMPLES = 200
HOURS_PER_YEAR, MONTHS_PER_YEAR = 8760.0, 12.0
LEAKS_PER_YEAR = 1.0  # of an axis, where a figure speaks of a plant
COST_RATIOS = (1e1, 1e2, 1e3, 1e4, 1e5, 1e6)
"""Cost of a leak that is missed over that of a false call-out."""


@dataclass(frozen=True)
class Outcomes:
    """What a detector made of N recordings; each field (N,)."""

    tier: NDArray[np.int64]
    leak: NDArray[np.bool_]
    free: Floats  # h, without a leak
    before: Floats  # highest score without a leak; −inf: no look
    after: Floats  # highest score from the onset on; −inf: no look or no leak
    onset: Floats  # s
    alarm: Floats  # s, the detector's own first alarm; NaN: none, or it gives none

    def part(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Outcomes:
        """Those of some recordings."""
        return Outcomes(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    @property
    def hours(self) -> float:
        """Time without a leak."""
        return float(self.free.sum())

    def threshold(self, per_hour: float) -> float:
        """Lowest score that gives at most this many false alarms per hour."""
        looked = self.before[np.isfinite(self.before)]
        if not len(looked):
            return -np.inf
        return threshold_at_false_alarm_rate(looked, min(per_hour * self.hours / len(looked), 1.0))

    def found(self, threshold: float) -> NDArray[np.bool_]:
        """Leaks whose first alarm comes after the onset, (N,)."""
        return self.leak & np.isfinite(self.after) & (self.after >= threshold) & ~(self.before >= threshold)

    def found_at(self, per_hour: float) -> float:
        """Share of the leaks found at a rate of false alarms."""
        return float(self.found(self.threshold(per_hour))[self.leak].mean()) if self.leak.any() else float("nan")

    @property
    def found_share(self) -> float:
        """Mean share of leaks found at the false-alarm rates BUDGETS."""
        return float(np.mean([self.found_at(rate) for rate in BUDGETS]))

    def _resampled(self) -> list[NDArray[np.int64]]:
        """Recordings that are drawn with replacement, stratified by tier; the first draw is all of them."""
        weights = plant_weights(self.tier, RESAMPLES)
        return [np.repeat(np.arange(len(row)), row.astype(int)) for row in weights]

    def with_interval(self) -> Interval:
        """:attr:`found_share` with its 95 % bootstrap interval over recordings."""
        return interval(np.array([self.part(drawn).found_share for drawn in self._resampled()]), len(self.tier))

    def ahead_of(self, other: Outcomes) -> Interval:
        """By how much more it finds than another detector on the same recordings, with the paired 95 % interval."""
        drawn = [self.part(one).found_share - other.part(one).found_share for one in self._resampled()]
        return interval(np.array(drawn), len(self.tier))

    def curve(self) -> tuple[Floats, Floats]:
        """False alarms per hour, and the share of leaks found, for each threshold; both rise."""
        scores = np.unique(self.before[np.isfinite(self.before)])[::-1]
        none = np.nextafter(scores[0], np.inf) if len(scores) else np.inf  # the lowest threshold without an alarm
        found = np.array([self.found(threshold).sum() for threshold in (none, *scores)])
        rate = np.array([0, *((self.before >= score).sum() for score in scores)])
        return rate / max(self.hours, 1e-9), np.maximum.accumulate(found / max(int(self.leak.sum()), 1))

    def costs(self) -> Floats:
        """Lowest cost of an axis and year over that without a detector, for each of :data:`COST_RATIOS`, at most 1.

        An axis leaks :data:`LEAKS_PER_YEAR` times. The threshold is the best for the ratio, on these recordings.
        """
        rate, share = self.curve()
        ratios = np.array(COST_RATIOS)[:, None]
        cost = HOURS_PER_YEAR * rate / (LEAKS_PER_YEAR * ratios) + 1.0 - share
        return np.asarray(np.minimum(cost.min(axis=1), 1.0))


def true_alarms(found: float, per_hour: float) -> float:
    """Share of the alarms that are leaks, where an axis leaks :data:`LEAKS_PER_YEAR` times."""
    right, wrong = LEAKS_PER_YEAR * found, HOURS_PER_YEAR * per_hour
    return right / (right + wrong) if right + wrong > 0.0 else float("nan")
