"""Looks: the readings of a detector for N axes at regular times, from simulated axes or from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import SIGNALS, Cause, Detector, Reading, Windows
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.types import Floats

STANDING_BELOW, MOVING_FROM = 1e-4, 5e-3
"""Travel per second in m/s: below the first value the axis stands, from the second on it moves."""

USUAL_WINDOW = 2.0  # s, length of the windows of a detector without a ``window`` of its own
_SPAN = 0.1  # averaging time in s of the position before its travel is computed, which removes the noise


class Activity(IntEnum):
    """Activity of an axis during a window; the visibility of a leak depends on it."""

    STANDING = 0
    SLOW = 1
    MOVING = 2


class Looks(NamedTuple):
    """Readings of a detector for N axes at L times."""

    time: Floats  # (L,), s, end of each window
    score: Floats  # (N, L), as in Reading; NaN also after a failure of the axis
    sigma: Floats  # (N, L)
    flow_lpm: Floats  # (N, L), estimated
    cause: NDArray[np.int8]  # (N, L)
    activity: NDArray[np.int8]  # (N, L)
    true_flow_lpm: Floats  # (N, L), l/min at 100 bar, at the end of each window; NaN in a recording

    @property
    def answers(self) -> NDArray[np.bool_]:
        """Looks with an answer, (N, L)."""
        return np.asarray(np.isfinite(self.score) & (self.cause < Cause.UNKNOWN))

    def reading(self, number: int) -> Reading:
        """Reading of one look, each array (N,)."""
        score, sigma, flow, cause = (values[:, number] for values in self[1:5])
        return Reading.of(score, cause, sigma=sigma, flow_lpm=flow)


def joined(parts: Sequence[Looks]) -> Looks:
    """Looks at several groups of axes, at the same times."""
    return Looks(parts[0].time, *(np.concatenate(arrays) for arrays in list(zip(*parts, strict=True))[1:]))


def window_of(detector: Detector, task: TaskConfig) -> int:
    """Control periods of the windows that an alarm gives a detector.

    Raises:
        ConfigurationError: the detector cannot read such windows of this task.
    """
    samples = int(getattr(detector, "window", 0)) or round(USUAL_WINDOW / task.control_period)
    reason = detector.refuses(task, samples)
    if reason:
        raise ConfigurationError(f"alarm: {reason}")
    return samples


def activity_of(signals: NDArray[Any], control_period: float) -> NDArray[np.int8]:
    """:class:`Activity` (N,) during windows of signals (N, 5, T) in SI units; lost samples are left out."""
    position = np.asarray(signals[:, SIGNALS.index("position")], dtype=np.float64)
    count = max(round(_SPAN / control_period), 1)
    blocks = position[:, : position.shape[1] // count * count].reshape(len(position), -1, count)
    present = np.isfinite(blocks)
    means = np.where(present, blocks, 0.0).sum(axis=2) / np.maximum(present.sum(axis=2), 1)
    known = np.asarray(present.any(axis=2))
    travel = np.where(known, means, -np.inf).max(axis=1) - np.where(known, means, np.inf).min(axis=1)
    speed = np.where(known.any(axis=1), travel, 0.0) / (position.shape[1] * control_period)
    return np.asarray((speed >= STANDING_BELOW).astype(np.int8) + (speed >= MOVING_FROM), dtype=np.int8)


def look(detector: Detector, signals: NDArray[Any], task: TaskConfig, end: float) -> tuple[NDArray[Any], ...]:
    """One look at N axes: score, sigma, flow, cause and activity, each (N,), from windows (N, 5, T) in SI units.

    ``end`` is the time in s at which the windows end.
    """
    ends = np.full(len(signals), end)
    begins = ends - (signals.shape[2] - 1) * task.control_period
    reading = detector.read(Windows(np.asarray(signals, dtype=np.float64), begins, ends), task)
    activity = activity_of(signals, task.control_period)
    return reading.score, reading.sigma, reading.flow_lpm, reading.cause.astype(np.int8), activity


def looks_at(signals: NDArray[Any], task: TaskConfig, detector: Detector, interval: float) -> Looks:
    """Looks of a detector at recorded axes, for :meth:`~hydro_agents.detection.alarm.LeakAlarm.follow`.

    Args:
        signals: (N, 5, T), :data:`~hydro_agents.detection.detector.SIGNALS` in SI units, one column per control period;
            NaN = lost.
        task: rig and control period of the axes.
        detector: the detector.
        interval: s, between looks.

    Raises:
        ConfigurationError: the shape is wrong, the recording is shorter than a window, or the detector cannot read it.
    """
    if signals.ndim != 3 or signals.shape[1] != len(SIGNALS):
        raise ConfigurationError(f"alarm: signals have shape {signals.shape}: must be (axes, {len(SIGNALS)}, samples)")
    length, period = window_of(detector, task), task.control_period
    if signals.shape[2] < length:
        raise ConfigurationError(
            f"alarm: a recording of {signals.shape[2] * period:g} s is shorter than a window of {length * period:g} s"
        )
    detector = deepcopy(detector)  # it may have a memory
    ends = np.arange(length, signals.shape[2] + 1, max(round(interval / period), 1))
    unknown = np.full(len(signals), np.nan)
    rows = [(*look(detector, signals[:, :, end - length : end], task, (end - 1) * period), unknown) for end in ends]
    columns: Any = (np.stack(values, axis=1) for values in zip(*rows, strict=True))
    return Looks((ends - 1) * period, *columns)
