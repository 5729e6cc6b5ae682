"""Sensors that stand still: the noise of a working one does not let it repeat one reading for long."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env import TaskConfig
from hydro_env.compiling import SOURCES, compiled
from hydro_env.task.sensors import CHANNELS

SHORTEST, FEWEST = 0.1, 20
"""s, and samples: for so long at least a stuck sensor repeats its reading. With noise of one step of the acquisition,
the smallest that counts, 20 equal readings come up by chance once in 10¹¹ samples."""


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
"""Mark by 1 which sensors stand still, in ``stuck`` (N, 4); ``bounds`` as :func:`bounds_of` gives them."""


def bounds_of(config: TaskConfig) -> NDArray[np.float64]:
    """Of each sensor, (4, 3): the readings between which it is judged, and how often a stuck one repeats its reading.

    At an end of its range a working sensor repeats itself, too. A sensor whose noise is below a step of its acquisition
    is not judged.
    """
    shortest = max(FEWEST, round(SHORTEST / config.control_period))
    rows = []
    for name in CHANNELS:
        sensor = getattr(config.sensors, name)
        judged = config.sensors.enabled and sensor.noise >= sensor.resolution and sensor.noise > 0.0
        step = max(0.5 * sensor.resolution, 1e-6 * (sensor.high - sensor.low))
        rows.append((sensor.low + step, sensor.high - step, shortest if judged else np.inf))
    return np.array(rows, dtype=np.float64)


def stuck_sensors(signals: NDArray[np.float64], config: TaskConfig) -> NDArray[np.bool_]:
    """Which sensors stand still in which windows, (N, 4).

    Args:
        signals: (N, 5, T) in SI units: position, pressures, spool position and command; NaN where a sample is lost.
        config: the task, which describes the sensors.
    """
    stuck = np.empty((len(signals), len(CHANNELS)))
    find_stuck(np.ascontiguousarray(signals, dtype=np.float64), bounds_of(config), stuck)
    return stuck > 0.0
