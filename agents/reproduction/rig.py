"""The rig of the paper for these figures: its leaks, its start–stop commands, the signals it would record."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hydro_env import PlantParameters, Trajectory, resistance_from_flow, simulate
from hydro_env.plant.equations import smooth_root
from hydro_env.plant.parameters import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE
from hydro_env.task.configuration import Sensor

Array = NDArray[np.float64]
Law = Literal["laminar", "throttle"]

LAWS: dict[Law, str] = {"laminar": "laminar leak (10)", "throttle": "throttle in parallel, as on the rig"}

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


def with_leak(parameters: PlantParameters, flow_lpm: float, law: Law) -> PlantParameters:
    """The plant with a leak of ``flow_lpm`` at 100 bar across the piston, and no other internal leak."""
    if law == "laminar":
        return parameters.replace(leakage={"internal_resistance": resistance_from_flow(flow_lpm), "orifice_gain": 0.0})
    root = smooth_root(LEAKAGE_TEST_PRESSURE, parameters.valve.transition_pressure**2)
    gain = flow_lpm * LITRE_PER_MINUTE / root
    return parameters.replace(leakage={"internal_resistance": math.inf, "orifice_gain": gain})


def simplified(parameters: PlantParameters, friction: bool, underlap: bool) -> PlantParameters:
    """The plant with or without its friction, and with or without the null leakage of its valve."""
    changes: dict[str, dict[str, object]] = {}
    if not friction:
        changes["friction"] = {"model": "none"}
    if not underlap:
        changes["valve"] = {"underlap": 0.0}
    return parameters.replace(**changes) if changes else parameters


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


SAMPLE_TIME = 0.5e-3
"""s; all of these figures are sampled so."""

STOP_START = 0.005  # m, where the axis holds before a quick stop
STOP_VOLTAGE = 4.0  # V, extending
STOP_DRIVE = 0.15  # s, until the valve is closed
STOP_WATCH = 3.0  # s, after that


def quick_stop(parameters: PlantParameters) -> Trajectory:
    """Extend at 4 V for 0.15 s from +5 mm, then 0 V. Time 0 of the result is the command to stop.

    It ends near +15 mm, where the spring asks for nearly equal pressures in both chambers: little oil leaks then, so
    that the oscillation stands almost alone.
    """
    before, after = round(STOP_DRIVE / SAMPLE_TIME), round(STOP_WATCH / SAMPLE_TIME)
    voltage = np.concatenate([np.full(before, STOP_VOLTAGE), np.zeros(after)])
    run = simulate(parameters, voltage, SAMPLE_TIME, {"position": STOP_START})
    return replace(run, time=run.time - STOP_DRIVE)
