"""Fits the unknowns of a rig file: most probable values, intervals, and whether the recording determines them.

The windows of a recording share the parameters of the rig, and each has its own initial state. They are short: a small
error of the model cannot grow, and gaps between windows do not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hydro_agents.detection.detector import Windows
from hydro_env import TaskConfig
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.task.sensors import PRESSURE_A, SENSORS
from hydro_env.types import Floats, Indices, Mask
from hydro_rig.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LEAKAGE,
    priors_of,
    starts_of,
)
from hydro_rig.identification.common_fit import WELL_FITTED, Common, common_fit
from hydro_rig.identification.intervals import possible_ends, range_ends, spread_of, truncated_end, within_bounds

COVERAGE = 1.96  # half width of the 95 % interval of a normal distribution, in standard deviations
DETERMINED = 0.5
"""A parameter is determined if its standard deviation is at most this share of the standard deviation of its range."""


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
        return np.asarray(self.misfit < WELL_FITTED)

    def knows(self, unknown: Unknown) -> bool:
        """Whether the recording determines an unknown.

        A model that explains no window determines nothing: its intervals tell how the model is wrong.
        """
        return unknown.remaining <= DETERMINED and bool(self.explained.any())

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
    recording: Indices | None = None,
) -> Fit:
    """Fit the unknowns to windows of one recording, or of several of one axis.

    Each window is fitted alone first. The common fit starts from the values of the window that fits all others best.
    ``ranges`` are those of the rig file; ``recording``: number of the recording of each window.
    """
    measured = np.asarray(np.isfinite(windows.signals[:, : len(SENSORS)]).any(axis=(0, 2)))
    priors = priors_of(config, unknowns_of(config, ranges, measured))
    common = common_fit(windows, config, priors)
    group = None if recording is None else recording[np.isfinite(common.misfit)]
    return _summary(common, config, ranges, group)


def _summary(common: Common, config: TaskConfig, ranges: Mapping[str, Distribution], recording: Indices | None) -> Fit:
    """Values and intervals of the shared unknowns; one that the readings leave open keeps its range."""
    joint, model = common.joint, common.model
    priors = {model.names[place]: model.priors[model.names[place]] for place in joint.shared}
    spread, ends = spread_of(joint, recording), range_ends(config, ranges, priors)
    flat = possible_ends(common.problem, joint, spread, ends)
    unknowns = []
    for row, (name, prior) in enumerate(priors.items()):
        value, left = joint.common[row], float(spread.reach[row]) / COVERAGE
        low, high = value - spread.reach[row], value + spread.reach[row]
        if flat[row].any():
            value, left = _beside(value, flat[row], prior.scaled(own_value(config.plant, name))), 1.0
            low, high = ends[row]
        value, low, high = prior.value(np.array([value, low, high])).tolist()
        if name in (LEAKAGE, EXTERNAL_LEAKAGE):
            high = truncated_end(value, low, high)
        value, low, high = (within_bounds(config.plant, name, end) for end in (value, low, high))
        unknowns.append(Unknown(name, value, low, high, left, float(spread.widening[row])))
    return Fit(tuple(unknowns), common.misfit, common.noise)


def _beside(value: float, flat: Mask, own: float) -> float:
    """A value whose cost is flat below or above it, scaled: that of the rig file if it lies there.

    The found one would be a claim: that the limit begins where the motion ended.
    """
    return own if np.isfinite(own) and flat[int(own > value)] else value
