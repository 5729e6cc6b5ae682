"""The rig of the figures, its leaks, and its quick stop."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from hydro_env import ConfigurationError, PlantParameters, Trajectory, simulate
from hydro_env.plant.analysis import closed_port_natural_frequency, reachable_range, speed_limits
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.plant.workable import refuse_unworkable
from hydro_env.task.rig import read_rig
from hydro_env.task.sensors import Sensor, Sensors, scaled

Law = Literal["laminar", "throttle"]

LAWS: dict[Law, str] = {"laminar": "laminar leak (10)", "throttle": "throttle in parallel, as on the paper's rig"}
SHORT_LAWS: dict[Law, str] = {"laminar": "Laminar leak", "throttle": "Throttle in parallel"}

SLOWEST = 65.0
"""Hz; an axis that oscillates more slowly gets more time."""

LONGEST_STRETCH = 20.0
"""Longest durations, as a multiple of those for the paper's rig; longer ones would take minutes."""

LONG_STRETCH, LONG_SAMPLE_TIME = 10.0, 1e-3
"""Stretch above which records have a longer sample time (s)."""

SAMPLES_PER_PERIOD = 20
SAMPLE_TIMES = (0.5e-3, 0.25e-3, 0.2e-3, 0.1e-3, 0.05e-3, 0.02e-3)
"""s; the first with enough samples per oscillation is used."""


@dataclass(frozen=True)
class Rig:
    """A plant with the places and commands of its moves; the defaults are those of the paper's rig.

    It holds all choices of :func:`own_rig` for another rig; no figure has its own positions or durations.
    """

    parameters: PlantParameters = field(default_factory=PlantParameters)
    name: str = "the rig of Kovari (2015), Table 1"
    is_paper: bool = True
    start: float = 0.005  # m, where moves begin
    place: float = 0.02  # m, where the axis is linearised
    voltage: float = 4.0  # V, of the moves
    stretch: float = 1.0  # all durations times this: a slow axis gets more time
    sample_time: float = 0.5e-3  # s
    transducer: Sensor = field(default_factory=lambda: Sensors().position)

    @property
    def has_friction(self) -> bool:
        """Whether the rig has dry friction."""
        friction = self.parameters.friction
        return friction.model != "none" and max(friction.coulomb_force, friction.breakaway_force) > 0.0

    def count(self, seconds: float) -> int:
        """Samples of a duration (s)."""
        return round(seconds / self.sample_time)


def own_rig(parameters: PlantParameters, name: str) -> Rig:
    """Places and commands for any rig: moves within 40 % of its reach, durations by its oscillation.

    Raises:
        ConfigurationError: the rig cannot work, or moves too slowly for the figures.
    """
    refuse_unworkable(parameters, name)
    if parameters == PlantParameters():
        return Rig()
    low, high = (float(end) for end in reachable_range(parameters))
    span = high - low
    hertz = closed_port_natural_frequency(parameters, 0.5 * (low + high)) / (2 * math.pi)
    stretch = math.ceil(10.0 * max(1.0, SLOWEST / hertz)) / 10.0
    if stretch > LONGEST_STRETCH:
        load, least = parameters.load, SLOWEST / LONGEST_STRETCH
        moving = load.mass + parameters.cylinder.piston_mass
        raise ConfigurationError(
            f"{name}: load.mass = {load.mass:g} kg: it oscillates on its oil column at {hertz:.2g} Hz; the figures "
            f"need {least:.3g} Hz or more, here at most {moving * (hertz / least) ** 2:.3g} kg with the piston"
        )
    speeds = speed_limits(parameters)
    travel = 0.5 * stretch * max(speeds) / 10.0  # m per V of the longest move
    fitting = next((step for step in SAMPLE_TIMES if step * hertz * SAMPLES_PER_PERIOD <= 1.0), SAMPLE_TIMES[-1])
    fitting = LONG_SAMPLE_TIME if stretch > LONG_STRETCH else fitting
    transducer = Sensors().position
    larger = parameters.cylinder.stroke / (transducer.high - transducer.low)
    return Rig(
        parameters,
        name,
        False,
        start=round(low + 0.35 * span, 4),
        place=round(low + 0.5 * span, 4),
        voltage=max(min(4.0, math.floor(10.0 * 0.4 * span / travel) / 10.0), 0.1),
        stretch=stretch,
        sample_time=fitting,
        transducer=scaled(transducer, larger),
    )


def rig_from(path: Path | None) -> Rig:
    """The paper's rig, or that of a YAML file.

    Raises:
        ConfigurationError: the file is wrong, or the rig cannot work.
    """
    return Rig() if path is None else own_rig(read_rig(path).plant, str(path))


def with_leak(parameters: PlantParameters, flow_lpm: float, law: Law) -> PlantParameters:
    """The plant with a leak of ``flow_lpm`` at 100 bar across the piston, and no other internal leak."""
    return parameters.replace(leakage=leak_past_piston(flow_lpm, "laminar" if law == "laminar" else "orifice"))


def simplified(parameters: PlantParameters, friction: str, underlap: bool) -> PlantParameters:
    """The plant with a friction model (``friction.model``), and with or without the null leakage of its valve."""
    changes: dict[str, dict[str, object]] = {"friction": {"model": friction}}
    if not underlap:
        changes["valve"] = {"underlap": 0.0}
    return parameters.replace(**changes)


def with_friction_share(base: PlantParameters, share: float) -> PlantParameters:
    """The plant with its friction forces times ``share``."""
    if share == 0.0:  # no model accepts zero forces
        return base.replace(friction={"model": "none"})
    forces = ("coulomb_force", "breakaway_force")
    return base.replace(friction={name: share * getattr(base.friction, name) for name in forces})


STOP_DRIVE = 0.15  # s, until the valve is closed; times Rig.stretch
STOP_WATCH = 3.0  # s, after that; times Rig.stretch


def quick_stop(parameters: PlantParameters, rig: Rig) -> Trajectory:
    """Extend from the rig's start, then 0 V. Time 0 of the result is the command to stop.

    On the paper's rig the stop ends near +15 mm, where the pressures in both chambers are nearly equal: little oil
    leaks there, and the oscillation hardly drifts.
    """
    before, after = rig.count(STOP_DRIVE * rig.stretch), rig.count(STOP_WATCH * rig.stretch)
    voltage = np.concatenate([np.full(before, rig.voltage), np.zeros(after)])
    run = simulate(parameters, voltage, rig.sample_time, {"position": rig.start})
    return replace(run, time=run.time - before * rig.sample_time)
