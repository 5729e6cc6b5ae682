"""Stuck sensors: a working sensor has noise and does not repeat one reading for long."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env import TaskConfig
from hydro_env.compiling import SOURCES, compiled
from hydro_env.task.sensors import SENSORS

SHORTEST, FEWEST = 0.1, 20
"""s, and samples: shortest repetition of one reading that marks a sensor as stuck. With noise of one acquisition step,
the smallest that is judged, 20 equal readings occur by chance once in 10¹¹ samples."""


def _build(sources: int) -> Any:
    def find_stuck(signals, bounds, stuck):
        assert sources >= 0  # keys numba's cache
        for window in range(signals.shape[0]):
            for sensor in range(bounds.shape[0]):
                low, high, shortest = bounds[sensor, 0], bounds[sensor, 1], bounds[sensor, 2]
                values = signals[window, sensor]
                run = 0.0
                stuck[window, sensor] = 0.0
                for k in range(1, signals.shape[2]):
                    run = run + 1.0 if values[k] == values[k - 1] and low < values[k] < high else 0.0
                    if run >= shortest:
                        stuck[window, sensor] = 1.0

    return compiled(find_stuck)


find_stuck = _build(SOURCES)
"""Mark stuck sensors by 1 in ``stuck`` (N, 4); ``bounds`` are those of :func:`bounds_of`."""


def bounds_of(config: TaskConfig) -> NDArray[np.float64]:
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
    return np.array(rows, dtype=np.float64)


def stuck_sensors(signals: NDArray[np.float64], config: TaskConfig) -> NDArray[np.bool_]:
    """Whether each sensor is stuck in each window, (N, 4).

    Args:
        signals: (N, 5, T) in SI units: position, pressures, spool position and command; NaN where a sample is lost.
        config: the task, which describes the sensors.
    """
    stuck = np.empty((len(signals), len(SENSORS)))
    find_stuck(np.ascontiguousarray(signals, dtype=np.float64), bounds_of(config), stuck)
    return stuck > 0.0
