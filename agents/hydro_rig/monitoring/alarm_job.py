"""The whole job of ``hydro alarms``: measure looks, calibrate on validation seeds, test on test seeds, and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.looks import Activity
from hydro_agents.running.seeds import ALARM_CALIBRATION, ALARMS, SeedRange
from hydro_agents.running.statistics import Interval, mean_interval, share_interval
from hydro_env.files import Group
from hydro_rig.monitoring.alarm_calibration import (
    COPIES,
    SHIFT_HOURS,
    Axes,
    calibrate,
    healthy_peaks,
    rate_per_100_h,
    totals,
)
from hydro_rig.monitoring.alarm_simulation import Bench, Work

LEVELS = (0.05, 0.1, 0.3)  # leaks, l/min at 100 bar

DESIGN = {Activity.STANDING: 0.1, Activity.SLOW: 0.1, Activity.MOVING: 0.05}
"""The leak that the alarm is designed for, in each activity: a look at rest says less."""


class AlarmJob(Group):
    """Sizes of the job."""

    rate: float = Field(1.0, gt=0.0, le=1e4, description="wanted false alarms per 100 h")
    axes: int = Field(40, ge=10, le=10_000, description="whose looks are measured, for calibration and test each")
    seconds: float = Field(600.0, ge=60.0, le=36_000.0, description="work of each healthy axis")
    leaking: float = Field(240.0, ge=60.0, le=36_000.0, description="s; work of each axis with each leak")
    interval: float = Field(4.0, gt=0.0, le=60.0, description="s; between looks")
    learning: int = Field(60, ge=1, le=10_000, description="looks in motion until an axis's own baseline is known")


def run_job(bench: Bench, job: AlarmJob) -> tuple[AlarmSettings, dict[str, pd.DataFrame]]:
    """Calibrate an alarm and test it.

    Args:
        bench: task, controllers, detector and folder.
        job: sizes.

    Returns:
        The settings, and the tables of the test by name.

    Raises:
        ConfigurationError: too few looks, or a score that does not rise with the leak.
        KeyboardInterrupt: Ctrl-C; the finished jobs remain in the folder.
    """
    ration = float(getattr(bench.detector, "ration", 0.0))

    def looks(name: str, seeds: SeedRange, leaks: Sequence[float]) -> list[Axes]:
        first = seeds.take(job.axes).start
        work = Work(first, job.axes, job.seconds, job.interval, job.leaking, tuple(leaks))
        return [Axes(each, ration) for each in bench.looks(name, work)]

    designs = sorted(set(DESIGN.values()))
    healthy, *leaking = looks("validation", ALARM_CALIBRATION, designs)
    by_size = dict(zip(designs, leaking, strict=True))
    chosen = {activity: (size, by_size[size]) for activity, size in DESIGN.items()}
    bound = bench.config.leakage.class_bounds[0]
    settings = calibrate(healthy, chosen, job.rate, job.learning, bench.detector_name, bound)

    fresh, *leaking = looks("work", ALARMS, LEVELS)
    return settings, {
        "false_alarms": false_alarms(settings, fresh),
        "shift": shift_table(settings, fresh, dict(zip(LEVELS, leaking, strict=True))),
    }


def false_alarms(settings: AlarmSettings, healthy: Axes) -> pd.DataFrame:
    """False alarms per 100 h at multiples of the threshold, counted in drawn hours; the intervals are over axes."""
    (per_axis, hours), rows = healthy_peaks(settings, healthy), []
    for factor in (0.25, 0.5, 0.75, 1.0, 1.5):
        row = {"threshold": factor, "axes": len(per_axis), "hours": hours}
        row["axes_with_alarms"] = sum(bool((found > factor).any()) for found in per_axis)
        rows.append(row | rate_per_100_h(per_axis, hours, factor).columns("per_100_h"))
    return pd.DataFrame(rows)


def shift_table(settings: AlarmSettings, healthy: Axes, leaks: Mapping[float, Axes]) -> pd.DataFrame:
    """Share of axes whose leak is missed in a shift of 8 h, and the median time in minutes until the alarm.

    The leak begins with the shift, after a healthy one in which the alarm learnt the axis; or it is there when the
    alarm is switched on.
    """
    rows, alarm = [], LeakAlarm(settings)
    learnt = totals(alarm, healthy.drawn(SHIFT_HOURS, 1, COPIES))[1]
    learnt = alarm.reset(learnt, learnt.alarm)
    for level, axes in leaks.items():
        for state, begins in ((learnt, "after a healthy shift"), (None, "before the alarm is on")):
            drawn = axes.drawn(SHIFT_HOURS, 2, COPIES)
            raised = totals(alarm, drawn, state)[0] > 1.0
            late = np.where(raised.any(axis=1), drawn.time[raised.argmax(axis=1)] / 60.0, np.inf)
            missed = np.isinf(late).reshape(COPIES, -1).mean(axis=0)
            row: dict[str, Any] = {"leak_lpm": level, "begins": begins, "axes": len(missed)}
            row |= {"median_minutes": float(np.quantile(late, 0.5, method="higher"))}
            rows.append(row | _share(missed).named("missed"))
    return pd.DataFrame(rows)


def _share(per_axis: NDArray[Any]) -> Interval:
    """Mean share over axes; its interval is over axes, and that of a count where all axes agree."""
    if np.ptp(per_axis) > 0.0:
        return mean_interval(per_axis)
    return share_interval(round(len(per_axis) * float(per_axis[0])), len(per_axis))
