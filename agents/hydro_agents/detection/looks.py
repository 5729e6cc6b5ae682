"""Looks: the results of a detector for N axes at regular times, from simulated axes or from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.alarm_detectors import Detector, Evidence, Floats, activity_of
from hydro_env import ConfigurationError


class Looks(NamedTuple):
    """Results of a detector for N axes at L times."""

    time: Floats  # (L,), s, end of each window
    score: Floats  # (N, L), as in Evidence; NaN also after a failure of the axis
    sigma: Floats  # (N, L)
    flow_lpm: Floats  # (N, L), estimated
    cause: NDArray[np.int8]  # (N, L)
    activity: NDArray[np.int8]  # (N, L)
    true_flow_lpm: Floats  # (N, L), l/min at 100 bar, at the end of each window; NaN in a recording

    @property
    def hours(self) -> float:
        """Hours of all axes together."""
        interval = self.time[1] - self.time[0] if len(self.time) > 1 else 0.0
        return float(self.score.size * interval / 3600.0)

    def evidence(self, number: int) -> Evidence:
        """Result of the detector in one look, each array (N,)."""
        rows: Any = (array[:, number] for array in self[1:5])
        return Evidence(*rows)


def joined(parts: Sequence[Looks]) -> Looks:
    """Looks at several groups of axes, at the same times."""
    return Looks(parts[0].time, *(np.concatenate(arrays) for arrays in list(zip(*parts, strict=True))[1:]))


def looks_at(signals: NDArray[Any], control_period: float, detector: Detector, interval: float) -> Looks:
    """Looks of a detector at recorded axes, for :meth:`~hydro_agents.detection.alarm.LeakAlarm.follow`.

    Args:
        signals: (N, 5, T), :data:`~hydro_agents.detection.features.SIGNALS` in SI units, one column per control period;
            NaN = lost.
        control_period: s.
        detector: the detector.
        interval: s, between looks.

    Raises:
        ConfigurationError: the shape is wrong, or the recording is shorter than a window.
    """
    if signals.ndim != 3 or signals.shape[1] != 5:
        raise ConfigurationError(f"alarm: signals have shape {signals.shape}: must be (axes, 5, samples)")
    if signals.shape[2] < detector.window:
        raise ConfigurationError(
            f"alarm: a recording of {signals.shape[2] * control_period:g} s is shorter than a window of "
            f"{detector.window * control_period:g} s"
        )
    detector = deepcopy(detector)  # it may have a memory
    every = max(round(interval / control_period), 1)
    ends = np.arange(detector.window, signals.shape[2] + 1, every)
    windows = [signals[:, :, end - detector.window : end] for end in ends]
    activity = [activity_of(window, control_period) for window in windows]
    unknown = [np.full(len(signals), np.nan) for _ in windows]
    rows = [(*detector(window), *rest) for window, *rest in zip(windows, activity, unknown, strict=True)]
    columns: Any = (np.stack(values, axis=1) for values in zip(*rows, strict=True))
    return Looks((ends - 1) * control_period, *columns)
