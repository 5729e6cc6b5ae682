"""Fig. 12: the displacement that the rig records in start–stop moves, at several leaks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import SAMPLE_TIME, recorded, simplified, with_leak
from hydro_env import PlantParameters, equilibrium, simulate
from hydro_env.task.configuration import Sensors

LEAKS = (0.01, 0.3, 1.0, 2.0, 4.0)
"""l/min at 100 bar."""

COMMANDS = ((0.25, 4.0), (0.45, 0.0), (0.25, 4.0), (0.45, 0.0), (0.5, -4.0), (0.5, 0.0))
"""s and V, after the start is held: two moves out, one move back, a stop after each."""

HELD = 0.1
"""s; so long the start is held first."""

ENLARGED = (0.01, 1.0, 4.0)
"""Leaks of which the stop is drawn enlarged."""

FIRST_STOP = 0.35
"""s; the first command to stop."""

START = 0.005
SEED = 12


def start_stop_voltage(holding: float) -> NDArray[np.float64]:
    """The commands, one per sample, V; first the one that holds the start."""
    commands = ((HELD, holding), *COMMANDS)
    return np.concatenate([np.full(round(duration / SAMPLE_TIME), volts) for duration, volts in commands])


def displacement_table(base: PlantParameters) -> pd.DataFrame:
    """Recorded and true displacement over time for each leak; throttle in parallel, open loop.

    ``friction``: whether the seals rub. Every run sees the same noise and bias, as one transducer would give.
    """
    sensor, parts = Sensors().position, []
    for friction in (True, False):
        for leak in LEAKS:
            plant = with_leak(simplified(base, friction, True), leak, "throttle")
            _, holding = equilibrium(plant, START)
            run = simulate(plant, start_stop_voltage(holding), SAMPLE_TIME, {"position": START})
            signal = recorded(run.position, sensor, np.random.default_rng(SEED))
            parts.append(
                pd.DataFrame(
                    {
                        "friction": friction,
                        "leak_lpm": leak,
                        "time_s": run.time,
                        "command_v": run.voltage,
                        "recorded_position_mm": 1e3 * signal,
                        "true_position_mm": 1e3 * run.position,
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Per friction and leak: length of the first move, drift in the 0.4 s after it, swing of the true position, mm."""
    rows = []
    for (friction, leak), part in table.groupby(["friction", "leak_lpm"]):
        time, true, seen = (part[name].to_numpy() for name in ("time_s", "true_position_mm", "recorded_position_mm"))
        moved = np.interp(FIRST_STOP + 0.03, time, true) - true[0]
        late = (time > FIRST_STOP + 0.40) & (time < FIRST_STOP + 0.44)
        early = (time > FIRST_STOP + 0.04) & (time < FIRST_STOP + 0.09)
        straight = np.polyval(np.polyfit(time[early], true[early], 2), time[early])
        rows.append(
            {
                "friction": friction,
                "leak_lpm": leak,
                "move_mm": moved,
                "drift_mm": float(true[late].mean() - np.interp(FIRST_STOP + 0.03, time, true)),
                "swing_mm": float(np.ptp(true[early] - straight)),
                "noise_mm": float(np.std((seen - true)[time < HELD])),
            }
        )
    return pd.DataFrame(rows)


def paint_displacement(figure: Figure, table: pd.DataFrame) -> None:
    """The whole move, and what follows the first stop, enlarged, with and without friction."""
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.25, 1.0])
    top, bottom = parts
    whole, panels = top.subplots(), bottom.subplots(1, 2, sharey=True)
    for colour, leak in zip(LEAK_COLOURS, LEAKS, strict=True):
        for friction, axes in ((True, panels[0]), (False, panels[1])):
            part = table[(table["leak_lpm"] == leak) & (table["friction"] == friction)]
            time, seen = part["time_s"].to_numpy(), part["recorded_position_mm"].to_numpy()
            if friction:
                whole.plot(time, seen, color=colour, linewidth=1.2, label=f"{leak:g} l/min")
            if leak not in ENLARGED:
                continue
            window = (time >= FIRST_STOP - 0.01) & (time <= FIRST_STOP + 0.15)
            at_stop = seen[(time > FIRST_STOP + 0.02) & (time < FIRST_STOP + 0.05)].mean()
            axes.plot(1e3 * (time[window] - FIRST_STOP), seen[window] - at_stop, color=colour, linewidth=1.0)
    command = table[(table["leak_lpm"] == LEAKS[0]) & table["friction"]]
    moving = np.abs(command["command_v"].to_numpy()) > 3.0
    low, high = whole.get_ylim()
    whole.fill_between(command["time_s"], low, high, where=moving.tolist(), color="#000000", alpha=0.05, linewidth=0)
    whole.set(
        xlabel="time, s", ylabel="recorded position, mm", ylim=(low, high), xlim=(0.0, float(command["time_s"].max()))
    )
    panel_title(whole, "Start–stop moves (grey: valve commanded open, +4 V twice, then −4 V)")
    legend(whole, title="leak at 100 bar", loc="upper left")
    for axes, words in zip(panels, ("with friction", "no friction"), strict=True):
        axes.set(xlabel="time after the first stop command, ms", xlim=(-10, 150), ylim=(-0.55, 0.35))
        panel_title(axes, f"After the first stop, {words}")
    panels[0].set_ylabel("recorded position, mm\n(from the place of the stop)")


def displacement_figure(base: PlantParameters) -> ReproducedFigure:
    """Fig. 12 with its words."""
    table = displacement_table(base)
    told = summary(table)
    with_friction, without = told[told["friction"]], told[~told["friction"]]
    tight, worst = with_friction.iloc[0], with_friction.iloc[-1]
    swing = float(without.iloc[0]["swing_mm"])
    noise = float(told["noise_mm"].mean())
    return ReproducedFigure(
        key="fig12_displacement",
        title="Fig. 12: displacement in start–stop moves",
        table=table,
        paint=paint_displacement,
        height=6.4,
        equations="(1)–(3), (8)–(14), (17)",
        paper="Fig. 12 shows recorded displacements at start–stop; the text reads from it that more leakage slows the "
        "axis and damps it.",
        how=f"Valve commands without feedback, a throttle between the chambers as on the rig. The position goes "
        f"through the transducer as the environment models it: noise {1e3 * Sensors().position.noise:.3f} mm, a "
        f"constant error of at most {1e3 * Sensors().position.bias:.3f} mm, 16-bit steps of "
        f"{1e3 * Sensors().position.resolution:.3f} mm.",
        found=[
            f"More leakage makes the same command move less: {tight['move_mm']:.1f} mm at {tight['leak_lpm']:g} l/min, "
            f"{worst['move_mm']:.1f} mm at {worst['leak_lpm']:g} l/min.",
            f"After the first stop the axis creeps on by {tight['drift_mm']:+.2f} mm in 0.4 s with the tight seal and "
            f"by {worst['drift_mm']:+.2f} mm at {worst['leak_lpm']:g} l/min.",
            f"Without friction the oscillation 0.04 to 0.09 s after the stop is {swing:.2f} mm from peak to peak with "
            f"the tight seal and {float(without.iloc[-1]['swing_mm']):.2f} mm at {worst['leak_lpm']:g} l/min; the "
            f"recorded noise has a standard deviation of {noise:.3f} mm. An accelerometer sees it better, as the paper "
            f"says.",
        ],
        differs=[
            f"With the friction assumed for the rig no swing is left 0.04 s after the stop, whatever the leak "
            f"({float(tight['swing_mm']):.3f} mm with the tight seal, {float(worst['swing_mm']):.3f} mm at "
            f"{worst['leak_lpm']:g} l/min): friction, not leakage, stops it. What the leak changes is the length of "
            f"the move and the creep."
        ],
    )
