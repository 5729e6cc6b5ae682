"""Intervals of a common fit: how far the windows scatter, what a recording bounds on one side only, physical bounds.

**Scatter.** With a slightly wrong model the windows of a recording contradict each other by more than the noise
explains. The covariance is that of a sandwich whose clusters are the windows: A⁻¹ B A⁻¹ with the information A and the
outer products B of the windows' scores. Few windows estimate B badly. Each score is therefore corrected for the share
of the fit that its own window decides (Bell and McCaffrey, *Survey Methodology* 28, 2002), and the ratio of each
variance to that of the model is moderated by the ratio that the unknowns have in common (Smyth, *Statistical
Applications in Genetics and Molecular Biology* 3, 2004): a badly described direction widens its own unknowns, not all.

**One side.** A limit that the motion never reached, such as the slew limit of a valve, leaves the cost flat beyond the
found value. Steps to both sides of each value find such unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hydro_agents.estimation.model import Model
from hydro_agents.estimation.unknowns import EXTERNAL_LEAKAGE, LEAKAGE, PATHS, Prior
from hydro_agents.rigs.common_fit import Joint
from hydro_env import PlantParameters, TaskConfig
from hydro_env.task.randomisation import Distribution, own_value

Array = NDArray[np.float64]

TAIL = 0.025  # of the 95 % interval, to each side
MODERATION = 4.0  # degrees of freedom of the common ratio; seven windows, the usual number in 20 s, have six

LEAST_RATIO = 1.0  # a variance is never below this share of the model's
MOST_OWN = 0.95  # largest share of a direction that one window decides, in the correction of its score

STEP, LEAST_STEP = 2.0, 0.3  # standard deviations, of the steps to both sides
FLAT = 0.25  # of the expected rise of the cost; a smaller rise is flat
STEEP = 4.0  # times the expected rise; the slope at the found value does not show this side
MOST_WIDER = 2.0  # largest factor by which a small rise of the cost lengthens one side of an interval
PLACES = 10  # of the profile of the cost, on one side


class Spread(NamedTuple):
    """Uncertainty of the p common unknowns, scaled by their ranges."""

    deviation: Array  # (p,), standard deviations of the model: noise alone
    widening: Array  # (p,), factor on them, from the scatter of the windows
    reach: Array  # (p,), half of the 95 % interval


def spread_of(joint: Joint) -> Spread:
    """The moderated cluster-robust uncertainty of a common fit; the prior counts as known exactly."""
    covariance = np.linalg.inv(joint.precision)
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    shares, directions = np.linalg.eigh(root @ joint.information @ root)  # of each window, (B, p), (B, p, p)
    own = 1.0 / np.sqrt(1.0 - np.clip(shares, 0.0, MOST_OWN))
    turned = np.einsum("bij,bi->bj", directions, joint.score @ root)
    moves = np.einsum("bij,bj->bi", directions, own * turned) @ root  # (B, p), of the unknowns, by each window
    expected = np.einsum("ij,bjk,ki->bi", covariance, joint.information, covariance)
    total, variance = expected.sum(axis=0), np.diag(covariance)
    ratio = (moves**2).sum(axis=0) / np.maximum(total, 1e-300)
    freedom = total**2 / np.maximum((expected**2).sum(axis=0), 1e-300)  # Satterthwaite: the windows that count
    common = max(1.0, float(np.median(ratio)))
    ratio = np.maximum((MODERATION * common + freedom * ratio) / (MODERATION + freedom), LEAST_RATIO)
    informed = np.clip(total / variance, 0.0, 1.0)  # the rest is the prior's
    widening = np.sqrt(1.0 - informed + informed * ratio)
    deviation = np.sqrt(variance)
    quantile = stats.t.ppf(1.0 - TAIL, MODERATION + freedom)
    reach = np.minimum(quantile * widening * deviation, stats.norm.ppf(1.0 - TAIL))
    return Spread(deviation, widening, reach)


class Profile:
    """Rise of the cost when common unknowns move away from a common fit.

    Args:
        model: of the windows of the fit.
        measured: their readings over their noise, (B, channels, T); NaN is left out.
        joint: the fit.
    """

    def __init__(self, model: Model, measured: Array, joint: Joint) -> None:
        self.model, self.joint = model, joint
        self.known = np.isfinite(measured)
        self.measured = np.where(self.known, measured, 0.0)
        self.window = np.arange(model.count)
        residual = self._residual(joint.scaled, self.window)
        number = np.maximum(self.known.sum(axis=2), 1)
        self.weight = 1.0 / np.maximum((residual**2).sum(axis=2) / number, 1.0)  # as in the fit
        self.cost = self._cost(residual, self.window)

    def rises(self, offsets: Array, follow: bool) -> Array:
        """Rise of the cost of the readings, (K,), for K offsets (K, p) of the scaled common unknowns.

        Args:
            offsets: from the fit.
            follow: whether the start states of the windows follow as in the linear model; else they stay.
        """
        count, joint = len(offsets), self.joint
        rows = np.repeat(joint.scaled[None], count, axis=0)
        rows[:, :, joint.shared] += offsets[:, None]
        if follow:
            rows[:, :, joint.own] += np.einsum("bop,kp->kbo", joint.response, offsets)
        window = np.tile(self.window, count)
        residual = self._residual(rows.reshape(len(window), -1), window)
        costs = self._cost(residual, window).reshape(count, -1)
        return np.asarray(np.nan_to_num(costs - self.cost, nan=np.inf, posinf=np.inf).sum(axis=1))

    def _residual(self, scaled: Array, window: NDArray[np.int64]) -> Array:
        read, _ = self.model.readings(scaled, window)
        return np.where(self.known[window], self.measured[window] - read, 0.0)

    def _cost(self, residual: Array, window: NDArray[np.int64]) -> Array:
        return np.asarray((self.weight[window] * (residual**2).sum(axis=2)).sum(axis=1))


class Sides(NamedTuple):
    """What steps to both sides of the p common unknowns show."""

    wider: Array  # (p, 2), factor on the interval below and above the value, at least 1
    open: NDArray[np.int64]  # (p,), 1: only a lower end is known, −1: only an upper one, 0: both or none
    end: Array  # (p,), the known end of an open interval, scaled


def sides_of(profile: Profile, spread: Spread, ends: Array) -> Sides:
    """Compare steps of two standard deviations to both sides of each unknown with the rise that is expected.

    The rise along any path is at least that with all others fitted again. So a small rise along one path suffices:
    along the ridge of the linear model, or with all others at rest.

    Args:
        profile: of the fit.
        spread: of the fit.
        ends: of the ranges, (p, 2), scaled; infinite for unknowns that no limit describes.
    """
    joint = profile.joint
    count, middle = len(joint.shared), joint.scaled[0, joint.shared]
    covariance = np.linalg.inv(joint.precision)
    ridge = covariance / np.diag(covariance)  # row j: all unknowns, for a step of 1 of unknown j
    bounded = (ends[:, 0] < middle) & (middle < ends[:, 1]) & np.isfinite(ends).all(axis=1)
    room = np.where(bounded[:, None], np.abs(ends - middle[:, None]), np.inf)
    steps = np.minimum(STEP * spread.deviation[:, None], room) * np.array([-1.0, 1.0])  # (p, 2)
    offsets = (steps[:, :, None] * np.eye(count)[:, None]).reshape(-1, count)
    along = (steps[:, :, None] * ridge[:, None]).reshape(-1, count)
    prior = 2.0 * along @ middle + (along**2).sum(axis=1)
    alone = 2.0 * offsets @ middle + (offsets**2).sum(axis=1)
    rise = np.minimum(profile.rises(along, True) + prior, profile.rises(offsets, False) + alone).reshape(count, 2)
    expected = (steps / spread.deviation[:, None]) ** 2
    # A step that the end of the range makes short shows nothing.
    share = np.where(np.abs(steps) > LEAST_STEP * spread.deviation[:, None], rise / np.maximum(expected, 1e-12), 1.0)
    wider = np.clip(1.0 / np.sqrt(np.maximum(share, 1e-3)), 1.0, MOST_WIDER)
    found, end = np.zeros(count, np.int64), np.full(count, np.nan)
    for place in np.flatnonzero(bounded & ((share < FLAT) | (share > STEEP)).any(axis=1)).tolist():
        threshold = (STEP * spread.widening[place]) ** 2
        grids = [middle[place] + np.linspace(0.0, 1.0, PLACES + 1)[1:] * (end_ - middle[place]) for end_ in ends[place]]
        free = []
        for grid in grids:
            moved = (grid - middle[place])[:, None] * np.eye(count)[place]
            above = profile.rises(moved, False) > threshold
            free.append(grid[int(above.argmax())] if above.any() else math.nan)
        if math.isnan(free[0]) == math.isnan(free[1]):  # both sides end within the range, or none does
            for side in np.flatnonzero((share[place] < FLAT) & ~np.isnan(free)).tolist():
                plateau = abs(free[side] - middle[place]) / spread.reach[place]
                wider[place, side] = max(wider[place, side], plateau)
            continue
        side = 0 if math.isnan(free[1]) else 1  # the side with an end
        reach = spread.reach[place] * wider[place, side]
        sure = middle[place] + (reach if side else -reach)
        found[place] = -1 if side else 1
        # The nearer end: the slope at the value, or the profile where the slope is that of the flat side.
        end[place] = min(sure, free[side]) if side else max(sure, free[side])
    return Sides(wider, found, end)


def range_ends(
    config: TaskConfig, ranges: Mapping[str, Distribution], priors: Mapping[str, Prior], names: tuple[str, ...]
) -> Array:
    """Ends of the ranges of some unknowns, (p, 2), scaled by their priors; infinite without a range of its own."""
    ends = np.tile([-np.inf, np.inf], (len(names), 1))
    for place, name in enumerate(names):
        if name in ranges and ranges[name].otherwise is None:
            given = ranges[name]
            factor = 1.0 if given.times is None else own_value(config.plant, given.times)
            low, high = (factor * end for end in given.bounds(own_value(config.plant, name)))
            if low > 0.0 or not priors[name].logarithmic:
                ends[place] = priors[name].scaled(low), priors[name].scaled(high)
    return ends


def beside_the_edge(name: str, prior: Prior, plant: PlantParameters, limit: float, end: float) -> float:
    """Value, scaled, of an unknown of which only one end is known: that of the rig file if it is possible.

    Else it is the middle between the known end and the end of the range. The known end itself would be a claim: that
    the limit begins where the motion ended.

    Args:
        name: of the unknown.
        prior: of the unknown.
        plant: the rig of the file.
        limit: the known end of the interval, scaled.
        end: of the range on the open side, scaled.
    """
    own = own_value(plant, name)
    nominal = prior.scaled(own) if own > 0.0 or not prior.logarithmic else math.nan
    if min(limit, end) <= nominal <= max(limit, end):
        return nominal
    return 0.5 * (limit + end)


def within_bounds(plant: PlantParameters, name: str, value: float) -> float:
    """A value within the physical bounds of an unknown: no leak is negative, no area 0."""
    if name in (LEAKAGE, EXTERNAL_LEAKAGE):
        return max(value, 0.0)
    if name not in PATHS:
        return value
    group, field = name.split(".")
    for bound in type(getattr(plant, group)).model_fields[field].metadata:
        low, above, high = (getattr(bound, kind, None) for kind in ("ge", "gt", "le"))
        if low is not None:
            value = max(value, low)
        if above is not None and value <= above:
            value = above + 1e-6
        if high is not None:
            value = min(value, high)
    return value


def truncated_end(value: float, low: float, high: float) -> float:
    """Upper end of the 95 % interval of a size that cannot be negative, from its normal distribution's interval."""
    deviation = (high - low) / (2.0 * float(stats.norm.ppf(1.0 - TAIL)))
    if low >= 0.0 or deviation <= 0.0:
        return high
    positive = float(stats.norm.sf(-value / deviation))
    return max(high, value + deviation * float(stats.norm.isf(TAIL * positive)))
