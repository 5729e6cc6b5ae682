"""Holding against the spring: what P, PI and PID leave of the error as the seal wears, and what the supply pays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.controllers.sampled_loop import FULL_COMMAND
from agents.reproduction.drawing import COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import Rig, with_leak
from hydro_env import HydroError, PlantParameters, equilibrium, simulate
from hydro_env.plant.states import STATE_NAMES

LEAKS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
PERIOD = 0.005  # s
DURATION = 6.0  # s
JUDGED = 0.5  # s at the end
LEAST = 1e-3  # mm; errors below are none


@dataclass(frozen=True)
class Gains:
    """In V per m, V per m s, V s per m."""

    proportional: float
    integral: float = 0.0
    derivative: float = 0.0


CONTROLLERS = ("P", "PI", "PID")


def controllers(rig: Rig) -> dict[str, Gains]:
    """Gains of P, PI and PID; on the paper's rig the proportional one is that of the project's PID (20 per metre)."""
    gain = FULL_COMMAND * rig.holding_gain
    return {"P": Gains(gain), "PI": Gains(gain, 2.0 * gain), "PID": Gains(gain, 2.0 * gain, PERIOD * gain)}


def held_error(plant: PlantParameters, gains: Gains, target: float) -> tuple[float, float]:
    """Mean error (m) and mean command (V) at the end of a hold that begins in balance at the target, u = 0.

    The position is read without noise; the command is computed every 5 ms and acts at once.
    """
    state, _ = equilibrium(plant, target)
    integral, before, errors, commands = 0.0, target, [], []
    for _ in range(round(DURATION / PERIOD)):
        position = state["position"]
        error = target - position
        wanted = gains.proportional * error + integral - gains.derivative * (position - before) / PERIOD
        command = float(np.clip(wanted, -10.0, 10.0))
        if command == wanted:
            integral += gains.integral * PERIOD * error
        run = simulate(plant, [command], PERIOD, state)
        state = dict(zip(STATE_NAMES, run.states[-1].tolist(), strict=True))
        before = position
        errors.append(error)
        commands.append(command)
    last = round(JUDGED / PERIOD)
    return float(np.mean(errors[-last:])), float(np.mean(commands[-last:]))


def holding_table(rig: Rig) -> pd.DataFrame:
    """Error in mm and command in V of each controller and leak; the rig as assumed, throttle in parallel.

    Raises:
        HydroError: the axis holds without a pressure difference, so that nothing leaks.
    """
    _, voltage = equilibrium(with_leak(rig.parameters, LEAKS[-1], "throttle"), rig.hold)
    if 1e3 * abs(voltage) < LEAST * FULL_COMMAND * rig.holding_gain:
        raise HydroError("no force asks for a pressure difference while it holds, so that no oil leaks")
    rows = []
    for leak in LEAKS:
        plant = with_leak(rig.parameters, leak, "throttle")
        for name, gains in controllers(rig).items():
            error, command = held_error(plant, gains, rig.hold)
            rows.append({"leak_lpm": leak, "controller": name, "error_mm": 1e3 * error, "command_v": command})
    return pd.DataFrame(rows)


def paint_holding(figure: Figure, table: pd.DataFrame) -> None:
    """Error over leak."""
    axes = figure.subplots()
    for colour, marker, name in zip(COLOURS, "os^", CONTROLLERS, strict=False):
        part = table[table["controller"] == name]
        size = {"P": 7.0, "PI": 7.0, "PID": 4.0}[name]
        axes.plot(part["leak_lpm"], part["error_mm"], color=colour, marker=marker, markersize=size, label=name)
    axes.axhline(0.0, color="#6b6b6b", linewidth=0.7)
    axes.set(xscale="log", xlabel="leak (throttle in parallel), l/min at 100 bar", ylabel="error left, mm")
    axes.set_xticks(LEAKS, [f"{leak:g}" for leak in LEAKS])
    axes.minorticks_off()
    panel_title(axes, "Error that remains while holding")
    legend(axes, loc="best")


def holding_figure(rig: Rig) -> ReproducedFigure:
    """The steady-state errors with their words."""
    table = holding_table(rig)
    error = table.pivot(index="leak_lpm", columns="controller", values="error_mm")
    command = table.pivot(index="leak_lpm", columns="controller", values="command_v")
    gains = controllers(rig)
    worst_integral = error[["PI", "PID"]].abs().max().max()
    return ReproducedFigure(
        table=table,
        paint=paint_holding,
        height=3.6,
        paper="The paper shows moves and stops. A leak also shows while nothing moves: the valve must replace what "
        "leaks.",
        how=f"Holding {1e3 * rig.hold:+.0f} mm{' against the spring' if rig.has_spring else ''}; the rig as assumed"
        f"{', with friction' if rig.has_friction else ''}; gains {gains['P'].proportional:g} V/m, "
        f"{gains['PI'].integral:g} V/(m s), {gains['PID'].derivative:g} V s/m; position without noise, command every "
        f"5 ms "
        f"without latency; mean over the last {JUDGED:g} s of {DURATION:g} s, from balance.",
        found=[
            f"P leaves {error['P'].iloc[0]:.3g} mm with the tight seal and {error['P'].iloc[-1]:.3g} mm at "
            f"{LEAKS[-1]:g} l/min; with an integral part at most {worst_integral:.3f} mm is left.",
            f"The integral part does not hide the leak, it moves it into the command: PI holds with "
            f"{command['PI'].iloc[0]:.2f} V when tight and {command['PI'].iloc[-1]:.2f} V at {LEAKS[-1]:g} l/min.",
        ],
    )
