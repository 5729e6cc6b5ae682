"""Computes the settings of an alarm from simulated axes of the validation seeds.

Healthy axes give the baselines and the scatter of the looks about them. Axes with the onset of a leak of known size
give the rise of the score. Each candidate way to sum up evidence then gets the thresholds for the wanted rate of false
alarms; the one that finds the leaks soonest is kept.

Alarms are counted as excursions: the evidence of an axis rises above zero, passes the threshold at its peak, and
returns. Where alarms can be counted, their rate has the exact Poisson interval (Garwood, *Fiducial limits for the
Poisson distribution*, Biometrika 28, 1936). Beyond the simulated hours a generalised Pareto distribution is fitted to
the highest peaks (Pickands, *Statistical inference using extreme order statistics*, Annals of Statistics 3, 1975). Its
shape is zero or positive: the peaks of a CUSUM have an exponential tail, shape 0, for each axis (Cramér and Lundberg),
and a mixture of different axes has a heavier one. The interval comes from resampling the axes, because alarms cluster
on a few of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm, Scale, Sum
from hydro_agents.detection.alarm_simulation import OnsetLooks
from hydro_agents.detection.detector import Floats
from hydro_agents.detection.looks import Activity, Looks
from hydro_agents.running.statistics import CONFIDENCE, Interval, share_interval
from hydro_env import ConfigurationError

RESAMPLES = 200

BLOCK = 20.0
"""Length in s of the blocks of looks whose averages give the spread; neighbouring looks have correlated errors."""

HIGHEST_SHARE = 0.95  # share of healthy axes whose baseline is below ``highest_baseline``
PATIENCE = 60.0  # time in s after which an undetected leak counts as missed

CANDIDATES: tuple[tuple[Sum, ...], ...] = (
    (Sum(method="mean"),),
    (Sum(method="mean", memory=10.0),),
    (Sum(method="cusum"),),
    (Sum(method="mean", memory=2.0), Sum(method="cusum")),
    (Sum(method="mean", memory=1.0), Sum(method="mean", memory=5.0), Sum(method="cusum")),
    (Sum(method="mean"), Sum(method="mean", memory=4.0), Sum(method="mean", memory=16.0)),
)


def poisson_interval(count: int, exposure: float) -> Interval:
    """Rate of events per unit of exposure, with its exact interval (Garwood 1936).

    Raises:
        ConfigurationError: the exposure is not positive, or the count negative.
    """
    if not exposure > 0.0 or count < 0:
        raise ConfigurationError(f"rate: {count} events in {exposure:g}: exposure must be positive, count not negative")
    outside = 0.5 * (1.0 - CONFIDENCE)
    low = 0.5 * float(chi2.ppf(outside, 2 * count)) if count else 0.0
    return Interval(count / exposure, low / exposure, 0.5 * float(chi2.ppf(1.0 - outside, 2 * count + 2)) / exposure)


def peaks(total: NDArray[Any]) -> list[Floats]:
    """Highest value of each excursion above zero, for each of N axes, from the evidence over time (N, L)."""
    result = []
    for row in np.asarray(total, dtype=np.float64):
        above = np.concatenate([[0], (row > 0.0).astype(np.int8), [0]])
        edges = np.flatnonzero(np.diff(above))
        starts, ends = edges[::2], edges[1::2]
        result.append(np.array([row[first:last].max() for first, last in zip(starts, ends, strict=True)]))
    return result


@dataclass(frozen=True)
class Tail:
    """Generalised Pareto tail of the peaks above ``start``."""

    start: float
    rate: float  # peaks above the start per hour
    scale: float
    shape: float  # 0: exponential

    def rate_above(self, threshold: float) -> float:
        """Peaks above a threshold (at least ``start``) per hour."""
        excess = max(threshold - self.start, 0.0) / self.scale
        return self.rate * float(
            np.exp(-excess) if self.shape < 1e-9 else (1.0 + self.shape * excess) ** (-1.0 / self.shape)
        )

    def threshold_at(self, rate: float) -> float:
        """Threshold that peaks exceed ``rate`` times per hour; at least ``start``."""
        ratio = self.rate / rate
        if ratio <= 1.0:
            return self.start
        gain = np.log(ratio) if self.shape < 1e-9 else (ratio**self.shape - 1.0) / self.shape
        return self.start + self.scale * float(gain)


def fit_tail(values: Floats, hours: float, highest: int = 100) -> Tail:
    """Tail of the ``highest`` peaks (all, if there are fewer) in ``hours``, by maximum likelihood.

    Raises:
        ConfigurationError: fewer than 10 peaks.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))[::-1]
    if len(ordered) < 10:
        raise ConfigurationError(
            f"alarms: {len(ordered)} peaks of evidence are too few for a tail: must be at least 10; simulate more hours"
        )
    kept = min(highest, len(ordered) - 1)
    start = float(ordered[kept])
    excess = ordered[:kept] - start
    mean = max(float(excess.mean()), 1e-12)

    def cost(parameters: Floats) -> float:
        scale, shape = mean * np.exp(parameters[0]), max(parameters[1], 0.0)
        if shape < 1e-9:
            return float(np.log(scale) + mean / scale)
        return float(np.log(scale) + (1.0 + 1.0 / shape) * np.mean(np.log1p(shape * excess / scale)))

    best = minimize(cost, np.array([-0.1, 0.1]), bounds=[(-5.0, 5.0), (0.0, 2.0)], method="L-BFGS-B")
    return Tail(start, kept / hours, mean * float(np.exp(best.x[0])), float(best.x[1]))


def rate_with_interval(per_axis: list[Floats], hours: float, threshold: float) -> Interval:
    """Alarms per 100 h at a threshold, from the tail, with a 95 % interval from resampled axes."""
    generator = np.random.default_rng(0)
    rates = []
    for number in range(RESAMPLES + 1):
        chosen = np.arange(len(per_axis)) if number == 0 else generator.integers(0, len(per_axis), len(per_axis))
        tail = fit_tail(np.concatenate([per_axis[axis] for axis in chosen]), hours)
        rates.append(100.0 * tail.rate_above(threshold))
    low, high = np.quantile(rates[1:], [0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)])
    return Interval(rates[0], float(low), float(high))


class Candidate(NamedTuple):
    """A candidate with its thresholds and its delays on validation axes."""

    settings: AlarmSettings
    delays: dict[str, tuple[float, float]]  # by onset: median in s, share missed

    @property
    def cost(self) -> float:
        """Mean over the onsets of log(median delay, at most PATIENCE) + share missed."""
        logs = [np.log(min(median, PATIENCE)) + missed for median, missed in self.delays.values()]
        return float(np.mean(logs))


def _scores(looks: Looks, activity: Activity) -> Floats:
    return np.where(looks.activity == activity, looks.score, np.nan)


def _medians(scores: Floats, least: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Median of each axis (N,), and whether it has at least ``least`` looks."""
    enough = np.isfinite(scores).sum(axis=1) >= least
    medians = np.full(len(scores), np.nan)
    medians[enough] = np.nanmedian(scores[enough], axis=1)
    return medians, enough


def scale_of(healthy: Looks, design: Sequence[OnsetLooks], activity: Activity, learning: int) -> Scale:
    """The scale of one activity.

    The spread is the standard deviation of averages over blocks, times the square root of the looks in a block. Looks
    with correlated errors therefore get less weight.

    Raises:
        ConfigurationError: too few healthy axes had this activity for long enough.
    """
    scores = _scores(healthy, activity)
    medians, enough = _medians(scores, learning)
    if enough.sum() < 20:
        raise ConfigurationError(
            f"alarms: {enough.sum()} healthy axes were {activity.name.lower()} for {learning} looks: must be at least "
            "20; simulate more hours"
        )
    interval = float(healthy.time[1] - healthy.time[0])
    size = max(round(BLOCK / interval), 1)
    residual = scores[enough] - medians[enough, None]
    blocks = residual[:, : residual.shape[1] // size * size].reshape(len(residual), -1, size)
    known = np.isfinite(blocks).sum(axis=2)
    squares = np.nansum(blocks, axis=2) ** 2 / np.maximum(known, 1)
    spread = float(np.sqrt(squares[known >= 0.5 * size].mean()))
    rises: list[float] = []
    for found in design:
        own, _ = _medians(_scores(found.before, activity), learning // 2)
        own = np.where(np.isnan(own), np.median(medians[enough]), own)
        later, seen = _medians(_scores(found.after, activity), size // 4)
        rises.extend((later - own)[seen])
    shift = float(np.median(rises)) if rises else 0.0
    error = 1.25 * float(np.std(rises)) / np.sqrt(len(rises)) if rises else 0.0  # of a median
    shift = shift if shift > 2.0 * error else 0.0  # otherwise noise
    return Scale(highest_baseline=float(np.quantile(medians[enough], HIGHEST_SHARE)), spread=spread, shift=shift)


def thresholds(settings: AlarmSettings, healthy: Looks, rate: float) -> AlarmSettings:
    """The settings with thresholds for ``rate`` false alarms per 100 h; each sum gets the same share of them."""
    single = []
    for each in settings.sums:
        alone = settings.model_copy(update={"sums": (each.model_copy(update={"threshold": 1.0}),)})
        share = rate / 100.0 / len(settings.sums)
        single.append(max(_threshold(alone, healthy, share), 1e-6))
    pairs = zip(settings.sums, single, strict=True)
    sums = tuple(each.model_copy(update={"threshold": threshold}) for each, threshold in pairs)
    together = settings.model_copy(update={"sums": sums})
    factor = _threshold(together, healthy, rate / 100.0) if len(sums) > 1 else 1.0
    final = tuple(each.model_copy(update={"threshold": each.threshold * factor}) for each in sums)
    return settings.model_copy(update={"sums": final, "false_alarms_per_100_h": rate})


def _threshold(settings: AlarmSettings, healthy: Looks, per_hour: float) -> float:
    alarm, _ = LeakAlarm(settings).follow(healthy)
    return fit_tail(np.concatenate(peaks(alarm.total)), healthy.hours).threshold_at(per_hour)


def delays(alarm: LeakAlarm, found: OnsetLooks) -> tuple[Floats, NDArray[np.bool_]]:
    """Time in s from the onset to the alarm (infinite: none), and which axes had an alarm before the onset, (N,)."""
    before, state = alarm.follow(found.before)
    raised = alarm.follow(found.after, state)[0].alarm
    delay = found.after.time[raised.argmax(axis=1)] - found.time
    return np.where(raised.any(axis=1), delay, np.inf), before.alarm[:, -1]


def delay_columns(delay: Floats) -> dict[str, Any]:
    """Columns of a table: axes, and median and 90 % quantile of their delays in s."""
    median, late = np.quantile(delay, [0.5, 0.9], method="higher") if len(delay) else (np.nan, np.nan)
    return {"axes": len(delay), "median_s": float(median), "p90_s": float(late)}


def missed_share(delay: Floats) -> Interval:
    """Share of axes whose leak is not found after :data:`PATIENCE`."""
    return share_interval(int((delay > PATIENCE).sum()), len(delay))


def delay_figures(alarm: LeakAlarm, found: OnsetLooks) -> tuple[float, float]:
    """Median delay in s and share missed, over the axes without an alarm before the onset."""
    delay, early = delays(alarm, found)
    kept = delay[~early]
    if len(kept) == 0:
        return float("nan"), 1.0
    return float(np.median(kept)), float(np.mean(kept > PATIENCE))


def calibrate(
    healthy: Looks,
    design: Sequence[OnsetLooks],
    onsets: Sequence[OnsetLooks],
    rate: float,
    learning: int,
    detector: str,
) -> list[Candidate]:
    """All :data:`CANDIDATES` with their thresholds, the best first.

    Args:
        healthy: looks at healthy axes.
        design: onsets of the leak that the alarm is designed for, in each activity.
        onsets: onsets by which the candidates are compared.
        rate: wanted false alarms per 100 h.
        learning: looks in each activity until an axis's own baseline is known.
        detector: name of the detector.

    Raises:
        ConfigurationError: too few looks.
    """
    base = AlarmSettings(
        detector=detector,
        interval=round(float(healthy.time[1] - healthy.time[0]), 6),
        learning=learning,
        scales={each.name.lower(): scale_of(healthy, design, each, learning) for each in Activity},
        sums=CANDIDATES[0],
    )
    if not base.table("shift").any():
        raise ConfigurationError(f"alarms: the score of '{detector}' does not rise with the leak in any activity")
    tried: list[Candidate] = []
    refused: ConfigurationError | None = None
    for sums in CANDIDATES:
        try:
            settings = thresholds(base.model_copy(update={"sums": sums}), healthy, rate)
        except ConfigurationError as error:  # too few peaks for its tail
            refused = error
            continue
        alarm = LeakAlarm(settings)
        reached = {each.onset.name: delay_figures(alarm, each) for each in onsets}
        tried.append(Candidate(settings, reached))
    if not tried and refused is not None:
        raise refused
    return sorted(tried, key=lambda each: each.cost)
