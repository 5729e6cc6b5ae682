"""How fast a rig is: its delay, its pace, its full speed. They are the units of whatever shall fit any rig."""

from __future__ import annotations

import math

import numpy as np

from hydro_env.plant.parameters import PlantParameters
from hydro_env.task.configuration import TaskConfig


def delay(config: TaskConfig) -> float:
    """Time in s from a sample to the resulting motion: latency, half a control period, valve."""
    valve = config.plant.valve
    lag = {"ideal": 0.0, "spool": 1.0, "drive": 1.0}[valve.model] * 2.0 * valve.damping_ratio / valve.natural_frequency
    coil = valve.coil_inductance / valve.coil_resistance if valve.model == "drive" else 0.0
    return config.command_latency + 0.5 * config.control_period + lag + coil


def pace(config: TaskConfig) -> float:
    """Time in s by which a rig is fast or slow: its delay, or half a period of its oscillation if that is longer."""
    from hydro_env.plant.analysis import closed_port_natural_frequency  # compiled code

    return max(delay(config), math.pi / closed_port_natural_frequency(config.plant))


def full_speed(plant: PlantParameters) -> float:
    """Mean of the speeds in m/s at full opening, extending and retracting, against no force."""
    from hydro_env.plant.analysis import speed_limits  # compiled code

    return float(np.mean(speed_limits(plant)))
