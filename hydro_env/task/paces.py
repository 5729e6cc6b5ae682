"""How fast a rig is: its delay, its pace, its full speed. They are the units of whatever shall fit any rig."""

import math

import numpy as np

from hydro_env.compiling import inline
from hydro_env.errors import ConfigurationError
from hydro_env.plant.parameters import PlantParameters
from hydro_env.task.configuration import TaskConfig
from hydro_env.task.law import RigLaw

STEPS_PER_PACE = 1.54  # steps of the rig in a pace; in the default task (pace 7.7 ms) a step is a control period
SLACK = 2.0  # factor by which drawn speeds leave their interval, because valves have steps; frequencies too


def delay(config: TaskConfig) -> float:
    """Time in s from a sample to the resulting motion: latency, half a control period, valve."""
    valve = config.plant.valve
    lag = {"ideal": 0.0, "spool": 1.0, "drive": 1.0}[valve.model] * 2.0 * valve.damping_ratio / valve.natural_frequency
    coil = valve.coil_inductance / valve.coil_resistance if valve.model == "drive" else 0.0
    return config.command_latency + 0.5 * config.control_period + lag + coil


@inline
def periods_late(latency: float, period: float) -> int:
    """Whole control periods by which a command acts later than in its own one; 0 for a latency of up to one period."""
    return max(math.ceil(latency / period - 1e-9) - 1, 0)


def within_a_period(latency: float, config: TaskConfig, reader: str) -> None:
    """Check that commands act within a control period, as a reader's model has it; ``latency`` in s.

    Raises:
        ConfigurationError: the latency is longer.
    """
    if latency > config.control_period:
        raise ConfigurationError(
            f"command_latency = {latency:g} s: {reader} takes at most one control period, {config.control_period:g} s; "
            "flow linearisation, PID, policies and the estimator take up to five"
        )


def pace(config: TaskConfig) -> float:
    """Time in s by which a rig is fast or slow: its delay, or half a period of its oscillation if that is longer."""
    from hydro_env.plant.analysis import closed_port_natural_frequency  # compiled code

    return max(delay(config), math.pi / closed_port_natural_frequency(config.plant))


def periods_per_step(config: TaskConfig) -> float:
    """Control periods in a step of the rig; 1 in the default task."""
    return round(pace(config) / config.control_period / STEPS_PER_PACE, 9)


def full_speed(plant: PlantParameters) -> float:
    """Mean of the speeds in m/s at full opening, extending and retracting, against no force."""
    from hydro_env.plant.analysis import speed_limits  # compiled code

    return float(np.mean(speed_limits(plant)))


def outside_law(law: RigLaw, config: TaskConfig) -> str:
    """Where a rig lies outside a law, and how far: empty, or nameplates with the law's range."""
    from hydro_env.plant.analysis import closed_port_natural_frequency  # compiled code

    plant = config.plant
    ranges = {
        "bore {} mm": (1e3 * plant.cylinder.bore_diameter, min(law.cylinders), max(law.cylinders)),
        "stroke {} m": (plant.cylinder.stroke, 1e-3 * law.stroke_per_bore[0] * min(law.cylinders), law.longest_stroke),
        "supply {} bar": (1e-5 * plant.supply.pressure, min(law.supplies), max(law.supplies)),
        "full speed {} m/s": (full_speed(plant), law.full_speed[0] / SLACK, law.full_speed[1] * SLACK),
        "natural frequency {} Hz": (
            closed_port_natural_frequency(plant) / (2.0 * math.pi),
            law.natural_frequency[0] / SLACK,
            math.inf,  # the law makes a heavy load lighter
        ),
        "valve {} Hz": (plant.valve.natural_frequency / (2.0 * math.pi), *law.bandwidth),
        "period {} ms": (1e3 * config.control_period, min(law.periods), max(law.periods)),
        "latency {} ms": (1e3 * config.command_latency, *law.latency),
    }
    parts = [
        f"{name.format(f'{value:.3g}')} ({least:.3g} to {most:.3g})"
        for name, (value, least, most) in ranges.items()
        if not 0.99 * least <= value <= 1.01 * most
    ]
    return ", ".join(parts)
