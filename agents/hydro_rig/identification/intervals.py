"""Intervals of a common fit: how far the windows scatter, what a recording bounds on one side only, physical bounds.

**Scatter.** With a slightly wrong model the windows of a recording contradict each other by more than the noise
explains. The covariance is that of a sandwich whose clusters are the windows: A⁻¹ B A⁻¹ with the information A and the
outer products B of the windows' scores. Few windows estimate B badly. Each score is therefore corrected for the share
of the fit that its own window decides (Bell and McCaffrey, *Survey Methodology* 28, 2002), and the ratio of each
variance to that of the model is moderated by the ratio that the unknowns have in common (Smyth, *Statistical
Applications in Genetics and Molecular Biology* 3, 2004): a badly described direction widens its own unknowns, not all.

**Curves and one side.** Unknowns that compensate each other along a curve leave the linear model soon; a limit that the
motion never reached, such as the slew limit of a valve, leaves the cost flat beyond the found value. Steps to both
sides of each value, along the ridge of the linear model, find such unknowns; their intervals come from a profile
(:mod:`hydro_rig.identification.profiles`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from hydro_env import PlantParameters, TaskConfig
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.types import Floats, Indices
from hydro_rig.estimation.solver import Problem
from hydro_rig.estimation.unknowns import EXTERNAL_LEAKAGE, LEAKAGE, PATHS, Prior
from hydro_rig.identification.common_fit import Joint
from hydro_rig.identification.profiles import ALIKE, LONGEST_PROFILE, MOST_PROFILES, follow

TAIL = 0.025  # of the 95 % interval, to each side
MODERATION = 4.0  # degrees of freedom of the common ratio; seven windows, the usual number in 20 s, have six

LEAST_RATIO = 1.0  # a variance is never below this share of the model's
MOST_OWN = 0.95  # largest share of a direction that one window decides, in the correction of its score

STEP, FAR_STEP, LEAST_STEP = 2.0, 6.0, 0.3  # standard deviations, of the steps to both sides
FLAT = 0.25  # of the expected rise of the cost; a smaller rise is flat
STEEP = 4.0  # times the expected rise; the linear model does not describe this side
LIMITS = ("valve.slew_limit", "supply.pump_flow")  # act only where the motion reaches them; always profiled
SURE_RISE = 3.0
"""Rise of the cost, in standard deviations, that ends the interval of a value with a flat side: the few readings that
reached a limit may favour it by chance, and then all larger values are as likely."""

MOST_WIDER = 2.0  # largest factor by which a small rise of the cost lengthens one side of an interval


class Spread(NamedTuple):
    """Uncertainty of the p common unknowns, scaled by their ranges."""

    deviation: Floats  # (p,), standard deviations of the model: noise alone
    widening: Floats  # (p,), factor on them, from the scatter of the windows
    reach: Floats  # (p,), half of the 95 % interval


def spread_of(joint: Joint) -> Spread:
    """The moderated cluster-robust uncertainty of a common fit; the prior counts as known exactly."""
    covariance = joint.covariance
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


class Sides(NamedTuple):
    """What lies to both sides of the p common unknowns."""

    reach: Floats  # (p, 2), length of the interval below and above the value, scaled
    open: Indices  # (p,), 1: only a lower end is known, −1: only an upper one, 0: both or none


def sides_of(problem: Problem, joint: Joint, spread: Spread, ends: Floats, follows: bool) -> Sides:
    """Intervals below and above each value; where the cost rises otherwise than expected, from a profile.

    Args:
        problem: of the windows of the fit.
        joint: the fit.
        spread: of the fit.
        ends: of the ranges, (p, 2), scaled; infinite for unknowns that no limit describes.
        follows: whether to profile. If the model explains no window, the scatter decides the intervals, and profiles
            that reach as far would take minutes.
    """
    middle, count = joint.common, len(joint.shared)
    bounded = (ends[:, 0] < middle) & (middle < ends[:, 1]) & np.isfinite(ends).all(axis=1)
    room = np.where(bounded[:, None], np.abs(ends - middle[:, None]), np.inf)
    near = _rises(problem, joint, np.minimum(STEP * spread.deviation[:, None], room))
    far = _rises(problem, joint, np.minimum(FAR_STEP * spread.deviation[:, None], np.minimum(room, LONGEST_PROFILE)))
    reach = spread.reach[:, None] * np.clip(1.0 / np.sqrt(np.maximum(near, 1e-3)), 1.0, MOST_WIDER)
    covariance = joint.covariance
    alike = np.abs(covariance) / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    limited = np.array([problem.model.names[place] in LIMITS for place in joint.shared])
    flat = bounded & (limited | (np.minimum(near, far) < FLAT).any(axis=1))
    odd = flat | (near > STEEP).any(axis=1) | (near < FLAT).any(axis=1)
    found, done = np.zeros(count, np.int64), np.zeros(count, np.bool_)
    for place in sorted(np.flatnonzero(odd & follows).tolist(), key=lambda place: -spread.deviation[place]):
        if not flat[place] and (done.sum() >= MOST_PROFILES or (alike[place, done] > ALIKE).any()):
            continue
        done[place] = True
        target = (spread.reach[place] / spread.deviation[place]) ** 2
        if flat[place]:
            target = max(target, (SURE_RISE * spread.widening[place]) ** 2)
        lengths = (-spread.reach[place], spread.reach[place])
        limits = ends[place] if bounded[place] else (-np.inf, np.inf)
        paths = [follow(problem, joint, place, lengths[side], target, float(limits[side])) for side in (0, 1)]
        for path in paths:
            rest = np.sqrt(np.maximum(1.0 - path.rise / target, 0.0))  # that the other unknowns may use up
            beside = rest[:, None] * spread.reach * np.sqrt(1.0 - np.minimum(alike[place], 1.0) ** 2)
            away = path.scaled - middle
            reach[:, 0] = np.maximum(reach[:, 0], (beside - away).max(axis=0))
            reach[:, 1] = np.maximum(reach[:, 1], (beside + away).max(axis=0))
        if bounded[place] and paths[0].endless != paths[1].endless:
            found[place] = 1 if paths[1].endless else -1
    return Sides(reach, found)


def _rises(problem: Problem, joint: Joint, lengths: Floats) -> Floats:
    """Rise of the cost over that of the linear model after steps of these lengths below and above each value, (p, 2).

    The steps lead along the ridge of the linear model; one that the end of a range makes short shows nothing: 1.
    """
    count, middle = len(joint.shared), joint.common
    covariance = joint.covariance
    ridge = covariance / np.diag(covariance)[:, None]  # row j: all unknowns, for a step of 1 of unknown j
    steps = lengths * np.array([-1.0, 1.0])
    offsets = (steps[:, :, None] * ridge[:, None]).reshape(-1, count)  # (2p, p)
    rows = np.repeat(joint.scaled[:, None], len(offsets) + 1, axis=1)
    rows[:, 1:, joint.shared] += offsets
    rows[:, 1:, joint.own] += np.einsum("bop,kp->bko", joint.response, offsets)
    known = np.isfinite(problem.measured)
    square = np.ascontiguousarray((problem.residual(rows) ** 2).sum(axis=3).swapaxes(0, 1))  # (2p + 1, B, channels)
    weight = 1.0 / np.maximum(square[0] / np.maximum(known.sum(axis=2), 1), 1.0)  # as in the fit
    cost = np.nan_to_num((weight * square).sum(axis=(1, 2)), nan=np.inf, posinf=np.inf)
    rise = cost[1:] - cost[0] + 2.0 * offsets @ middle + (offsets**2).sum(axis=1)
    deviation = np.sqrt(np.diag(covariance))[:, None]
    expected = (lengths / deviation) ** 2
    return np.where(lengths > LEAST_STEP * deviation, rise.reshape(count, 2) / np.maximum(expected, 1e-12), 1.0)


def hull(plant: PlantParameters, found: PlantParameters, path: str, given: Distribution) -> tuple[float, float]:
    """Lowest and highest value that a range allows, SI, including the value without the range.

    Factors multiply the value of the given rig ``plant``; the rig that was ``found`` gives the value of a parameter
    that multiplies the range (``times``).
    """
    factor = 1.0 if given.times is None else own_value(found, given.times)
    ends = [factor * end for end in given.bounds(own_value(plant, path))]
    if given.otherwise is not None:
        ends.append(given.otherwise)
    return min(ends), max(ends)


def range_ends(config: TaskConfig, ranges: Mapping[str, Distribution], priors: Mapping[str, Prior]) -> Floats:
    """Ends of the ranges of some unknowns, (p, 2), scaled by their priors; infinite without a range of its own."""
    ends = np.tile([-np.inf, np.inf], (len(priors), 1))
    for place, (name, prior) in enumerate(priors.items()):
        if name in ranges and ranges[name].otherwise is None:
            low, high = hull(config.plant, config.plant, name, ranges[name])
            if low > 0.0 or not prior.logarithmic:
                ends[place] = prior.scaled(low), prior.scaled(high)
    return ends


def beside_the_edge(name: str, prior: Prior, plant: PlantParameters, limit: float, end: float) -> float:
    """Value, scaled, of an unknown of which only one end is known: that of the rig file if it is possible.

    Else it is the middle between the known end, ``limit``, and the ``end`` of the range, scaled. The known end itself
    would be a claim: that the limit begins where the motion ended.
    """
    own = own_value(plant, name)
    nominal = float(prior.scaled(own)) if own > 0.0 or not prior.logarithmic else math.nan
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
