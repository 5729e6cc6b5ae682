"""Fits the unknowns of a rig file: most probable values, intervals, and whether the recording determines them.

The windows of a recording share the parameters of the rig, and each has its own initial state. They are short: a small
error of the model cannot grow, and gaps between windows do not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from hydro_agents.detection.detector import Windows
from hydro_env import TaskConfig
from hydro_env.task.randomisation import Distribution
from hydro_env.task.sensors import PRESSURE_A, SENSORS
from hydro_env.types import Floats, Indices, Mask
from hydro_rig.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LEAKAGE,
    Prior,
    priors_of,
    starts_of,
)
from hydro_rig.identification.common_fit import WELL_FITTED, Common, Joint, common_fit, fit_together
from hydro_rig.identification.intervals import (
    Sides,
    Spread,
    beside_the_edge,
    range_ends,
    sides_of,
    spread_of,
    truncated_end,
    within_bounds,
)
from hydro_rig.identification.profiles import pinned, ridge

COVERAGE = 1.96  # half width of the 95 % interval of a normal distribution, in standard deviations
DETERMINED = 0.5
"""A parameter is determined if its standard deviation is at most this share of the standard deviation of its range."""

BY_CHANCE = 0.05  # probability of a disagreement of sound recordings that counts
FARTHEST_STEP = 3.0  # standard deviations of the range; a single step of a linear model reaches no further


class Unknown(NamedTuple):
    """An unknown that the windows share, after the fit; values in its unit."""

    name: str
    prior: Prior
    value: float  # most probable
    low: float  # ends of the 95 % interval
    high: float
    remaining: float  # standard deviation as a share of that of the range
    widening: float  # factor on the standard deviation of a fit to white noise
    side: int = 0  # 1: only the lower end is known, −1: only the upper one, 0: both


class Fit(NamedTuple):
    """Result for the windows of a recording, with p unknowns: parameters, leaks and biases of sensors."""

    unknowns: tuple[Unknown, ...]  # (p,)
    misfit: Floats  # (B,), of each window; infinite for a window that was left out
    joint: Joint  # the common fit of the other windows

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns."""
        return tuple(one.name for one in self.unknowns)

    @property
    def explained(self) -> Mask:
        """Whether the model explains the readings of each window within the sensors' noise, (B,)."""
        return np.asarray(self.misfit < WELL_FITTED)

    @property
    def widening(self) -> Floats:
        """Of each unknown, (p,)."""
        return np.array([one.widening for one in self.unknowns])

    def knows(self, unknown: Unknown) -> bool:
        """Whether the recording determines an unknown; an interval with one known end does not.

        A model that explains no window determines nothing: its intervals tell how the model is wrong.
        """
        return unknown.remaining <= DETERMINED and not unknown.side and bool(self.explained.any())

    def own(self) -> dict[str, float]:
        """All values by name."""
        return {one.name: one.value for one in self.unknowns}


def unknowns_of(config: TaskConfig, ranges: Mapping[str, Distribution], measured: Mask) -> list[str]:
    """Names of the unknowns: parameters with a range, leak, biases of ``measured`` channels, (channels,), and start."""
    plant = [EXTERNAL_LEAKAGE if path == EXTERNAL_RESISTANCE else path for path in ranges]
    biases = [name for name, seen in zip(BIASES, measured, strict=True) if seen and config.sensors.enabled]
    gain = ["pressure_a_gain"] if config.sensors.differential_pressure and measured[PRESSURE_A] else []
    return [LEAKAGE, *plant, *biases, *gain, *starts_of(config)]


def fit_windows(
    windows: Windows,
    config: TaskConfig,
    ranges: Mapping[str, Distribution],
) -> Fit:
    """Fit the unknowns to windows of one recording.

    Each window is fitted alone first. The common fit starts from the values of the window that fits all others best.
    ``ranges`` are those of the rig file.
    """
    measured = np.asarray(np.isfinite(windows.signals[:, : len(SENSORS)]).any(axis=(0, 2)))
    priors = priors_of(config, unknowns_of(config, ranges, measured))
    return _summary(common_fit(windows, config, priors), config, ranges)


def _beside_edges(common: Common, config: TaskConfig, ends: Floats) -> tuple[Joint, Spread, Sides]:
    """Interval ends on one side only: their unknowns move away from the found edge, and the others are fitted again."""
    joint, model = common.joint, common.model
    spread = spread_of(joint)
    sides = sides_of(common.problem, joint, spread, ends, common.explained > 0)
    edges = np.flatnonzero(sides.open)
    if not len(edges):
        return joint, spread, sides
    scaled, places = joint.scaled.copy(), joint.shared[edges]
    moved = {}
    for edge, place in zip(edges.tolist(), places.tolist(), strict=True):
        name, end = model.names[place], ends[edge, int(sides.open[edge] > 0)]
        limit = float(_known_end(joint.common, sides)[edge])
        moved[place] = beside_the_edge(name, model.priors[name], config.plant, limit, float(end))
        scaled += ridge(joint, edge) * (moved[place] - joint.scaled[0, place])
    scaled[:, places] = 0.0
    again = fit_together(pinned(common.problem, moved), scaled)
    for place, value in moved.items():
        again.scaled[:, place] = value
    # The readings say nothing about them here.
    again.information[:, edges] = again.information[:, :, edges] = 0.0
    again.score[:, edges] = again.response[:, :, edges] = 0.0
    return again, spread_of(again), sides


def _known_end(values: Floats, sides: Sides) -> Floats:
    """The known end of each interval with one open side, (p,) scaled."""
    return np.where(sides.open > 0, values - sides.reach[:, 0], values + sides.reach[:, 1])


def _summary(common: Common, config: TaskConfig, ranges: Mapping[str, Distribution]) -> Fit:
    """Values and intervals of the shared unknowns."""
    shared = common.joint.shared
    names = tuple(common.model.names[place] for place in shared)
    priors = {name: common.model.priors[name] for name in names}
    ends = range_ends(config, ranges, priors)
    joint, spread, sides = _beside_edges(common, config, ends)
    values = common.model.values(joint.scaled[0])[shared].tolist()
    reach = np.minimum(np.maximum(sides.reach, spread.reach[:, None]), COVERAGE) * np.array([-1.0, 1.0])
    scaled, known = joint.common[:, None] + reach, _known_end(common.joint.common, sides)
    unknowns = []
    for row, (name, prior) in enumerate(priors.items()):
        side = int(sides.open[row])
        if side:
            scaled[row] = ends[row]
            scaled[row, int(side < 0)] = known[row]
        low, high = prior.value(scaled[row]).tolist()
        if name in (LEAKAGE, EXTERNAL_LEAKAGE):
            high = truncated_end(values[row], low, high)
        value, low, high = (within_bounds(config.plant, name, end) for end in (values[row], low, high))
        remaining = min(float(scaled[row, 1] - scaled[row, 0]) / (2.0 * COVERAGE), 1.0)
        unknowns.append(Unknown(name, prior, value, low, high, remaining, float(spread.widening[row]), side))
    misfit = common.misfit.copy()
    misfit[np.isfinite(misfit)] = joint.misfit
    return Fit(tuple(unknowns), misfit, joint)


def widened(fit: Fit, recording: Indices) -> Fit:
    """The fit with intervals at least as wide as the recordings disagree; a single recording is cut in two halves.

    ``recording``: number of the recording of each window, (B,). Source: random effects, DerSimonian and Laird,
    *Controlled Clinical Trials* 7, 1986.
    """
    group = recording[np.isfinite(fit.misfit)]
    if len(group) < 2:
        return fit
    if len(np.unique(group)) < 2:
        group = np.arange(len(group)) * 2 // len(group)
    unknowns, between = list(fit.unknowns), _disagreement(fit, group)
    for place, one in enumerate(unknowns):
        if between[place] > 0.0 and not one.side:
            middle = fit.joint.common[place]
            reach = np.minimum(np.hypot(COVERAGE * one.remaining, COVERAGE * between[place]), COVERAGE)
            low, high = one.prior.value(np.array([middle - reach, middle + reach])).tolist()
            low, high = min(one.low, low), max(one.high, high)
            unknowns[place] = one._replace(low=low, high=high, remaining=float(reach / COVERAGE))
    return fit._replace(unknowns=tuple(unknowns))


def _disagreement(fit: Fit, group: Indices) -> Floats:
    """Standard deviation between groups of windows that their own uncertainty does not explain, (p,) scaled.

    One Gauss–Newton step from the common values gives the values that each group alone says; ``group``: number of each
    used window.
    """
    joint, numbers, own = fit.joint, np.unique(group), np.eye(len(fit.names))
    middle, deviation = np.empty((2, len(numbers), len(fit.names)))
    for row, number in enumerate(numbers):
        information = joint.information[group == number].sum(axis=0) + own
        # The common values are the optimum of all windows and the prior; this group alone keeps the whole prior.
        step = np.linalg.solve(information, joint.score[group == number].sum(axis=0) - joint.common)
        middle[row] = joint.common + np.clip(step, -FARTHEST_STEP, FARTHEST_STEP)
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
    return disagreement
