"""The parts of a recording: windows for the fit, and the held-back part, which tests it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import Windows
from hydro_agents.estimation.estimate import estimate
from hydro_agents.estimation.model import Model, noise_of
from hydro_agents.estimation.unknowns import priors_of, starts_of
from hydro_agents.recordings.columns import COMMAND
from hydro_agents.recordings.findings import Finding
from hydro_agents.recordings.sampling import Sampled, bridged, cut
from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.plant.parameters import to_vector
from hydro_env.task.sensors import SENSORS

Floats = NDArray[np.float64]

WINDOW, FEWEST_WINDOWS = 2.0, 5  # s
"""Length of a window, and number of windows; a recording that is too short for five windows has shorter ones."""

SHORTEST_WINDOW = 0.4  # s; shorter windows give too little information, because their start is unknown
FITTED_SHARE = 0.7  # share of the recording, from its start, for the fit
MOST_WINDOWS = 12
"""More windows would take longer and add little: of a longer recording, each twelfth gives the one with most motion."""

LONGEST_HELD_BACK = 10.0  # s

FULL_COMMAND = 0.99  # of the largest command

MOST_SATURATED = 0.9
"""Largest share of the time at full command; a recording with more gives no information about the valve."""

START_FROM = 0.2  # s; the initial state comes from this first part; afterwards the simulation uses only the commands
LEAST_MOTION = 20.0
"""Smallest standard deviation of a channel, as a multiple of its noise, for a meaningful share of variance."""

POSITION = SENSORS.index("position")


class Parts(NamedTuple):
    """A recording cut in parts."""

    fitted: Windows  # for the fit
    begin: float  # s, of the held-back part
    held_back: Floats  # (5, T), in the order of SIGNALS
    findings: list[Finding]  # changes to the samples


def parts_of(samples: Sampled, source: str) -> Parts:
    """Choose the parts of a recording.

    Raises:
        ConfigurationError: the position is missing, the command is saturated, or too few samples are without a gap.
    """
    if not np.isfinite(samples.signals[POSITION]).any():
        raise ConfigurationError(f"{source}: position was not recorded; without it nothing can be identified")
    full = float(np.mean(np.abs(samples.signals[COMMAND]) >= FULL_COMMAND))
    if full > MOST_SATURATED:
        raise ConfigurationError(
            f"{source}: command is at its limit for {100 * full:.0f} % of the recording; the valve was saturated, "
            "which hides its flow, edges and dynamics: record the axis while it follows a reference"
        )
    duration = len(samples.time) * samples.period
    length = round(min(WINDOW, duration / FEWEST_WINDOWS) / samples.period)
    if length * samples.period < SHORTEST_WINDOW:
        needed = FEWEST_WINDOWS * SHORTEST_WINDOW
        raise ConfigurationError(f"{source}: holds {duration:.3g} s of samples; at least {needed:g} s are needed")
    samples, findings = bridged(samples)
    windows = cut(samples, length)
    usable = windows.commanded & (np.isfinite(windows.signals[:, POSITION]).mean(axis=1) > 0.5)
    windows = windows.part(usable)
    count = len(windows)
    if count < FEWEST_WINDOWS - 1:
        raise ConfigurationError(
            f"{source}: only {count} windows of {length * samples.period:g} s have all commands and a position; "
            f"at least {FEWEST_WINDOWS - 1} are needed"
        )
    fitted = min(round(FITTED_SHARE * count), count - 1)
    begin, held_back = _held_back(windows.part(np.arange(count) >= fitted))
    return Parts(_liveliest(windows.part(np.arange(count) < fitted)), begin, held_back, findings)


def _travel(windows: Windows) -> Floats:
    """Range of the position in each window, m."""
    position = windows.signals[:, POSITION]
    travel: Floats = np.nanmax(position, axis=1) - np.nanmin(position, axis=1)
    return travel


def _liveliest(windows: Windows) -> Windows:
    """At most MOST_WINDOWS windows: from each section of the recording, the one with the longest travel."""
    if len(windows) <= MOST_WINDOWS:
        return windows
    sections, travel = np.array_split(np.arange(len(windows)), MOST_WINDOWS), _travel(windows)
    return windows.part(np.array([section[travel[section].argmax()] for section in sections]))


def _held_back(windows: Windows) -> tuple[float, Floats]:
    """The longest stretch of windows without a gap between them, at most LONGEST_HELD_BACK; its start in s."""
    span = float(windows.end[0] - windows.begin[0])
    most = max(round(LONGEST_HELD_BACK / span), 1)
    breaks = np.flatnonzero(np.abs(windows.begin[1:] - windows.end[:-1]) > 0.1 * span) + 1
    stretches = np.split(np.arange(len(windows)), breaks)
    chosen = max(stretches, key=len)[:most]
    return float(windows.begin[chosen[0]]), np.concatenate(list(windows.signals[chosen]), axis=1)


class HeldBack(NamedTuple):
    """The held-back part, measured and simulated."""

    begin: float  # s
    time: Floats  # (T,), s, from its begin
    measured: Floats  # (channels, T), SI
    simulated: Floats  # (channels, T), SI, biases included
    share: Floats  # (channels,), share of variance explained; NaN for an absent channel, or one without motion


def simulate_held_back(
    signals: Floats, begin: float, config: TaskConfig, plant: PlantParameters, biases: Sequence[float]
) -> HeldBack:
    """Simulate a plant on the held-back part; only the initial state comes from its readings, in the first 0.2 s.

    Args:
        signals: (5, T), SI, in the order of SIGNALS.
        begin: of the part in the recording, s.
        config: the task.
        plant: the identified plant.
        biases: of each channel, SI.
    """
    bias = np.asarray(biases)[:, None]
    measured = signals[: len(SENSORS)]
    unbiased = np.concatenate([measured - bias, signals[None, COMMAND]])
    physical = to_vector(plant)[None]
    count = max(round(START_FROM / config.control_period), 10)
    names = starts_of(config)
    found = estimate(unbiased[None, :, : count + 1], config, names, physical=physical)
    model = Model(config, priors_of(config, names), signals[None, COMMAND], physical=physical)
    read, _ = model.readings(found.scaled, np.zeros(1, np.int64))
    simulated = read[0] * model.noise[:, None] + bias
    time = config.control_period * np.arange(signals.shape[1], dtype=np.float64)
    motion = np.array([np.nanstd(row) if np.isfinite(row).any() else 0.0 for row in measured])
    share = np.array([_share(*pair) for pair in zip(measured, simulated, strict=True)])
    share[motion < LEAST_MOTION * noise_of(config)] = np.nan
    return HeldBack(begin, time, measured, simulated, share)


def _share(measured: Floats, simulated: Floats) -> float:
    """Share of the variance that the simulation explains: 1 − mean square error over variance; −∞ after a failure."""
    known = np.isfinite(measured)
    if not known.any():
        return float("nan")
    error = measured[known] - simulated[known]
    share = 1.0 - float(np.mean(error**2)) / max(float(measured[known].var()), 1e-300)
    return share if np.isfinite(share) else float("-inf")
