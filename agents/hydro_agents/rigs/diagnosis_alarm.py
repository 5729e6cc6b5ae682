"""The alarm over a recording: an alarm on top of the leakage head, replayed sample by sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.detector import Detector
from hydro_agents.detection.looks import looks_at, window_of
from hydro_agents.recordings.sampling import Sampled
from hydro_env import TaskConfig

MOST_GAPS = 20
"""Longest duration of a recording including gaps, as a multiple of its sampled time; a longer one is not continuous."""


class Watched(NamedTuple):
    """Result of the alarm."""

    at: float | None  # s, of the alarm; None: there was none
    rate: float | None  # false alarms per 100 h for which it was set
    note: str  # why it did not watch; empty if it watched

    def line(self) -> str:
        """The alarm in one sentence."""
        if self.note:
            return f"The alarm did not watch: {self.note}."
        rate = f", set for a rate of {self.rate:g} per 100 h in healthy axes," if self.rate is not None else ""
        when = f"rose at {self.at:.1f} s" if self.at is not None else "stayed silent"
        return f"The alarm on top of the leakage head{rate} {when}."


def watch(samples: Sampled, head: Detector, task: TaskConfig, settings: AlarmSettings) -> Watched:
    """Run an alarm over a recording, as if the axis had been switched on at its start."""
    rate, count = settings.false_alarms_per_100_h, int(samples.place[-1]) + 1 if len(samples.place) else 0
    if count < window_of(head, task):
        return Watched(None, rate, "the recording is shorter than a window of the head")
    if count > MOST_GAPS * len(samples.place):
        return Watched(None, rate, "most of the time between the first and the last sample was not recorded")
    signals = np.full((1, len(samples.signals), count), np.nan)
    signals[0, :, samples.place] = samples.signals.T
    looks = looks_at(signals, task, head, settings.interval)
    raised = LeakAlarm(settings).follow(looks)[0].alarm[0]
    return Watched(float(looks.time[raised.argmax()]) if raised.any() else None, rate, "")
