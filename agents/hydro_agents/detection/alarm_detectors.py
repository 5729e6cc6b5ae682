"""The detectors below an alarm: each turns a window of measured signals into one number, its evidence."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.features import SIGNALS
from hydro_agents.detection.head import LeakageHead
from hydro_agents.estimation.following import Follower
from hydro_agents.estimation.unknowns import LEAKAGE
from hydro_env import TaskConfig

Floats = NDArray[np.float64]
STANDING_BELOW, MOVING_FROM = 1e-4, 5e-3
"""Travel per second in m/s: below the first value the axis stands, from the second on it moves."""

_SPAN = 0.1
"""Averaging time in s of the position before its travel is computed, which removes the noise."""


class Cause(IntEnum):
    """Cause that a detector names for the state of an axis."""

    SEAL_OR_NOTHING = 0
    EXTERNAL_LEAK = 1
    VALVE_FAULT = 2
    SENSOR_FAULT = 3
    UNKNOWN = 4


class Evidence(NamedTuple):
    """Result of a detector for one window of each of N axes."""

    score: Floats  # (N,), rises with the leak; NaN: the detector cannot tell
    sigma: Floats  # (N,), standard deviation of the score; NaN: unknown
    flow_lpm: Floats  # (N,), estimated leak, l/min at 100 bar
    cause: NDArray[np.int8]  # (N,), :class:`Cause`


class Detector(Protocol):
    """Anything that evaluates windows of measured signals. It may remember earlier windows; `deepcopy` copies it."""

    window: int
    """Control periods of a window."""

    def __call__(self, signals: NDArray[Any]) -> Evidence:
        """Evidence of (N, 5, window) :data:`~hydro_agents.detection.features.SIGNALS` in SI units; NaN: lost."""
        ...


class Activity(IntEnum):
    """Activity of an axis during a window; the visibility of a leak depends on it."""

    STANDING = 0
    SLOW = 1
    MOVING = 2


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


class EstimatorDetector:
    """The estimator with the simulator as model: its score is the leak itself, in l/min at 100 bar.

    If a window begins with the last sample of the previous one, the search starts from the previous estimate; otherwise
    it starts afresh. A window that the model does not explain has the cause "unknown".
    """

    def __init__(self, config: TaskConfig, window: int = 401, threads: int | None = None) -> None:
        self.window = window
        self._follower = Follower(config, window=window, threads=threads)

    @property
    def interval(self) -> float:
        """Time between looks, s."""
        return self._follower.hop * self._follower.config.control_period

    def __call__(self, signals: NDArray[Any]) -> Evidence:
        """Evidence of windows (N, 5, window)."""
        found = self._follower.window_of(signals)
        flow = found.value(LEAKAGE)
        cause = np.where(found.holds, Cause.SEAL_OR_NOTHING, Cause.UNKNOWN).astype(np.int8)
        return Evidence(flow, found.deviation(LEAKAGE), flow, cause)


class HeadDetector:
    """The leakage head as a detector: its score is the logit of the probability of a leak."""

    def __init__(self, head: LeakageHead) -> None:
        self.head = head
        self.window = head.settings.window

    def __call__(self, signals: NDArray[Any]) -> Evidence:
        """Evidence of windows (N, 5, window); the cause is unknown for windows unlike the head's training."""
        estimate = self.head.estimate_windows(signals)
        inside = np.clip(estimate.probability, 1e-12, 1.0 - 1e-12)
        cause = np.where(estimate.outside > 0.0, Cause.UNKNOWN, Cause.SEAL_OR_NOTHING).astype(np.int8)
        return Evidence(np.log(inside / (1.0 - inside)), np.full(len(signals), np.nan), estimate.flow_lpm, cause)
