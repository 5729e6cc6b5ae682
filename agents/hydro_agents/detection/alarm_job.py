"""The whole job of ``hydro alarms``: simulate, calibrate on validation seeds, test on test seeds, and report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.alarm_calibration import (
    Candidate,
    calibrate,
    delay_columns,
    delays,
    fit_tail,
    missed_share,
    peaks,
    poisson_interval,
    rate_with_interval,
)
from hydro_agents.detection.alarm_simulation import Bench, Onset, OnsetLooks, Work
from hydro_agents.detection.growth import growth
from hydro_agents.detection.looks import Activity, Looks
from hydro_agents.running.seeds import (
    ALARM_CALIBRATION,
    ALARM_CALIBRATION_ONSETS,
    ALARM_GROWTH,
    ALARM_ONSETS,
    ALARM_STARTS,
    ALARMS,
    SeedRange,
)
from hydro_agents.running.statistics import Interval, share_interval
from hydro_env.files import Group

LEVELS = (0.1, 0.3, 1.0)  # leaks of the onsets, l/min at 100 bar; the alarm is designed for the first

FAULTS = (
    ("valve_null_shift", -0.01),
    ("valve_underlap", 0.025),
    ("valve_flow", -0.3),
    ("spool_position_offset", -0.005),
    ("tank_pressure", 5e5),
    ("external_leak", 1.0),
)
"""Other faults whose onset should raise no alarm, and their magnitudes."""

LIMIT_LPM = 1.0  # the size to which growing leaks are extrapolated


BLOCK, FEWEST_LOOKS = 10.0, 4  # s, length of the blocks of looks for the trend of a growing leak; fewest looks of one


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
        return Work(seeds.take(axes).start, axes, job.shift, job.interval)

    def leaking(seeds: SeedRange, onsets: tuple[Onset, ...], after: float) -> Work:
        return Work(seeds.take(job.axes).start, job.axes, job.past, job.interval, after=after, onsets=onsets)

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
        work[name] = Work(first, job.axes, job.past, job.interval, leak_lpm=level)
    looks = bench.looks(work)
    after = work["onsets"].found(looks["onsets"])
    growing = work["growth"].found(looks["growth"])
    tables = {
        "candidates": _candidates(tried),
        "false_alarms": false_alarms(settings, looks["healthy"][0]),
        "delays": delay_table(settings, after[: len(leaks)]),
        "from_the_start": share_table(settings, [(name, looks[name][0]) for name in starts]),
        "other_faults": fault_table(settings, after[len(leaks) :]),
        "growth": growth_summary(growth_table(growing[0], LIMIT_LPM)),
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


def false_alarms(settings: AlarmSettings, healthy: Looks) -> pd.DataFrame:
    """False alarms per 100 h at multiples of the thresholds: counted with a Poisson interval, and from the tail.

    At multiples below 1 alarms are frequent enough to count; the counts check the fitted tail. Alarms cluster: the
    column ``axes`` gives the number of axes with alarms.
    """
    alarm, _ = LeakAlarm(settings).follow(healthy)
    per_axis = peaks(alarm.total)
    everything = np.concatenate(per_axis)
    tail = fit_tail(everything, healthy.hours)
    rows = []
    for factor in (0.25, 0.5, 0.75, 1.0, 1.5):
        count = int((everything > factor).sum())
        counted = poisson_interval(count, healthy.hours / 100.0)
        row = {"threshold": factor, "hours": healthy.hours, "alarms": count}
        row["axes"] = sum(bool((found > factor).any()) for found in per_axis)
        row |= counted.columns("per_100_h")
        if factor >= tail.start:
            by_tail = rate_with_interval(per_axis, healthy.hours, factor)
            row |= {"by_tail": by_tail.value, "tail_low": by_tail.low, "tail_high": by_tail.high}
        rows.append(row)
    return pd.DataFrame(rows)


def delay_table(settings: AlarmSettings, onsets: Sequence[OnsetLooks]) -> pd.DataFrame:
    """Delay from the onset by size and activity: median and 90 % quantile in s, and the share missed after a minute."""
    alarm, rows = LeakAlarm(settings), []
    for found in onsets:
        delay, early = delays(alarm, found)
        kept = delay[~early]
        row: dict[str, Any] = {"leak_lpm": found.onset.leak_lpm, "then": found.onset.activity, "axes": len(kept)}
        row |= {"alarm_before": int(early.sum())} | delay_columns(kept)
        rows.append(row | missed_share(kept).columns("missed"))
    return pd.DataFrame(rows)


def share_table(settings: AlarmSettings, cases: Sequence[tuple[str, Looks]]) -> pd.DataFrame:
    """Share of axes with an alarm at the end, and the time in s until half of the axes have one, case by case."""
    rows = []
    for name, looks in cases:
        alarm, _ = LeakAlarm(settings).follow(looks)
        raised = alarm.alarm
        half = raised.mean(axis=0) >= 0.5
        row = {"case": name, "axes": len(raised), "seconds": float(looks.time[-1])}
        row |= share_interval(int(raised[:, -1].sum()), len(raised)).columns("alarmed")
        rows.append(row | {"half_after_s": float(looks.time[half.argmax()]) if half.any() else np.inf})
    return pd.DataFrame(rows)


def fault_table(settings: AlarmSettings, onsets: Sequence[OnsetLooks]) -> pd.DataFrame:
    """Share of axes that raise an alarm after the onset of another fault with a healthy seal; see :func:`delays`."""
    alarm, rows = LeakAlarm(settings), []
    for found in onsets:
        delay, early = delays(alarm, found)
        hits = np.isfinite(delay[~early])
        name = " ".join(f"{value}" for value in found.onset.fault or ("none",))
        row = {"fault": name, "axes": len(hits), "seconds": float(found.after.time[-1] - found.time)}
        rows.append(row | share_interval(int(hits.sum()), len(hits)).columns("alarmed"))
    return pd.DataFrame(rows)


def growth_table(found: OnsetLooks, limit_lpm: float) -> pd.DataFrame:
    """Predictions for growing leaks at half of a limit: does the interval contain the true time to the limit?

    Looks at an axis that stands are left out: they read a leak too small. The others are averaged over blocks.

    Args:
        found: looks at axes whose leaks grow beyond the limit.
        limit_lpm: the limit, l/min at 100 bar.
    """
    rows, time = [], found.after.time
    for truth, flow, activity in zip(
        found.after.true_flow_lpm, found.after.flow_lpm, found.after.activity, strict=True
    ):
        half, full = (int(np.argmax(truth >= share * limit_lpm)) for share in (0.5, 1.0))
        middle, size = _blocks(time, np.where(activity > Activity.STANDING, flow, np.nan), half + 1)
        ahead, left = growth(middle, size, limit_lpm).ahead, float(time[full] - time[half])
        since = float(time[half] - middle[-1]) if len(middle) else 0.0
        expected = Interval(*(max(value - since, 0.0) / 3600.0 for value in ahead))
        row = {"hours_left": left / 3600.0, **expected.columns("expected_hours")}
        rows.append(row | {"holds": float(expected.low <= left / 3600.0 <= expected.high)})
    return pd.DataFrame(rows)


def _blocks(time: NDArray[Any], flow_lpm: NDArray[Any], looks: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Mean time in s and geometric mean of the leak in each block of the first looks that holds FEWEST_LOOKS."""
    known = np.isfinite(flow_lpm[:looks]) & (flow_lpm[:looks] > 0.0)
    when, size = time[:looks][known], np.log10(flow_lpm[:looks][known])
    if not len(when):
        return when, size
    which = ((when - when[0]) / BLOCK).astype(np.int64)
    counts = np.maximum(np.bincount(which), 1)
    enough = np.bincount(which) >= FEWEST_LOOKS
    return (np.bincount(which, when) / counts)[enough], 10.0 ** (np.bincount(which, size) / counts)[enough]


def growth_summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row: axes with a trend, medians, and the share of intervals that contain the true time."""
    known = table.dropna()  # NaN: too few looks at a readable size
    holds = share_interval(int(known["holds"].sum()), len(known))
    row = {"axes": len(table), "with_trend": len(known), "median_hours_left": float(table["hours_left"].median())}
    row |= {f"median_{name}": float(known[name].median()) for name in ("expected_hours", "low", "high")}
    return pd.DataFrame([row | holds.named("holds")])
