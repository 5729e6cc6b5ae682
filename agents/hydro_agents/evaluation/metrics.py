"""Control metrics of one episode; NaN where a metric has no meaning."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.running.cases import Rollout

Array = NDArray[np.floating]

SETTLING_BAND = 0.2e-3  # m; an axis is settled while it stays this close to a constant reference
STANDSTILL = 0.1  # s; a reference that is constant for at least this long is a target on which the axis must settle
FINAL_SHARE = 0.05  # s; the last part of a standstill, over which the steady-state error is averaged

REVERSAL_THRESHOLD = 0.005
"""Swing of the command, as a fraction of 10 V, that counts as a reversal: a servo valve does not respond to smaller
ones."""


ERROR, ERROR_SENSOR = "mean_error_mm", "mean_error_sensor_mm"  # the metrics by which controllers are compared
RETURN = "return"

FRAMES_TEXT = (
    "Accuracy is the error of the true position. Repeatability is the error of the position that the sensor reads "
    "without noise: the constant bias of the sensor, which no controller can see, does not count. The terms are "
    "borrowed from ISO 230-2; its procedure, repeated approaches to target positions, is not run here."
)


class Metric(NamedTuple):
    """A figure of one episode: its column in every CSV file, and how tables and pages show it.

    An entry of :data:`METRICS` and its computation in :func:`case_metrics` add a metric to every table and page that
    compares controllers.
    """

    name: str
    unit: str
    word: str
    meaning: str
    shown_unit: str = ""  # on pages, with the factor; default: the unit
    factor: float = 1.0
    cost: bool = False  # stands beside every error: an error is no result without its price
    ratio: str = ""  # short name; tables compare its mean with the baseline's in the column NAME_ratio

    @property
    def label(self) -> str:
        """Word and shown unit, for headers of tables."""
        return f"{self.word}, {self.shown_unit or self.unit}"


_METRICS = (
    Metric("mean_error_mm", "mm", "Mean error", "accuracy: mean of |reference − position|"),
    Metric("peak_error_mm", "mm", "Peak error", "largest error"),
    Metric(
        "settling_time_s",
        "s",
        "Settling time, if settled",
        "from the start of a standstill of the reference until the error stays within ±0.2 mm; the end of the "
        "standstill, when the preview shows the next move, does not count",
    ),
    Metric(
        "unsettled_share",
        "1",
        "Standstills without settling",
        "share of standstills on which the axis never settled",
        shown_unit="%",
        factor=100.0,
    ),
    Metric(
        "overshoot_percent",
        "%",
        "Overshoot of steps",
        "beyond the target, relative to the size of the step (family 'step')",
    ),
    Metric(
        "steady_state_error_mm",
        "mm",
        "Steady-state error",
        "|mean error| over the last 50 ms of a standstill, before the next move is in the preview",
    ),
    Metric(
        "mean_error_sensor_mm",
        "mm",
        "Mean error in the frame of the sensor",
        "repeatability: mean of |reference − reading|, without the sensor's noise: visible to a controller",
    ),
    Metric(
        "peak_error_sensor_mm",
        "mm",
        "Peak error in the frame of the sensor",
        "largest |reference − reading|, without the sensor's noise",
        ratio="peak",
    ),
    Metric(
        "steady_state_error_sensor_mm",
        "mm",
        "Steady-state error in the frame of the sensor",
        "the steady-state error between reference and reading, without noise",
        ratio="offset",
    ),
    Metric(
        "valve_travel_per_s",
        "1/s",
        "Valve travel",
        "travel of the spool in full strokes per second",
        shown_unit="strokes per second",
        cost=True,
        ratio="travel",
    ),
    Metric(
        "reversals_per_s",
        "1/s",
        "Reversals",
        "changes of the command's direction by more than 0.5 % of 10 V",
        shown_unit="per second",
        cost=True,
        ratio="reversals",
    ),
    Metric(
        "supply_energy_j",
        "J",
        "Energy from the supply",
        "∫ of the flow that the valve draws, times supply pressure",
        cost=True,
        ratio="energy",
    ),
    Metric(RETURN, "1", "Return", "sum of the task's rewards in the episode; at most 0"),
    Metric("failed", "1", "Failed runs", "1 if the axis failed", shown_unit="%", factor=100.0, cost=True),
)

METRICS = {metric.name: metric for metric in _METRICS}  # every metric of an episode

COMPARED = {
    f"{metric.ratio}_ratio": metric for metric in sorted(METRICS.values(), key=lambda m: not m.cost) if metric.ratio
}
"""Metrics of the ratios beside that of the error, costs first, by their columns."""


def standstills(reference: Array, period: float) -> list[tuple[int, int]]:
    """Stretches [first, last) of samples on which the reference is constant after it has moved."""
    moving = np.flatnonzero(np.diff(reference) != 0.0) + 1
    edges = [*moving, len(reference)]
    shortest = math.ceil(STANDSTILL / period - 1e-9)
    return [(a, b) for a, b in pairwise(edges) if b - a >= shortest]


def settling_time(error: Array, period: float) -> float:
    """Time in s from the first sample until |error| stays within the band; NaN if it does not."""
    outside = np.flatnonzero(np.abs(error) > SETTLING_BAND)
    if not len(outside):
        return 0.0
    if outside[-1] == len(error) - 1:
        return math.nan
    return (outside[-1] + 1) * period


def overshoot(position: Array, start: float, target: float) -> float:
    """Largest excess beyond the target in % of the step from ``start`` to ``target``; 0 without excess."""
    return float(max(np.max((position - target) / (target - start)), 0.0) * 100.0)


def reversals(command: Array) -> int:
    """Number of turning points at which the command swings back by more than :data:`REVERSAL_THRESHOLD`."""
    count, direction = 0, 0
    extreme = low = high = float(command[0])
    for value in np.asarray(command, float).tolist():
        if direction == 0:
            low, high = min(low, value), max(high, value)
            if high - low > REVERSAL_THRESHOLD:
                direction, extreme = (1 if value == high else -1), value
        elif direction * (value - extreme) >= 0.0:
            extreme = value
        elif direction * (extreme - value) > REVERSAL_THRESHOLD:
            count, direction, extreme = count + 1, -direction, value
    return count


def case_metrics(rollout: Rollout, case: int, period: float, is_step: bool, preview: float) -> dict[str, float]:
    """All METRICS of one episode; overshoot has a meaning if its reference ``is_step``.

    The controller sees the reference ``preview`` seconds ahead. The same time at the end of each standstill does not
    count, because an axis may start before the reference does.
    """
    position, reference, command, spool, power, reward = (
        getattr(rollout, name)[case] for name in ("position", "reference", "command", "spool", "supply_power", "reward")
    )
    bias = rollout.position_bias[case]
    error = np.asarray(reference, float) - position
    settling, offsets, beyond = [], [], []
    final = max(round(FINAL_SHARE / period), 1)
    ahead = round(preview / period)
    for first, end in standstills(reference, period):
        last = end - ahead
        if last - first < final:
            continue
        settling.append(settling_time(error[first:last], period))
        offsets.append(error[last - final : last].mean())
        if is_step:
            beyond.append(overshoot(position[first:last], float(reference[first - 1]), float(reference[first])))
    settled = [value for value in settling if not math.isnan(value)]

    def mean(values: list[float]) -> float:
        return float(np.mean(values)) if values else math.nan

    return {
        "mean_error_mm": 1e3 * np.abs(error).mean(),
        "peak_error_mm": 1e3 * np.abs(error).max(),
        "settling_time_s": mean(settled),
        "unsettled_share": 1.0 - len(settled) / len(settling) if settling else math.nan,
        "overshoot_percent": mean(beyond),
        "steady_state_error_mm": 1e3 * mean([abs(offset) for offset in offsets]),
        "mean_error_sensor_mm": 1e3 * np.abs(error - bias).mean(),
        "peak_error_sensor_mm": 1e3 * np.abs(error - bias).max(),
        "steady_state_error_sensor_mm": 1e3 * mean([abs(offset - bias) for offset in offsets]),
        "valve_travel_per_s": np.sum(np.abs(np.diff(spool))) / (period * len(spool)),
        "reversals_per_s": reversals(command) / (period * len(command)),
        "supply_energy_j": power.sum(dtype=float) * period,
        RETURN: reward.sum(dtype=float),
        "failed": rollout.failed_at[case] >= 0,
    }


def rollout_metrics(
    rollout: Rollout, families: NDArray[np.str_], period: float, preview: float = 0.0
) -> dict[str, Array]:
    """METRICS of every case, arrays (N,); the arguments are those of :func:`case_metrics`."""
    rows = [case_metrics(rollout, case, period, family == "step", preview) for case, family in enumerate(families)]
    return {name: np.array([row[name] for row in rows]) for name in METRICS}
