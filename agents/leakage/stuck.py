"""Sensors that stand still: the noise of a working one does not let it repeat one reading for long."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_env import TaskConfig
from hydro_env.task.sensors import CHANNELS

SHORTEST, FEWEST = 0.1, 20
"""s, and samples: for so long at least a stuck sensor repeats its reading. With noise of one step of the acquisition,
the smallest that counts, 20 equal readings come up by chance once in 10¹¹ samples."""


def run_lengths(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Length of the run of true values that ends at each place of the last axis."""
    places = np.arange(1, mask.shape[-1] + 1)
    lengths: NDArray[np.int64] = places - np.maximum.accumulate(np.where(mask, 0, places), axis=-1)
    return lengths


def stuck_sensors(signals: NDArray[np.float64], config: TaskConfig) -> NDArray[np.bool_]:
    """Which sensors stand still in which windows, (N, 4).

    Readings at an end of a sensor's range do not count: there a working sensor repeats itself, too. A sensor whose
    noise is below a step of its acquisition is not judged.

    Args:
        signals: (N, 5, T) in SI units: position, pressures, spool position and command; NaN where a sample is lost.
        config: the task, which describes the sensors.
    """
    shortest = max(FEWEST, round(SHORTEST / config.control_period))
    stuck = np.zeros((len(signals), len(CHANNELS)), dtype=np.bool_)
    for number, name in enumerate(CHANNELS):
        sensor = getattr(config.sensors, name)
        if not config.sensors.enabled or sensor.noise < sensor.resolution or sensor.noise == 0.0:
            continue
        values, step = signals[:, number], max(0.5 * sensor.resolution, 1e-6 * (sensor.high - sensor.low))
        same = np.diff(values, axis=1) == 0.0
        same &= (values[:, 1:] > sensor.low + step) & (values[:, 1:] < sensor.high - step)
        for window in np.flatnonzero(same.sum(axis=1) >= shortest):
            stuck[window, number] = run_lengths(same[window]).max() >= shortest
    return stuck
