"""The part ``alarm``: an alarm watches healthy axes for hours, and axes before and after the onset of a leak."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.alarm_calibration import delays, peaks
from hydro_agents.detection.alarm_simulation import Onset, Work, simulate
from hydro_agents.detection.detector import Detector
from hydro_agents.detection.looks import Activity, Looks
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.leak_protocol import HEALTHY, Detectors, LeakProtocol
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.seeds import LEAKAGE_ALARMS, LEAKAGE_ONSETS
from hydro_env import ConfigurationError, TaskConfig

SHIFT, PAST, AFTER = 600.0, 300.0, 62.0
"""Simulated time in s: of a healthy axis; of a leaking axis before and after the onset."""

LEAKS = tuple(Onset(level, then) for level in (0.1, 0.3, 1.0) for then in (None, *Activity))

AXES_TOGETHER = 60


def alarm(protocol: LeakProtocol, chosen: Detectors) -> Iterator[Cell]:
    """Each alarm on ``alarm_hours`` of healthy axes, and on as many axes with the onset of a leak."""
    axes = max(int(np.ceil(protocol.alarm_hours * 3600.0 / SHIFT)), 1)
    for reader, (detector, settings) in chosen.alarms.items():
        digest = fingerprint(detector)
        for measure, seeds, duration, after, onsets in (
            (at_healthy_axes, LEAKAGE_ALARMS.take(axes), SHIFT, 0.0, ()),
            (at_onsets, LEAKAGE_ONSETS.take(axes), PAST, AFTER, LEAKS),
        ):
            jobs = []
            for first in range(0, axes, AXES_TOGETHER):
                count = min(AXES_TOGETHER, axes - first)
                work = Work(seeds.start + first, count, duration, settings.interval, after=after, onsets=onsets)
                jobs.append(Job(measure, detector, (protocol.task, settings, work), digest))
            yield Cell(reader, known={"detector": reader}, jobs=tuple(jobs))


def at_healthy_axes(detector: Detector, config: TaskConfig, settings: AlarmSettings, work: Work) -> Columns:
    """Alarms and hours of each healthy axis.

    Raises:
        ConfigurationError: the detector cannot read the axes, or they cannot begin.
    """
    (looks,) = _looks(detector, config, work)
    found = peaks(LeakAlarm(settings).follow(looks)[0].total)
    return {
        "leak_lpm": np.full(work.axes, HEALTHY),
        "then": np.full(work.axes, "all"),
        "alarms": np.array([float((axis > 1.0).sum()) for axis in found]),
        "hours": np.full(work.axes, looks.hours / work.axes),
    }


def at_onsets(detector: Detector, config: TaskConfig, settings: AlarmSettings, work: Work) -> Columns:
    """Delay in s from each onset to the alarm (infinite: none) of each axis, and whether it had an earlier alarm.

    Raises:
        ConfigurationError: the detector cannot read the axes, or they cannot begin.
    """
    watching, rows = LeakAlarm(settings), []
    for found in work.found(_looks(detector, config, work)):
        delay, early = delays(watching, found)
        columns = {"leak_lpm": found.onset.leak_lpm, "then": found.onset.activity, "delay_s": delay}
        rows.append(pd.DataFrame(columns | {"early": early.astype(float)}))
    return columns_of(pd.concat(rows))


def _looks(detector: Detector, config: TaskConfig, work: Work) -> list[Looks]:
    try:
        return simulate(config, shipped("pid", config), detector, work)
    except ConfigurationError as error:
        raise ConfigurationError(f"the alarm cannot watch: {error}") from None
