"""The paper's rig, its leaks, and its quick stop."""

from dataclasses import replace
from typing import Literal

import numpy as np

from hydro_env import PlantParameters, Trajectory, simulate
from hydro_env.plant.parts.leakage import leak_past_piston

Law = Literal["laminar", "throttle"]

LAWS: dict[Law, str] = {"laminar": "Laminar leak", "throttle": "Throttle in parallel"}
"""A laminar leak is equation (10); the rig of the paper has a throttle in parallel."""

TIGHT, MODERATE, SEVERE = 0.01, 1.0, 4.0
"""Leaks in l/min at 100 bar: a new seal; the bound between moderate and severe; the largest leak of the task."""

LEAKS = (0.01, 0.3, 1.0, 2.0, 4.0)
FEW_LEAKS = (0.01, 0.3, 1.0, 4.0)  # leaks of the lines of a figure
PLANT = PlantParameters()
START = 0.005  # m, where moves begin
PLACE = 0.02  # m, where the axis is linearised
VOLTAGE = 4.0  # V, of the moves
SAMPLE_TIME = 0.5e-3  # s
STOP_DRIVE, STOP_WATCH = 0.15, 3.0  # s, until the valve is closed, and after that


def flow(leak: float) -> str:
    """A leak with its unit."""
    return f"{leak:g} l/min"


def count(seconds: float) -> int:
    """Samples of a duration."""
    return round(seconds / SAMPLE_TIME)


def with_leak(parameters: PlantParameters, flow_lpm: float, law: Law) -> PlantParameters:
    """The plant with a leak of ``flow_lpm`` at 100 bar across the piston, and no other internal leak."""
    return parameters.replace(leakage=leak_past_piston(flow_lpm, "laminar" if law == "laminar" else "orifice"))


def simplified(parameters: PlantParameters, friction: str, underlap: bool) -> PlantParameters:
    """The plant with a friction model (``friction.model``), and with or without the null leakage of its valve."""
    changes: dict[str, dict[str, object]] = {"friction": {"model": friction}}
    if not underlap:
        changes["valve"] = {"underlap": 0.0}
    return parameters.replace(**changes)


def quick_stop(parameters: PlantParameters) -> Trajectory:
    """Extend from the start, then 0 V. Time 0 of the result is the command to stop.

    The stop ends near +15 mm, where the pressures in both chambers are nearly equal: little oil leaks there, and the
    oscillation hardly drifts.
    """
    voltage = np.repeat([VOLTAGE, 0.0], [count(STOP_DRIVE), count(STOP_WATCH)])
    run = simulate(parameters, voltage, SAMPLE_TIME, {"position": START})
    return replace(run, time=run.time - count(STOP_DRIVE) * SAMPLE_TIME)
