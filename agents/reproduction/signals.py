"""The signals that the rig would record: its position transducer and its accelerometer, with noise and 16-bit steps."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hydro_env.task.configuration import Sensor

Array = NDArray[np.float64]

GRAVITY = 9.81
ACCELEROMETER_RANGE = 3.0 * GRAVITY  # m/s²; Table 1
ACCELEROMETER_VOLTS = 0.440 / GRAVITY  # V per m/s²; Table 1
ACCELEROMETER_BANDWIDTH = 400.0  # Hz; data sheet of the MMA7341L
ACCELEROMETER_NOISE = 350e-6 * GRAVITY  # m/s² per √Hz; data sheet of the MMA7341L
ACQUISITION_STEP = 20.0 / 65536  # V; 16 bit over ±10 V

CONVERTER_NOISE_BANDWIDTH = 0.5 * math.pi
"""Noise bandwidth of a first-order low-pass over its corner frequency."""


def accelerometer_noise() -> float:
    """Standard deviation in m/s² of the accelerometer's noise behind its own low-pass."""
    return ACCELEROMETER_NOISE * math.sqrt(CONVERTER_NOISE_BANDWIDTH * ACCELEROMETER_BANDWIDTH)


def recorded(true: Array, sensor: Sensor, generator: np.random.Generator) -> Array:
    """What the acquisition stores: bias (drawn once), noise, range, 16-bit steps; as in the environment."""
    bias = sensor.bias * generator.uniform(-1.0, 1.0)
    value = np.clip(true + bias + sensor.noise * generator.standard_normal(true.shape), sensor.low, sensor.high)
    if sensor.resolution > 0.0:
        value = sensor.low + sensor.resolution * np.round((value - sensor.low) / sensor.resolution)
    return np.clip(value, sensor.low, sensor.high)


def recorded_acceleration(true: Array, sample_time: float, generator: np.random.Generator) -> Array:
    """What the acquisition stores of the accelerometer: range, 400 Hz low-pass, noise, 16-bit steps; m/s²."""
    pole = math.exp(-2 * math.pi * ACCELEROMETER_BANDWIDTH * sample_time)
    start = [pole * float(true[0])]
    smooth, _ = lfilter([1 - pole], [1, -pole], np.clip(true, -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE), zi=start)
    coloured = lfilter([math.sqrt(1 - pole**2)], [1, -pole], generator.standard_normal(len(true) + 50))[50:]
    value = np.clip(smooth + accelerometer_noise() * coloured, -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE)
    step = ACQUISITION_STEP / ACCELEROMETER_VOLTS
    stored: Array = step * np.round(value / step)
    return stored
