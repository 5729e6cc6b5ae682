"""The whole job of ``hydro alarms``: simulate, calibrate on validation seeds, test on test seeds, and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

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
from hydro_agents.detection.alarm_simulation import Onset, Operation
from hydro_agents.detection.alarm_store import Bench
from hydro_agents.detection.looks import Activity
from hydro_agents.running.seeds import (
    ALARM_CALIBRATION,
    ALARM_CALIBRATION_ONSETS,
    ALARM_GROWTH,
    ALARM_ONSETS,
    ALARM_STARTS,
    ALARMS,
    SeedRange,
)
from hydro_env.files import Group

Progress = Callable[[str, int, int], None]
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


class Result(NamedTuple):
    """Settings of the best candidate, comparison of the candidates, and the tables of the test by name."""

    settings: AlarmSettings
    tables: dict[str, pd.DataFrame]


@dataclass(frozen=True)
class _Simulated:
    """Looks at axes at work."""

    bench: Bench
    job: AlarmJob
    name: str
    progress: Progress | None

    def healthy(self, seeds: SeedRange) -> Operation:
        axes = self.job.axes_of_healthy
        return Operation(seeds.take(axes).start, axes, self.job.shift, self.job.interval)

    def found(self, part: str, seeds: SeedRange, onsets: tuple[Onset, ...], after: float) -> list[OnsetLooks]:
        past, first_seed = self.job.past, seeds.take(self.job.axes).start
        work = Operation(first_seed, self.job.axes, past, self.job.interval, after=after)
        before, *each = self.bench.looks(f"{self.name}_{part}", work, onsets, self.progress)
        return [OnsetLooks(onset, past, before, looks) for onset, looks in zip(onsets, each, strict=True)]


def run_job(bench: Bench, job: AlarmJob, progress: Progress | None = None) -> Result:
    """Calibrate an alarm and test it.

    Args:
        bench: task, controllers, detector and folder.
        job: sizes.
        progress: called with a phase, the number of axes done, and their number.

    Raises:
        ConfigurationError: too few hours, or files in the folder that belong to another job.
        KeyboardInterrupt: Ctrl-C; the parts that are finished remain in the folder.
    """
    leaks = tuple(Onset(level, then) for level in LEVELS for then in reversed(Activity))
    validation = _Simulated(bench, job, "validation", progress)
    healthy = bench.looks("validation_healthy", validation.healthy(ALARM_CALIBRATION), progress=progress)[0]
    found = validation.found("onsets", ALARM_CALIBRATION_ONSETS, leaks, job.after)
    design = [each for each in found if each.onset.leak_lpm == LEVELS[0]]
    moving = [each for each in found if each.onset.then == Activity.MOVING]
    tried = calibrate(healthy, design, moving, job.rate, job.learning, bench.detector_name)
    settings = tried[0].settings

    test = _Simulated(bench, job, "test", progress)
    others = tuple(Onset(fault=fault) for fault in FAULTS)
    after = test.found("onsets", ALARM_ONSETS, (*leaks, *others), job.after)
    starts = []
    for number, level in enumerate(LEVELS):
        seeds = ALARM_STARTS.take(job.axes, 10_000 * number)
        work = Operation(seeds.start, job.axes, job.past, job.interval, leak_lpm=level)
        starts.append((f"{level:g} l/min from the start", bench.looks(f"test_start_{level:g}", work, (), progress)[0]))
    growing = test.found("growth", ALARM_GROWTH, (Onset(3.0, grows=True),), after=job.past)
    tables = {
        "candidates": _candidates(tried),
        "false_alarms": false_alarms(settings, bench.looks("test_healthy", test.healthy(ALARMS), progress=progress)[0]),
        "delays": delay_table(settings, after[: len(leaks)]),
        "from_the_start": share_table(settings, starts),
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
