"""Fits the unknowns of a rig file: most probable values, intervals, and whether the recording determines them.

The windows of a recording share the parameters of the rig, and each has its own initial state. They are short: a small
error of the model cannot grow, and gaps between windows do not matter.

**Scatter.** With a slightly wrong model the windows of a recording contradict each other by more than the noise
explains. The covariance is that of a sandwich whose clusters are the windows, and with several recordings these too:
A⁻¹ B A⁻¹ with the information A and the outer products B of the scores. Few windows estimate B badly: each score is
corrected for the share of the fit that its own window decides (Bell and McCaffrey, *Survey Methodology* 28, 2002), and
the ratio of each variance to that of the model is moderated by the ratio that the unknowns have in common (Smyth,
*Statistical Applications in Genetics and Molecular Biology* 3, 2004).

**Limits.** A limit that the motion never reached, such as the slew limit of a valve, leaves the cost flat beyond the
found value, whatever the slope at it says: the recordings do not determine it.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from hydro_agents.detection.detector import Windows
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.parameters import PARAMETER_LIMITS
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.task.sensors import COMMAND, PRESSURE_A, SENSORS
from hydro_env.types import Floats, Indices, Mask
from hydro_rig.estimation.solver import Problem
from hydro_rig.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LEAKAGE,
    Priors,
    priors_of,
    starts_of,
)
from hydro_rig.identification.common_fit import WELL_FITTED, Common, Joint, common_fit

TAIL = 0.025  # of the 95 % interval, to each side
MODERATION = 4.0  # degrees of freedom of the common ratio; seven windows, the usual number in 20 s, have six
LEAST_RATIO = 1.0  # a variance is never below this share of the model's
MOST_OWN = 0.95  # largest share of a direction that one window decides, in the correction of its score

SURE_RISE = 3.0
"""Rise of the cost, in standard deviations, up to which an end of a range is possible: the few readings that reached a
limit may favour it by chance, and then all larger values are as likely."""
COVERAGE = 1.96  # half width of the 95 % interval of a normal distribution, in standard deviations
DETERMINED = 0.5  # largest standard deviation of a determined unknown, as a share of that of its range


Ranges = Mapping[str, Distribution]  # by name


class Spread(NamedTuple):
    """Uncertainty of the p common unknowns, scaled by their ranges."""

    widening: Floats  # (p,), factor on the standard deviations of the model, from the scatter of the windows
    reach: Floats  # (p,), half of the 95 % interval


def spread_of(joint: Joint, recording: Indices | None = None) -> Spread:
    """The moderated cluster-robust uncertainty of a common fit; the prior counts as known exactly.

    ``recording``: number of the recording of each window, (B,); the larger uncertainty of both clusters counts.
    """
    spread = _spread(joint, joint.information, joint.score)
    if recording is None or len(np.unique(recording)) < 2:
        return spread
    member = np.unique(recording)[:, None] == recording  # (recordings, B)
    other = _spread(joint, np.tensordot(member, joint.information, 1), member @ joint.score)
    return Spread(*map(np.maximum, spread, other))


def _spread(joint: Joint, information: Floats, score: Floats) -> Spread:
    """The uncertainty with clusters of this information (C, p, p) and score (C, p)."""
    covariance = joint.covariance
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    shares, directions = np.linalg.eigh(root @ information @ root)  # of each window, (B, p), (B, p, p)
    own = 1.0 / np.sqrt(1.0 - np.clip(shares, 0.0, MOST_OWN))
    turned = np.einsum("bij,bi->bj", directions, score @ root)
    moves = np.einsum("bij,bj->bi", directions, own * turned) @ root  # (B, p), of the unknowns, by each window
    expected = np.einsum("ij,bjk,ki->bi", covariance, information, covariance)
    total, variance = expected.sum(axis=0), np.diag(covariance)
    ratio = (moves**2).sum(axis=0) / np.maximum(total, 1e-300)
    freedom = total**2 / np.maximum((expected**2).sum(axis=0), 1e-300)  # Satterthwaite: the windows that count
    common = max(1.0, np.median(ratio))
    ratio = np.maximum((MODERATION * common + freedom * ratio) / (MODERATION + freedom), LEAST_RATIO)
    informed = np.clip(total / variance, 0.0, 1.0)  # the rest is the prior's
    widening = np.sqrt(1.0 - informed + informed * ratio)
    quantile = stats.t.ppf(1.0 - TAIL, MODERATION + freedom)
    return Spread(widening, np.minimum(quantile * widening * np.sqrt(variance), stats.norm.ppf(1.0 - TAIL)))


def possible_ends(problem: Problem, joint: Joint, spread: Spread, ends: Floats) -> Mask:
    """Whether the readings allow each unknown to move alone to the lower and to the upper end of its range, (p, 2).

    ``ends``: of the ranges, (p, 2), scaled; infinite for unknowns that no limit describes.
    """
    middle, count = joint.common[:, None], len(joint.shared)
    bounded = (ends[:, :1] < middle) & (middle < ends[:, 1:]) & np.isfinite(ends).all(axis=1, keepdims=True)
    rows = np.repeat(joint.scaled[:, None], 2 * count + 1, axis=1)
    for place, unknown in enumerate(joint.shared):
        rows[:, 2 * place + 1 : 2 * place + 3, unknown] = np.where(bounded[place], ends[place], middle[place])
    known = np.isfinite(problem.measured)
    square = np.ascontiguousarray((problem.residual(rows) ** 2).sum(axis=3).swapaxes(0, 1))  # (2p + 1, B, channels)
    weight = 1.0 / np.maximum(square[0] / np.maximum(known.sum(axis=2), 1), 1.0)  # as in the fit
    cost = np.nan_to_num((weight * square).sum(axis=(1, 2)), nan=np.inf, posinf=np.inf)
    rise = (cost[1:] - cost[0]).reshape(count, 2)
    return bounded & (rise < (SURE_RISE * spread.widening[:, None]) ** 2)


def hull(plant: PlantParameters, found: PlantParameters, path: str, given: Distribution) -> tuple[float, float]:
    """Lowest and highest value that a range allows, SI, including the value without the range.

    Factors multiply the value of the given rig ``plant``; the rig that was ``found`` gives the value of a parameter
    that multiplies the range (``times``).
    """
    factor = own_value(found, given.times) if given.times else 1.0
    ends = [factor * end for end in given.bounds(own_value(plant, path))]
    if given.otherwise is not None:
        ends.append(given.otherwise)
    return min(ends), max(ends)


def range_ends(config: TaskConfig, ranges: Ranges, priors: Priors) -> Floats:
    """Ends of the ranges of some unknowns, (p, 2), scaled by their priors; infinite without a range of its own."""
    ends = np.tile([-np.inf, np.inf], (len(priors), 1))
    for place, (name, prior) in enumerate(priors.items()):
        if name in ranges and ranges[name].otherwise is None:
            low, high = hull(config.plant, config.plant, name, ranges[name])
            if low > 0.0 or not prior.logarithmic:
                ends[place] = prior.scaled(low), prior.scaled(high)
    return ends


def within_bounds(name: str, value: float) -> float:
    """A value within the physical bounds of an unknown: no leak is negative, no area 0."""
    least = 0.0 if name in (LEAKAGE, EXTERNAL_LEAKAGE) else -np.inf
    low, high = PARAMETER_LIMITS.get(name, (least, np.inf))
    return float(np.clip(value, low, high))


def truncated_end(value: float, low: float, high: float) -> float:
    """Upper end of the 95 % interval of a size that cannot be negative, from its normal distribution's interval."""
    deviation = (high - low) / (2.0 * stats.norm.ppf(1.0 - TAIL))
    if low >= 0.0 or deviation <= 0.0:
        return high
    positive = stats.norm.sf(-value / deviation)
    return max(high, value + deviation * stats.norm.isf(TAIL * positive))


class Unknown(NamedTuple):
    """An unknown that the windows share, after the fit; values in its unit."""

    name: str
    value: float  # most probable
    low: float  # ends of the 95 % interval
    high: float
    remaining: float  # standard deviation as a share of that of the range
    widening: float  # factor on the standard deviation of a fit to white noise


class Fit(NamedTuple):
    """Result for the windows of a recording, with p unknowns: parameters, leaks and biases of sensors."""

    unknowns: tuple[Unknown, ...]  # (p,)
    misfit: Floats  # (B,), of each window; infinite for a window that was left out
    noise: Floats = np.ones(len(SENSORS))  # (channels,), over that of the data sheet

    @property
    def explained(self) -> Mask:
        """Whether the model explains the readings of each window within the sensors' noise, (B,)."""
        return self.misfit < WELL_FITTED

    def knows(self, unknown: Unknown) -> bool:
        """Whether the recording determines an unknown.

        A model that explains no window determines nothing: its intervals tell how the model is wrong.
        """
        return unknown.remaining <= DETERMINED and bool(self.explained.any())

    def own(self) -> dict[str, float]:
        """All values by name."""
        return {one.name: one.value for one in self.unknowns}


def unknowns_of(config: TaskConfig, ranges: Ranges, measured: Mask) -> list[str]:
    """Names of the unknowns: parameters with a range, leak, biases of ``measured`` channels, (channels,), and start."""
    plant = [EXTERNAL_LEAKAGE if path == EXTERNAL_RESISTANCE else path for path in ranges]
    biases = [name for name, seen in zip(BIASES, measured, strict=True) if seen and config.sensors.enabled]
    gain = ["pressure_a_gain"] if config.sensors.differential_pressure and measured[PRESSURE_A] else []
    return [LEAKAGE, *plant, *biases, *gain, *starts_of(config)]


def fit_windows(windows: Windows, config: TaskConfig, ranges: Ranges, recording: Indices) -> Fit:
    """Fit the unknowns to windows of one recording, or of several of one axis.

    Each window is fitted alone first. The common fit starts from the values of the window that fits all others best.
    ``ranges`` are those of the rig file; ``recording``: number of the recording of each window.
    """
    common = common_fit(windows, config, priors_of(config, unknowns_of(config, ranges, measured_in(windows))))
    return _summary(common, config, ranges, recording[np.isfinite(common.misfit)])


def measured_in(windows: Windows) -> Mask:
    """The sensors that measured anything in some windows, (channels,)."""
    return np.asarray(np.isfinite(windows.signals[:, :COMMAND]).any(axis=(0, 2)))


def _summary(common: Common, config: TaskConfig, ranges: Ranges, recording: Indices) -> Fit:
    """Values and intervals of the shared unknowns; one that the readings leave open keeps its range."""
    joint, model = common.joint, common.model
    priors = {model.names[place]: model.priors[model.names[place]] for place in joint.shared}
    spread, ends = spread_of(joint, recording), range_ends(config, ranges, priors)
    flat = possible_ends(common.problem, joint, spread, ends)
    unknowns = []
    for row, (name, prior) in enumerate(priors.items()):
        value, left = joint.common[row], spread.reach[row] / COVERAGE
        low, high = value - spread.reach[row], value + spread.reach[row]
        if flat[row].any():
            value, left = _beside(value, flat[row], prior.scaled(own_value(config.plant, name))), 1.0
            low, high = ends[row]
        value, low, high = prior.value(np.array([value, low, high]))
        if name in (LEAKAGE, EXTERNAL_LEAKAGE):
            high = truncated_end(value, low, high)
        value, low, high = (within_bounds(name, end) for end in (value, low, high))
        unknowns.append(Unknown(name, value, low, high, left, spread.widening[row]))
    return Fit(tuple(unknowns), common.misfit, common.noise)


def _beside(value: float, flat: Mask, own: float) -> float:
    """A value whose cost is flat below or above it, scaled: that of the rig file if it lies there.

    The found one would be a claim: that the limit begins where the motion ended.
    """
    return own if np.isfinite(own) and flat[int(own > value)] else value
