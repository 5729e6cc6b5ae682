"""Long jobs of the protocol: an alarm watches healthy axes for hours, and axes before and after the onset of a leak."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.alarm_calibration import PATIENCE, OnsetLooks, delays
from hydro_agents.detection.alarm_rates import peaks, poisson_interval
from hydro_agents.detection.alarm_simulation import Onset, Operation, simulate
from hydro_agents.detection.detector import Detector
from hydro_agents.detection.looks import Activity
from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.jobs import JobResult, digest_of_code
from hydro_agents.running.seeds import LEAKAGE_ALARMS, LEAKAGE_ONSETS
from hydro_agents.running.statistics import share_interval
from hydro_env import ConfigurationError, TaskConfig

FORMAT = "hydro_env alarm job 2"
_ROOMS = ("controllers", "running", "detection", "estimation", "evaluation")

LEVELS = (0.1, 0.3, 1.0)
ACTIVITIES: tuple[Activity | None, ...] = (None, *Activity)
SHIFT, PAST, AFTER = 600.0, 300.0, 62.0
"""Simulated time in s: of a healthy axis; of a leaking axis before and after the onset."""

AXES_TOGETHER = 60


def _name(level: float, then: Activity | None) -> str:
    return f"{level:g} {then.name.lower() if then is not None else 'all'}"


@dataclass(frozen=True)
class AlarmJob:
    """Some axes at work; a pure function of its fields."""

    reader: str
    detector: Detector
    settings: AlarmSettings
    config: TaskConfig
    first_seed: int
    axes: int
    leaks: bool  # true: leaks begin; false: the axes stay healthy
    digest: str = ""  # of the detector; empty: the result is not reused

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of its result: alarms and hours of each axis, or delays in s and earlier alarms."""
        if not self.leaks:
            return ("alarms", "hours")
        return ("early", *(_name(level, then) for level in LEVELS for then in ACTIVITIES))

    @property
    def count(self) -> int:
        """Number of axes."""
        return self.axes

    @property
    def key(self) -> str:
        """A text that is unique in the protocol."""
        return f"alarm|{self.reader}|{self.leaks}|{self.first_seed}"

    @cached_property
    def file(self) -> str:
        """Name of the result file; it differs for every job, detector and version of the code."""
        parts = (
            FORMAT,
            digest_of_code(*_ROOMS),
            self.digest,
            self.config.model_dump_json(),
            self.settings.model_dump_json(),
            json.dumps(asdict(self._operation) | {"leaks": self.leaks}),
        )
        return f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"

    @property
    def _operation(self) -> Operation:
        duration, after = (PAST, AFTER) if self.leaks else (SHIFT, 0.0)
        return Operation(self.first_seed, self.axes, duration, self.settings.interval, after=after)

    def run(self) -> JobResult:
        """Simulate the axes and their looks; an error of the task becomes the result."""
        onsets = tuple(Onset(level, then) for level in LEVELS for then in ACTIVITIES) if self.leaks else ()
        try:
            before, *each = simulate(self.config, shipped("pid", self.config), self.detector, self._operation, onsets)
        except ConfigurationError as error:
            return JobResult({}, f"the alarm cannot watch: {error}")
        alarm = LeakAlarm(self.settings)
        if not self.leaks:
            found = peaks(alarm.follow(before)[0].total)
            alarms = np.array([float((axis > 1.0).sum()) for axis in found])
            return JobResult({"alarms": alarms, "hours": np.full(self.axes, before.hours / self.axes)})
        columns = {}
        for onset, looks in zip(onsets, each, strict=True):
            delay, early = delays(alarm, OnsetLooks(onset, PAST, before, looks))
            assert onset.leak_lpm is not None
            columns[_name(onset.leak_lpm, onset.then)] = delay
        return JobResult({"early": early.astype(np.float64), **columns})


def alarm_plan(
    reader: str, detector: Detector, settings: AlarmSettings, config: TaskConfig, hours: float, digest: str
) -> Iterator[AlarmJob]:
    """The jobs of one alarm: ``hours`` of healthy axes, and axes with the onset of a leak."""
    axes = max(int(np.ceil(hours * 3600.0 / SHIFT)), 1)
    for leaks, seeds in ((False, LEAKAGE_ALARMS.take(axes)), (True, LEAKAGE_ONSETS.take(axes))):
        for first in range(0, axes, AXES_TOGETHER):
            count = min(AXES_TOGETHER, axes - first)
            yield AlarmJob(reader, detector, settings, config, seeds.start + first, count, leaks, digest)


def alarm_table(reader: str, results: dict[bool, list[JobResult]]) -> pd.DataFrame:
    """Table of one alarm: false alarms per 100 h (leak 0), then delay and misses by size and activity after the onset.

    Args:
        reader: name of the detector.
        results: of the jobs without and with leaks.
    """
    rows: list[dict[str, object]] = []
    healthy = [result.metrics for result in results[False]]
    if healthy:
        count = int(sum(each["alarms"].sum() for each in healthy))
        hours = float(sum(each["hours"].sum() for each in healthy))
        rate = poisson_interval(count, hours / 100.0)
        rows.append(
            {"detector": reader, "leak_lpm": HEALTHY, "then": "all", "alarms": count, "hours": hours}
            | {"per_100_h": rate.value, "per_100_h_low": rate.low, "per_100_h_high": rate.high}
            | {"axes": int(sum(len(each["alarms"]) for each in healthy))}
        )
    leaking = [result.metrics for result in results[True]]
    for level in LEVELS if leaking else ():
        for then in ACTIVITIES:
            delay = np.concatenate([each[_name(level, then)][each["early"] == 0.0] for each in leaking])
            missed = share_interval(int((delay > PATIENCE).sum()), len(delay))
            median, late = np.quantile(delay, [0.5, 0.9], method="higher") if len(delay) else (np.nan, np.nan)
            rows.append(
                {"detector": reader, "leak_lpm": level, "then": _name(level, then).split()[1], "axes": len(delay)}
                | {"median_s": float(median), "p90_s": float(late), "missed": missed.value}
                | {"missed_low": missed.low, "missed_high": missed.high}
            )
    return pd.DataFrame(rows)
