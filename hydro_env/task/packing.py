"""A task as arrays of numbers for compiled code, and the layout of its observations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hydro_env.errors import ConfigurationError
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.configuration import DISTURBANCES, LEAKAGE_SCHEDULES, TaskConfig
from hydro_env.task.record import FIXED_OBSERVATIONS, Settings
from hydro_env.task.reference_signals import Limits

ERROR_INTEGRAL_TIME = 0.5
"""s; time constant with which the observed integral of the error leaks."""

ERROR_INTEGRAL_LIMIT = 0.010
"""m s; where the observed integral saturates."""

Floats = NDArray[np.float64]


def settings_of(config: TaskConfig) -> Floats:
    """The numbers of a task for compiled code, in the order of ``Settings``."""
    period, sensors, leakage = config.control_period, config.sensors, config.leakage
    rise = sensors.pressure_rise_time / math.log(9.0)  # 10–90 % rise of a first-order lag is τ ln 9
    return np.array(
        Settings(
            control_period=period,
            maximum_step=config.maximum_step,
            tolerance=config.tolerance,
            steps=config.steps,
            healthy_share=leakage.healthy_share,
            healthy_low=leakage.healthy_range[0],
            healthy_high=leakage.healthy_range[1],
            faulty_low=leakage.faulty_range[0],
            faulty_high=leakage.faulty_range[1],
            orifice_law=float(leakage.law == "orifice"),
            schedule=LEAKAGE_SCHEDULES.index(leakage.schedule),
            leak_start_low=leakage.start_range[0],
            leak_start_high=leakage.start_range[1],
            initial_low=config.initial_position_range[0],
            initial_high=config.initial_position_range[1],
            sensors_enabled=float(sensors.enabled),
            pressure_decay=math.exp(-period / rise) if rise > 0.0 else 0.0,
            pressure_lag=rise / period,
            velocity_blend=period / (period + sensors.velocity_filter_time),
            integral_time=ERROR_INTEGRAL_TIME,
            integral_limit=ERROR_INTEGRAL_LIMIT,
            tracking_weight=config.reward.tracking,
            error_scale=config.reward.error_scale,
            error_limit=config.reward.error_limit,
            effort_weight=config.reward.effort,
            failure_weight=config.reward.failure,
            end_stop_speed=config.failure.end_stop_speed,
            pressure_rating=config.failure.pressure_rating,
            disturbance=DISTURBANCES.index(config.disturbance.kind),
            force_low=config.disturbance.force_range[0],
            force_high=config.disturbance.force_range[1],
            force_start_low=config.disturbance.start_range[0],
            force_start_high=config.disturbance.start_range[1],
            pulse_duration=config.disturbance.pulse_duration,
            force_frequency_low=config.disturbance.frequency_range[0],
            force_frequency_high=config.disturbance.frequency_range[1],
        ),
        dtype=np.float64,
    )


def observation_layout(config: TaskConfig) -> tuple[tuple[str, ...], tuple[str, ...], Floats, Floats]:
    """Names, units, scales (unit per 1 of the observation) and largest absolute values (in the observation)."""
    half = 0.5 * config.plant.cylinder.stroke
    rows = [("reference", "m", 0.1, 1.5 * half)]
    rows += [(f"reference_preview_{1e3 * t:g}ms", "m", 0.01, 2.0 * half) for t in config.references.preview_times]
    rows += [
        ("position", "m", 0.1, 1.5 * half),
        ("velocity_estimate", "m/s", 0.1, 2.0),
        ("pressure_a", "Pa", 50e5, 400e5),
        ("pressure_b", "Pa", 50e5, 400e5),
        ("spool_position", "1", 1.0, 1.0),
        ("previous_command", "1", 1.0, 1.0),
        ("tracking_error", "m", 0.01, 2.5 * half),
        ("error_integral", "m s", 0.001, ERROR_INTEGRAL_LIMIT),
    ]
    names, units, scale, largest = zip(*rows, strict=True)
    return names, units, np.array(scale), np.array(largest) / np.array(scale)


def draw_table(config: TaskConfig) -> Floats:
    """One row per randomised parameter; a parameter that multiplies another comes before it."""
    pending = dict(config.randomisation)
    order: list[str] = []
    while pending:
        ready = [path for path, d in pending.items() if d.times not in pending or d.times == path]
        if not ready:
            raise ConfigurationError("task: randomisation: 'times' runs in a circle")
        order += ready
        for path in ready:
            del pending[path]
    table = np.zeros((len(order), 7))
    for row, path in enumerate(order):
        d = config.randomisation[path]
        table[row] = (
            PARAMETER_PATHS.index(path),
            d.log_uniform is not None,
            *d.bounds,
            PARAMETER_PATHS.index(d.times) if d.times else -1,
            d.otherwise if d.otherwise is not None else 0.0,
            d.otherwise_probability,
        )
    return table


def limits_of(config: TaskConfig) -> Floats:
    """What shapes references, in the order of ``reference_signals.Limits``."""
    references = config.references
    return np.array(
        Limits(
            references.range_share,
            references.largest_amplitude,
            references.speed_share,
            references.acceleration_limit,
            *references.frequency_range,
            *references.step_range,
        )
    )


def sensor_table(config: TaskConfig) -> Floats:
    """Noise, bias, resolution, low, high of position, both pressures and spool, shape (4, 5)."""
    sensors = config.sensors
    channels = (sensors.position, sensors.pressure_a, sensors.pressure_b, sensors.spool_position)
    return np.array([(s.noise, s.bias, s.resolution, s.low, s.high) for s in channels])


def step_constants(config: TaskConfig) -> Floats:
    """What a step needs besides the arrays of the axes, as one vector: passing many small arrays costs microseconds.

    Settings, durations of the two commands, preview samples, scales and limits of the observation, table of sensors;
    ``task.kernel`` unpacks it.
    """
    _, _, scale, limit = observation_layout(config)
    assert len(scale) == FIXED_OBSERVATIONS + len(config.preview_samples)
    durations = (config.command_latency, config.control_period - config.command_latency)
    parts = (settings_of(config), durations, config.preview_samples, scale, limit, sensor_table(config).ravel())
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])
