"""The whole job of ``hydro alarms``: simulate, calibrate on validation seeds, test on test seeds, and report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.alarm_calibration import Candidate, OnsetLooks, calibrate
from hydro_agents.detection.alarm_proof import (
    delay_table,
    false_alarms,
    fault_table,
    growth_summary,
    growth_table,
    share_table,
)
from hydro_agents.detection.alarm_simulation import Onset, Operation, simulate
from hydro_agents.detection.detector import Detector
from hydro_agents.detection.looks import Activity, Looks, joined
from hydro_agents.running.jobs import Columns, Job, Report, fingerprint, run_jobs
from hydro_agents.running.seeds import (
    ALARM_CALIBRATION,
    ALARM_CALIBRATION_ONSETS,
    ALARM_GROWTH,
    ALARM_ONSETS,
    ALARM_STARTS,
    ALARMS,
    SeedRange,
)
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group

LEVELS = (0.1, 0.3, 1.0)
"""Leaks of the onsets, l/min at 100 bar; the alarm is designed for the first."""

FAULTS = (
    ("valve_null_shift", -0.01),
    ("valve_underlap", 0.025),
    ("valve_flow", -0.3),
    ("spool_position_offset", -0.005),
    ("tank_pressure", 5e5),
    ("external_leak", 1.0),
)
"""Other faults whose onset should raise no alarm, and their magnitudes."""

LIMIT_LPM = 1.0
"""The size to which growing leaks are extrapolated."""


class AlarmJob(Group):
    """Sizes of the job."""

    rate: float = Field(1.0, gt=0.0, le=1e4, description="wanted false alarms per 100 h")
    hours: float = Field(40.0, gt=0.0, le=1e5, description="of healthy axes, for calibration and test each")
    shift: float = Field(600.0, ge=10.0, le=3600.0, description="s; work of one axis")
    past: float = Field(300.0, ge=10.0, le=3600.0, description="s; work before each onset")
    after: float = Field(62.0, ge=1.0, le=3600.0, description="s; work after each onset; growing leaks: the past again")
    axes: int = Field(128, ge=2, le=10_000, description="with the onset of a leak, for each size and activity")
    interval: float = Field(0.5, gt=0.0, le=60.0, description="s; between looks")
    learning: int = Field(60, ge=1, le=10_000, description="looks in each activity until a baseline is known")

    @property
    def axes_of_healthy(self) -> int:
        """Number of healthy axes, each of which works for one shift."""
        return max(int(np.ceil(self.hours * 3600.0 / self.shift)), 20)


SIZES = {
    "head": AlarmJob(),
    "estimator": AlarmJob(hours=2.0, shift=120.0, past=60.0, axes=16, interval=2.0, learning=8),
}
"""Default sizes by detector: for one look the estimator takes a thousand times as long as the head."""


class Work(NamedTuple):
    """Axes at work, and the onsets that each continue the same axes."""

    operation: Operation
    onsets: tuple[Onset, ...] = ()

    def found(self, looks: list[Looks]) -> list[OnsetLooks]:
        """Its looks, onset by onset."""
        before, *each = looks
        time = self.operation.duration
        return [OnsetLooks(onset, time, before, after) for onset, after in zip(self.onsets, each, strict=True)]


@dataclass(frozen=True)
class Bench:
    """Settings that all looks of a calibration share."""

    config: TaskConfig
    controllers: Mapping[str, Controller]  # in turn, one for each job
    detector: Detector
    detector_name: str
    folder: Path | None = None  # for the results of the jobs; None keeps none
    together: int = 128  # largest number of axes of a job
    progress: Report | None = None  # called when a job finishes

    def looks(self, work: Mapping[str, Work]) -> dict[str, list[Looks]]:
        """Looks up to the onset, and after each onset; see :func:`~hydro_agents.detection.alarm_simulation.simulate`.

        Raises:
            ConfigurationError: an operation is shorter than a window, or an axis cannot begin.
        """
        jobs: dict[tuple[str, int], Job] = {}
        acting = [((each, self.detector), fingerprint(each, self.detector)) for each in self.controllers.values()]
        for name, (operation, onsets) in work.items():
            fair = math.ceil(operation.axes / len(acting))
            size = self.together if operation.axes > self.together else fair  # each controller gets a part
            for number, first in enumerate(range(0, operation.axes, size)):
                participant, digest = acting[number % len(acting)]
                count = min(size, operation.axes - first)
                part = replace(operation, first_seed=operation.first_seed + first, axes=count)
                jobs[name, number] = Job(simulated, participant, (self.config, part, onsets), digest)
        named = {f"{name}|{number}": job for (name, number), job in jobs.items()}
        results = run_jobs(named, self.folder, None, self.progress)[0]
        found: dict[str, list[list[Looks]]] = {name: [] for name in work}
        for name, number in jobs:
            result = results[f"{name}|{number}"]
            if result.error:
                raise ConfigurationError(result.error)
            count = 1 + len(work[name].onsets)
            fields = [{key: result.metrics[f"{index}.{key}"] for key in Looks._fields} for index in range(count)]
            found[name].append([Looks(**each) for each in fields])
        return {name: [joined(column) for column in zip(*parts, strict=True)] for name, parts in found.items()}


def simulated(
    acting: tuple[Controller, Detector], config: TaskConfig, operation: Operation, onsets: tuple[Onset, ...]
) -> Columns:
    """The looks of :func:`~hydro_agents.detection.alarm_simulation.simulate`, named ``0.time``, ``0.score``, ….

    Raises:
        ConfigurationError: the operation is shorter than a window, or an axis cannot begin.
    """
    controller, detector = acting
    each = simulate(config, controller, detector, operation, onsets)
    return {f"{index}.{key}": values for index, looks in enumerate(each) for key, values in looks._asdict().items()}


class Result(NamedTuple):
    """Settings of the best candidate, and the tables of the test by name."""

    settings: AlarmSettings
    tables: dict[str, pd.DataFrame]


def run_job(bench: Bench, job: AlarmJob) -> Result:
    """Calibrate an alarm and test it.

    Args:
        bench: task, controllers, detector and folder.
        job: sizes.

    Raises:
        ConfigurationError: too few hours, or a score that does not rise with the leak.
        KeyboardInterrupt: Ctrl-C; the finished jobs remain in the folder.
    """

    def healthy(seeds: SeedRange) -> Work:
        axes = job.axes_of_healthy
        return Work(Operation(seeds.take(axes).start, axes, job.shift, job.interval))

    def leaking(seeds: SeedRange, onsets: tuple[Onset, ...], after: float) -> Work:
        return Work(Operation(seeds.take(job.axes).start, job.axes, job.past, job.interval, after=after), onsets)

    leaks = tuple(Onset(level, then) for level in LEVELS for then in reversed(Activity))
    work = {
        "validation_healthy": healthy(ALARM_CALIBRATION),
        "validation_onsets": leaking(ALARM_CALIBRATION_ONSETS, leaks, job.after),
    }
    looks = bench.looks(work)
    found = work["validation_onsets"].found(looks["validation_onsets"])
    design = [each for each in found if each.onset.leak_lpm == LEVELS[0]]
    moving = [each for each in found if each.onset.then == Activity.MOVING]
    quiet = looks["validation_healthy"][0]
    tried = calibrate(quiet, design, moving, job.rate, job.learning, bench.detector_name)
    settings = tried[0].settings

    others = tuple(Onset(fault=fault) for fault in FAULTS)
    starts = {f"{level:g} l/min from the start": level for level in LEVELS}
    work = {
        "healthy": healthy(ALARMS),
        "onsets": leaking(ALARM_ONSETS, (*leaks, *others), job.after),
        "growth": leaking(ALARM_GROWTH, (Onset(3.0, grows=True),), job.past),
    }
    for number, (name, level) in enumerate(starts.items()):
        first = ALARM_STARTS.take(job.axes, 10_000 * number).start
        work[name] = Work(Operation(first, job.axes, job.past, job.interval, leak_lpm=level))
    looks = bench.looks(work)
    after = work["onsets"].found(looks["onsets"])
    growing = work["growth"].found(looks["growth"])
    tables = {
        "candidates": _candidates(tried),
        "false_alarms": false_alarms(settings, looks["healthy"][0]),
        "delays": delay_table(settings, after[: len(leaks)]),
        "from_the_start": share_table(settings, [(name, looks[name][0]) for name in starts]),
        "other_faults": fault_table(settings, after[len(leaks) :]),
        "growth": growth_summary(growth_table(growing[0], LIMIT_LPM, LEVELS[0])),
    }
    return Result(settings, tables)


def _candidates(tried: list[Candidate]) -> pd.DataFrame:
    rows = []
    for each in tried:
        sums = " + ".join(f"{s.method} {s.memory:g} s" if s.memory else s.method for s in each.settings.sums)
        row: dict[str, object] = {"sums": sums.replace("mean +", "single look +"), "cost": each.cost}
        for name, (median, missed) in each.delays.items():
            row |= {f"{name}_median_s": median, f"{name}_missed": missed}
        rows.append(row)
    return pd.DataFrame(rows)
