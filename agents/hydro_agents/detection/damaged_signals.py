"""Damaged signals: lost samples take the previous reading, and sensors that repeat one reading count as stuck."""

from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.balance_parts import follow_commands
from hydro_agents.detection.sheet import POINTS, SOURCES, Sheet
from hydro_env import TaskConfig
from hydro_env.compiling import compiled, inline
from hydro_env.task.sensors import COMMAND, SENSORS, SPOOL
from hydro_env.types import Array, Floats, Mask

LONGEST_GAP = 5  # samples; a reading that stays at the lower end of its range for longer is valid

FAR_FROM_END, FAR_FROM_END_SPOOL = 0.05, 0.3  # share of a range; a reading that falls by more within a period is lost

SHORTEST, FEWEST = 0.1, 20
"""s, and samples: shortest repetition of one reading that marks a sensor as stuck. With noise of one acquisition step,
the smallest that is judged, 20 equal readings occur by chance once in 10¹¹ samples."""


@inline
def mark_missing(values, lost):
    """Mark NaN by 1 in ``lost``, anything else by 0."""
    for k in range(values.shape[0]):
        lost[k] = 0.0
        if values[k] != values[k]:
            lost[k] = 1.0


@inline
def mark_lost(values, low, high, far, lost):
    """Mark lost samples by 1 in ``lost``: NaN, and short falls to the lower end of the sensor's range.

    ``far`` is the fraction of the range by which a valid signal does not fall within one period.
    """
    samples = values.shape[0]
    end = low + 1e-9 * (high - low)
    begin = 0  # of the run of readings at the end of the range
    mark_missing(values, lost)
    for k in range(samples + 1):
        if not (k < samples and values[min(k, samples - 1)] <= end):
            if k - begin <= LONGEST_GAP:
                for gap in range(begin, k):
                    fallen = lost[max(gap - 1, 0)] == 0.0 and values[max(gap - 1, 0)] > low + far * (high - low)
                    if gap > begin or fallen or (begin == 0 and values[samples - 1] <= end):
                        lost[gap] = 1.0
            begin = k + 1


@inline
def fill_gaps(values, lost, filled):
    """Copy a signal to ``filled``, with lost readings replaced by the previous one; returns the share of lost readings.

    Gaps at the start take the first reading; a signal without any reading is 0.
    """
    samples = values.shape[0]
    first = 0
    for k in range(samples):
        if lost[k] == 0.0:
            first = k
            break
    held, share = values[first], 0.0
    if values[first] != values[first]:
        held = 0.0
    for k in range(samples):
        if lost[k] == 0.0:
            held = values[k]
        else:
            share += 1.0
        filled[k] = held
    return share / samples


def _build_repair(sources: int) -> Any:
    def repair(signals, sheet, filled, lost):
        assert sources >= 0  # keys numba's cache
        flags, valve = np.empty(signals.shape[2]), np.empty(3)
        for window in range(signals.shape[0]):
            for sensor in range(lost.shape[1]):
                far = FAR_FROM_END_SPOOL if sensor == SPOOL else FAR_FROM_END
                values = signals[window, sensor]
                mark_lost(values, sheet.sensor_low[sensor], sheet.sensor_high[sensor], far, flags)
                lost[window, sensor] = fill_gaps(values, flags, filled[window, sensor])
            mark_missing(signals[window, COMMAND], flags)
            fill_gaps(signals[window, COMMAND], flags, filled[window, COMMAND])
            if lost[window, SPOOL] == 1.0:  # no such sensor
                usual = sheet.transition[sheet.transition.shape[0] // 2]
                follow_commands(filled[window, COMMAND], usual[POINTS], valve, filled[window, SPOOL])

    return compiled(repair)


def _build_find_stuck(sources: int) -> Any:
    def find_stuck(signals, bounds, stuck):
        assert sources >= 0  # keys numba's cache
        for window in range(signals.shape[0]):
            for sensor in range(bounds.shape[0]):
                low, high, shortest = bounds[sensor, 0], bounds[sensor, 1], bounds[sensor, 2]
                values = signals[window, sensor]
                run = 0.0
                stuck[window, sensor] = 0.0
                for k in range(1, signals.shape[2]):
                    if values[k] == values[k - 1] and low < values[k] < high:
                        run += 1.0
                    else:
                        run = 0.0
                    if run >= shortest:
                        stuck[window, sensor] = 1.0

    return compiled(find_stuck)


repair, find_stuck = _build_repair(SOURCES), _build_find_stuck(SOURCES)


class Repaired(NamedTuple):
    """Signals without gaps."""

    signals: Floats  # (N, 5, T), lost samples replaced by the previous reading
    lost: Floats  # (N, 4), share of lost samples of each sensor


def repaired(signals: Array, sheet: Sheet) -> Repaired:
    """Fill lost samples: NaN, and short falls to the lower end of a sensor's range.

    Without any reading of the spool, the usual valve's response to the commands takes its place.
    """
    values = np.ascontiguousarray(signals, float)
    result = Repaired(np.empty_like(values), np.empty((len(values), len(SENSORS))))
    repair(values, sheet, *result)
    return result


def bounds_of(config: TaskConfig) -> Floats:
    """For each sensor, (4, 3): range of readings in which it is judged, and number of equal readings of a stuck one.

    At an end of its range a working sensor repeats itself as well. A sensor with noise below one acquisition step is
    not judged.
    """
    shortest = max(FEWEST, round(SHORTEST / config.control_period))
    rows = []
    for name in SENSORS:
        sensor = getattr(config.sensors, name)
        judged = config.sensors.enabled and sensor.noise >= sensor.resolution and sensor.noise > 0.0
        step = max(0.5 * sensor.resolution, 1e-6 * (sensor.high - sensor.low))
        rows.append((sensor.low + step, sensor.high - step, shortest if judged else np.inf))
    return np.array(rows, float)


def stuck_sensors(signals: Floats, config: TaskConfig) -> Mask:
    """Whether each sensor of the task is stuck in each window, (N, 4), of signals (N, 5, T) in SI units."""
    stuck = np.empty((len(signals), len(SENSORS)))
    find_stuck(np.ascontiguousarray(signals, float), bounds_of(config), stuck)
    return stuck > 0.0
