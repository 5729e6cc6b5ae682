"""The recorded signals of the rig, with noise and 16-bit steps, and the settling time of an oscillation in them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.signal import butter, hilbert, lfilter, sosfiltfilt

from hydro_env.task.sensors import Sensor
from hydro_env.types import Floats

GRAVITY = 9.81
ACCELEROMETER_RANGE = 3.0 * GRAVITY  # m/s²; Table 1
ACCELEROMETER_VOLTS = 0.440 / GRAVITY  # V per m/s²; Table 1
ACCELEROMETER_BANDWIDTH = 400.0  # Hz; data sheet of the MMA7341L
ACCELEROMETER_NOISE = 350e-6 * GRAVITY  # m/s² per √Hz; data sheet of the MMA7341L
ACQUISITION_STEP = 20.0 / 65536  # V; 16 bit over ±10 V

CONVERTER_NOISE_BANDWIDTH = 0.5 * math.pi
"""Noise bandwidth of a first-order low-pass over its corner frequency."""

SETTLED = 0.1
"""m/s²; the paper calls the axis settled below this (ε_a)."""


def accelerometer_noise() -> float:
    """Standard deviation in m/s² of the accelerometer's noise behind its own low-pass."""
    return ACCELEROMETER_NOISE * math.sqrt(CONVERTER_NOISE_BANDWIDTH * ACCELEROMETER_BANDWIDTH)


def recorded(true: Floats, sensor: Sensor, generator: np.random.Generator) -> Floats:
    """The signal that the acquisition stores: bias (drawn once), noise, range, 16-bit steps; as in the environment."""
    bias = sensor.bias * generator.uniform(-1.0, 1.0)
    value = np.clip(true + bias + sensor.noise * generator.standard_normal(true.shape), sensor.low, sensor.high)
    if sensor.resolution > 0.0:
        value = sensor.low + sensor.resolution * np.round((value - sensor.low) / sensor.resolution)
    return np.clip(value, sensor.low, sensor.high)


def recorded_acceleration(true: Floats, sample_time: float, generator: np.random.Generator) -> Floats:
    """The stored signal of the accelerometer: range, 400 Hz low-pass, noise, 16-bit steps; m/s²."""
    pole = math.exp(-2 * math.pi * ACCELEROMETER_BANDWIDTH * sample_time)
    start = [pole * float(true[0])]
    smooth, _ = lfilter([1 - pole], [1, -pole], np.clip(true, -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE), zi=start)
    coloured = lfilter([math.sqrt(1 - pole**2)], [1, -pole], generator.standard_normal(len(true) + 50))[50:]
    value = np.clip(smooth + accelerometer_noise() * coloured, -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE)
    step = ACQUISITION_STEP / ACCELEROMETER_VOLTS
    stored: Floats = step * np.round(value / step)
    return stored


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


def band_envelope(values: Floats, sample_time: float, frequency: float, width: float = 0.3) -> Floats:
    """Envelope of the part of a noisy signal within ``frequency`` (rad/s) × (1 ± width).

    The signal passes a second-order band-pass forwards and backwards (no delay); the envelope is the magnitude of its
    analytic signal. White noise loses its power outside the band.
    """
    hertz = frequency / (2 * np.pi)
    band: Any = butter(2, [hertz * (1 - width), hertz * (1 + width)], "bandpass", fs=1 / sample_time, output="sos")
    size: Floats = np.abs(hilbert(sosfiltfilt(band, values)))
    return size
