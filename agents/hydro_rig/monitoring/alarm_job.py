"""``hydro alarms``: sets an alarm on looks at simulated axes of validation seeds, and tests it on others.

Each axis is simulated for some minutes, healthy and with leaks, and its looks are measured. Hours of operation are then
drawn from them: minute by minute, blocks of looks of the same axis, a quarter of them in motion and the others at rest
(block bootstrap: Künsch, Annals of Statistics 17, 1989). The alarm learns its baselines in the drawn hours as it does
on a machine.

An alarm is an excursion of the evidence: it rises above zero, passes the threshold at its peak, and returns. The
threshold is the lowest at which their rate is a tenth of the wanted one, at the upper end of its interval over axes:
drawn hours do not show that the errors of a long stay at one place are correlated. Intervals come from resampled axes,
because alarms cluster on a few of them.

One look adds at most the clip of the alarm. What is beyond the looks that were measured therefore counts little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field
from scipy.stats import norm

from hydro_agents.detection.alarm import AlarmSettings, AlarmState, LeakAlarm, Scale, Scales
from hydro_agents.detection.looks import Activity, Looks
from hydro_agents.running.seeds import ALARM_CALIBRATION, ALARMS, SeedRange
from hydro_agents.running.statistics import Interval, mean_interval, share_interval
from hydro_env import ConfigurationError
from hydro_env.files import Group
from hydro_env.types import Floats
from hydro_rig.monitoring.alarm_simulation import Bench, Work

LEAST_AXES = 6  # with two answers, for a scale
SHIFT_HOURS = 8.0
IN_MOTION = 0.25  # share of a shift
SAFETY = 10.0  # wanted rate over that of the drawn hours
BLOCK = 60.0  # s; length of the blocks of looks that are drawn
COPIES = 25  # of each axis: shifts that are drawn from its looks
SPREAD_WINDOWS = 8  # fewest windows of the upper tail that gives the spread


def peaks(total: NDArray[Any]) -> list[Floats]:
    """Highest value of each excursion above zero, for each of N axes, from the evidence over time (N, L)."""
    result = []
    for row in np.asarray(total, dtype=np.float64):
        above = np.concatenate([[0], (row > 0.0).astype(np.int8), [0]])
        edges = np.flatnonzero(np.diff(above))
        starts, ends = edges[::2], edges[1::2]
        result.append(np.array([row[first:last].max() for first, last in zip(starts, ends, strict=True)]))
    return result


class Axes(NamedTuple):
    """Looks at axes under one condition, of which hours are drawn; the detector answers at rest once in ``ration``."""

    looks: Looks
    ration: float = 0.0  # s; 0: every look

    @property
    def interval(self) -> float:
        """Time between looks in s."""
        return float(self.looks.time[1] - self.looks.time[0])

    def places(self, activity: Activity) -> list[NDArray[np.int64]]:
        """Of each axis the looks in one activity, in order; without those that the ration left out."""
        chosen = (self.looks.activity == activity) & (np.isfinite(self.looks.score) | (not self.sized(activity)))
        return [np.flatnonzero(row) for row in chosen]

    def scores(self, activity: Activity) -> Floats:
        """Scores that count (N, L) in one activity; NaN: others."""
        counts = (self.looks.activity == activity) & self.looks.answers
        return np.where(counts, self.looks.score, np.nan)

    def sized(self, activity: Activity) -> bool:
        """Whether the scores are compared as sizes: a rationed detector would learn for hours at rest."""
        return activity != Activity.MOVING and self.ration > 0.0

    def residuals(self, activity: Activity) -> Floats:
        """Scores in one activity (N, L) without the mean of the axis, sizes without the true leak."""
        scores = self.scores(activity)
        return scores - (self.looks.true_flow_lpm if self.sized(activity) else _means(scores)[:, None])

    def drawn(self, hours: float, seed: int, copies: int = 1, in_motion: float = IN_MOTION) -> Looks:
        """Hours of each axis, drawn in blocks from its own looks; looks without an answer stay in them.

        Returns:
            Looks with rows for all axes, ``copies`` times.
        """
        generator, size = np.random.default_rng(seed), max(round(BLOCK / self.interval), 1)
        count, blocks = copies * len(self.looks.score), max(round(hours * 3600.0 / self.interval / size), 1)
        moves = generator.random((count, blocks)) < in_motion
        which = np.zeros((count, blocks, size), dtype=np.int32)
        empty = np.ones((count, blocks, size), dtype=np.bool_)
        rationed = max(round(self.ration / self.interval), 1)
        for activity, every in ((Activity.MOVING, 1), (Activity.STANDING, rationed)):
            own, ahead = self.places(activity), np.arange(size) // every
            for row in range(count):
                places, chosen = own[row % len(own)], moves[row] == (activity == Activity.MOVING)
                if len(places):
                    starts = generator.integers(len(places), size=int(chosen.sum()))
                    which[row, chosen] = places[(starts[:, None] + ahead) % len(places)]
                    empty[row, chosen] = np.arange(size) % every > 0
        axes = np.arange(count)[:, None] % len(self.looks.score)
        taken, lost = which.reshape(count, -1), empty.reshape(count, -1)
        columns: Any = (values[axes, taken] for values in self.looks[1:])
        score, sigma, flow, cause, _, truth = columns
        kinds = np.repeat(np.where(moves, Activity.MOVING, Activity.STANDING), size, axis=1).astype(np.int8)
        time = np.arange(blocks * size, dtype=np.float64) * self.interval
        return Looks(time, np.where(lost, np.nan, score), sigma, flow, cause, kinds, truth)


def _means(scores: Floats) -> Floats:
    """Mean of each axis with at least two looks, (N,); NaN: fewer."""
    counts = np.isfinite(scores).sum(axis=1)
    return np.where(counts >= 2, np.nansum(scores, axis=1) / np.maximum(counts, 1), np.nan)


def scale_of(healthy: Axes, leaking: Axes, activity: Activity, learning: int, sizes: tuple[float, float]) -> Scale:
    """The scale of one activity from the same axes healthy and with the leak for which the alarm is designed there.

    Sizes are compared with the largest leak of a healthy seal; other scores with the axis's own baseline. If too few
    axes have an answer, the activity gives no evidence (``shift`` 0).

    Args:
        healthy: looks at healthy axes.
        leaking: looks at the same axes with the leak.
        activity: the activity.
        learning: looks until an axis's own baseline is known.
        sizes: largest leak of a healthy seal, and the leak for which the alarm is designed, l/min at 100 bar.
    """
    means = _means(healthy.scores(activity))
    known = np.isfinite(means)
    if known.sum() < LEAST_AXES:
        return Scale(highest_baseline=0.0, learning=0, spread=1.0, shift=0.0)
    spread = _spread(healthy.residuals(activity), healthy.looks.sigma)
    if healthy.sized(activity):
        return Scale(highest_baseline=sizes[0], learning=0, spread=spread, shift=sizes[1] - sizes[0])
    rises = _means(leaking.scores(activity)) - means
    rises = rises[np.isfinite(rises)]
    shift = float(np.median(rises)) if len(rises) else 0.0
    error = 1.25 * float(np.std(rises)) / np.sqrt(len(rises)) if len(rises) else 0.0  # of a median
    return Scale(
        highest_baseline=float(means[known].max()),
        learning=learning,
        spread=spread,
        shift=shift if shift > 2.0 * error else 0.0,  # otherwise noise
    )


def _spread(residual: Floats, sigma: Floats) -> float:
    """Smallest standard deviation at which one healthy z-score (N, L) of a hundred is as high as that of a Gaussian.

    It is at least the smallest one that the detector gives. False alarms come from the upper tail, which is heavier
    than that of a Gaussian with the same variance. Of few windows a larger share stands for the tail.
    """
    size, given = residual[np.isfinite(residual)], sigma[np.isfinite(residual)]
    low = float(np.nanmin(given)) if np.isfinite(given).any() else 1e-9
    high = max(float(np.abs(size).max()), low)
    below = 1.0 - min(max(0.01, SPREAD_WINDOWS / len(size)), 0.5)
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        wide = np.quantile(size / np.fmax(given, middle), below) > norm.ppf(below)
        low, high = (middle, high) if wide else (low, middle)
    return high


def totals(alarm: LeakAlarm, looks: Looks, state: AlarmState | None = None) -> tuple[NDArray[np.float32], AlarmState]:
    """The sum over its threshold after each look, (N, L), and the memory at the end."""
    state = state if state is not None else alarm.begin(len(looks.score))
    found: NDArray[np.float32] = np.empty(looks.score.shape, dtype=np.float32)
    for number in range(looks.score.shape[1]):
        now, state = alarm.update(looks.reading(number), looks.activity[:, number], state)
        found[:, number] = now.total
    return found, state


def healthy_peaks(settings: AlarmSettings, healthy: Axes) -> tuple[list[Floats], float]:
    """Peaks of the sum over its threshold for each axis in drawn shifts, the first of which the alarm learns; hours."""
    alarm, count = LeakAlarm(settings), len(healthy.looks.score)
    found = peaks(totals(alarm, healthy.drawn(2.0 * SHIFT_HOURS, 0, COPIES))[0])
    return [np.concatenate(found[axis::count]) for axis in range(count)], 2.0 * SHIFT_HOURS * len(found)


def rate_per_100_h(per_axis: list[Floats], hours: float, threshold: float = 1.0) -> Interval:
    """Peaks above a threshold per 100 h, with a 95 % interval from resampled axes."""
    own = hours / len(per_axis) / 100.0
    return mean_interval(np.array([float((axis > threshold).sum()) / own for axis in per_axis]))


def threshold_for(per_axis: list[Floats], hours: float, rate: float) -> float:
    """The lowest threshold with at most ``rate`` peaks per 100 h, at the upper end of their interval over axes."""
    everything = np.sort(np.concatenate(per_axis))[::-1]
    highest = everything[: max(round(hours * rate / 100.0), 1) + 1]
    for value in np.unique(highest):
        threshold = float(np.nextafter(value, np.inf))
        if rate_per_100_h(per_axis, hours, threshold).high <= rate:
            return threshold
    return float(np.nextafter(everything[0], np.inf))


def calibrate(
    healthy: Axes,
    designs: dict[Activity, tuple[float, Axes]],
    rate: float,
    learning: int,
    detector: str,
    healthy_bound: float,
) -> AlarmSettings:
    """Settings of an alarm.

    Args:
        healthy: looks at healthy axes.
        designs: by activity, the leak that the alarm is designed for, and the same axes with it.
        rate: wanted false alarms per 100 h.
        learning: looks in motion until an axis's own baseline is known.
        detector: name of the detector.
        healthy_bound: largest leak of a healthy seal, l/min at 100 bar.

    Raises:
        ConfigurationError: a score that does not rise with the leak, or no evidence at all.
    """
    scales = {}
    for activity, (size, leaking) in designs.items():
        scales[activity.name.lower()] = scale_of(healthy, leaking, activity, learning, (healthy_bound, size))
    interval = round(healthy.interval, 6)
    settings = AlarmSettings(detector=detector, interval=interval, scales=Scales(**scales), false_alarms_per_100_h=rate)
    if not settings.table("shift").any():
        raise ConfigurationError(f"alarms: the score of '{detector}' does not rise with the leak in any activity")
    per_axis, hours = healthy_peaks(settings, healthy)
    if not any(len(axis) for axis in per_axis):
        raise ConfigurationError(f"alarms: healthy axes show '{detector}' no evidence at all; simulate more axes")
    return settings.model_copy(update={"threshold": threshold_for(per_axis, hours, rate / SAFETY)})


LEVELS = (0.05, 0.1, 0.3)  # leaks, l/min at 100 bar

DESIGN = {Activity.STANDING: 0.1, Activity.SLOW: 0.1, Activity.MOVING: 0.05}
"""The leak that the alarm is designed for, in each activity: a look at rest says less."""


SECONDS, LEAKING, INTERVAL = 600.0, 240.0, 4.0
"""s; work of each healthy axis, work of each axis with each leak, between looks."""

LEARNING = 60  # looks in motion until an axis's own baseline is known


class AlarmJob(Group):
    """What the user asks for."""

    rate: float = Field(1.0, gt=0.0, le=1e4, description="wanted false alarms per 100 h")
    axes: int = Field(40, ge=10, le=10_000, description="whose looks are measured, for calibration and test each")


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
        work = Work(first, job.axes, SECONDS, INTERVAL, LEAKING, tuple(leaks))
        return [Axes(each, ration) for each in bench.looks(name, work)]

    designs = sorted(set(DESIGN.values()))
    healthy, *leaking = looks("validation", ALARM_CALIBRATION, designs)
    by_size = dict(zip(designs, leaking, strict=True))
    chosen = {activity: (size, by_size[size]) for activity, size in DESIGN.items()}
    bound = bench.config.leakage.class_bounds[0]
    settings = calibrate(healthy, chosen, job.rate, LEARNING, bench.detector_name, bound)

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
