"""Costs of a leak at rest and in motion: the error of P, PI and PID while holding, and the power of the supply."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from hydro_agents.controllers.sampled_loop import CONTROL_PERIOD
from hydro_agents.report.leaks import LEVELS, SEVERE
from hydro_env import HydroError, PlantParameters, equilibrium, simulate
from hydro_env.units import FULL_VOLTAGE
from paper.closed_loop import closed_loop_run
from paper.rig import LAWS, Rig, with_leak

DURATION = 6.0  # s
JUDGED = 0.5  # s at the end
SMALLEST_ERROR = 1e-3  # mm; a smaller error counts as zero

CYCLE = ((0.25, 1.0), (0.25, None), (0.25, -1.0), (0.25, None))
"""s (times Rig.stretch) and fraction of Rig.voltage; None holds the initial position."""


@dataclass(frozen=True)
class Gains:
    """In V per m, V per m s, V s per m."""

    proportional: float
    integral: float = 0.0
    derivative: float = 0.0


def controllers(rig: Rig) -> dict[str, Gains]:
    """Gains of P, PI and PID; on the paper's rig the proportional one is that of the project's PID (20 per metre)."""
    gain = FULL_VOLTAGE * rig.holding_gain
    return {"P": Gains(gain), "PI": Gains(gain, 2.0 * gain), "PID": Gains(gain, 2.0 * gain, CONTROL_PERIOD * gain)}


def held_error(plant: PlantParameters, gains: Gains, target: float) -> tuple[float, float]:
    """Mean error (m) and mean command (V) at the end of a hold that begins in equilibrium at the target with u = 0.

    The position has no noise; the command is computed every 5 ms and acts without latency. The integral stops while the
    command is at its limit.
    """
    integral, before = 0.0, target

    def control(reference: float, position: float) -> float:
        nonlocal integral, before
        error = reference - position
        wanted = gains.proportional * error + integral - gains.derivative * (position - before) / CONTROL_PERIOD
        if abs(wanted) <= FULL_VOLTAGE:
            integral += gains.integral * CONTROL_PERIOD * error
        before = position
        return float(np.clip(wanted / FULL_VOLTAGE, -1.0, 1.0))

    reference = np.full(round(DURATION / CONTROL_PERIOD), target)
    run = closed_loop_run(plant, reference, control, target, latency=0.0, sample_time=CONTROL_PERIOD)
    end = run.iloc[:-1].tail(round(JUDGED / CONTROL_PERIOD))
    return float((end["reference_m"] - end["position_m"]).mean()), FULL_VOLTAGE * float(end["command"].mean())


def holding_table(rig: Rig, leaks: tuple[float, ...] = LEVELS) -> pd.DataFrame:
    """Error in mm and command in V of each controller and leak, for the assumed rig with a throttle in parallel.

    Raises:
        HydroError: the axis holds without a pressure difference, so that nothing leaks.
    """
    _, voltage = equilibrium(with_leak(rig.parameters, SEVERE, "throttle"), rig.hold)
    if 1e3 * abs(voltage) < SMALLEST_ERROR * FULL_VOLTAGE * rig.holding_gain:
        raise HydroError("no force needs a pressure difference while the axis holds, so that no oil leaks")
    rows = []
    for leak in leaks:
        plant = with_leak(rig.parameters, leak, "throttle")
        for name, gains in controllers(rig).items():
            error, command = held_error(plant, gains, rig.hold)
            rows.append({"leak_lpm": leak, "controller": name, "error_mm": 1e3 * error, "command_v": command})
    return pd.DataFrame(rows)


def held_places(rig: Rig) -> dict[str, float]:
    """Two places to hold, m: mid-stroke on the paper's rig and the start elsewhere, and the rig's place to hold."""
    return {"first": 0.0 if rig.is_paper else rig.start, "second": rig.hold}


def holding_power(plant: PlantParameters, position: float, sample_time: float) -> float:
    """Power in W drawn at port P while a position (m) is held."""
    _, voltage = equilibrium(plant, position)
    run = simulate(plant, [voltage], sample_time, {"position": position})
    return float(run.supply_pressure[0] * run.supply_flow[0])


def cycle_energy(plant: PlantParameters, rig: Rig) -> float:
    """Energy in J drawn at port P in one start–stop cycle."""
    _, holding = equilibrium(plant, rig.start)
    volts = [(seconds, holding if share is None else share * rig.voltage) for seconds, share in CYCLE]
    voltage = np.concatenate([np.full(rig.count(rig.stretch * seconds), value) for seconds, value in volts])
    run = simulate(plant, voltage, rig.sample_time, {"position": rig.start})
    return float(np.trapezoid(run.supply_pressure * run.supply_flow, run.time))


def energy_table(rig: Rig) -> pd.DataFrame:
    """Power (W) drawn at port P while holding two places, energy (J) of one start–stop cycle, by law and leak."""
    rows = []
    for law in LAWS:
        for leak in LEVELS:
            plant = with_leak(rig.parameters, leak, law)
            row: dict[str, float | str] = {"law": law, "leak_lpm": leak}
            for name, position in held_places(rig).items():
                row[f"{name}_place_mm"] = 1e3 * position
                row[f"holding_{name}_w"] = holding_power(plant, position, rig.sample_time)
            row["cycle_j"] = cycle_energy(plant, rig)
            rows.append(row)
    return pd.DataFrame(rows)
