"""The recorded signals of the rig, with noise and 16-bit steps, and the settling time of an oscillation in them."""

from __future__ import annotations

import numpy as np

from hydro_env.task.sensors import Sensor
from hydro_env.types import Floats

SETTLED = 0.1  # m/s²; the paper calls the axis settled below this (ε_a)


def recorded(true: Floats, sensor: Sensor, generator: np.random.Generator) -> Floats:
    """The signal that the acquisition stores: bias (drawn once), noise, range, 16-bit steps; as in the environment."""
    bias = sensor.bias * generator.uniform(-1.0, 1.0)
    value = np.clip(true + bias + sensor.noise * generator.standard_normal(true.shape), sensor.low, sensor.high)
    if sensor.resolution > 0.0:
        value = sensor.low + sensor.resolution * np.round((value - sensor.low) / sensor.resolution)
    return np.clip(value, sensor.low, sensor.high)


def drift(values: Floats, sample_time: float, frequency: float) -> Floats:
    """The drift: the mean over one period of the oscillation (``frequency`` in rad/s)."""
    width = max(round(2 * np.pi / frequency / sample_time), 1)
    before = width // 2
    padded = np.pad(values, (before, width - 1 - before), mode="edge")
    sums = np.cumsum(np.concatenate([[0.0], padded]))
    mean: Floats = (sums[width:] - sums[:-width]) / width
    return mean


def swing_envelope(time: Floats, values: Floats, frequency: float) -> Floats:
    """Envelope of the oscillation in ``values`` at about ``frequency`` (rad/s), without the drift.

    The logarithm of |values| is interpolated between its peaks; after the last peak the envelope is constant.
    """
    size = np.abs(values - drift(values, float(time[1] - time[0]), frequency))
    peaks = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])) + 1
    if len(peaks) == 0:
        return size
    outline: Floats = np.exp(np.interp(time, time[peaks], np.log(size[peaks] + 1e-12)))
    return outline


def last_above(time: Floats, values: Floats, level: float = SETTLED) -> float:
    """Last time at which ``values`` exceeds ``level``; 0 if it never does."""
    above = np.flatnonzero(values > level)
    return float(time[above[-1]]) if len(above) else 0.0
