"""Fig. 12 as the paper's rig would do it under its position controller: the same start–stop moves, loop closed."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agents.controllers.sampled_loop import CONTROL_PERIOD
from agents.reproduction.closed_loop import GAIN_MARGIN, INNER, TIGHT, TIMING, closed_loop_run, sensible_gain
from agents.reproduction.displacement import HELD, LEAKS, MOVES
from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import Rig, with_leak
from hydro_env.plant.analysis import speed_limits

SETTLE_FIRST = 1.0
"""s; the loop comes to rest before the record begins. Times Rig.stretch, like all times here."""

LITTLE = 1.2
"""Largest error with the largest leak over that with a tight seal, up to which the moves hardly show the leak."""

NOTABLE = 0.05
"""Change, in parts of the largest error when tight, from which on it is worth a word."""

JUDGED = 0.1
"""s at the end of each stop over which the error that is left is taken."""


def start_stop_reference(rig: Rig) -> NDArray[np.float64]:
    """Set positions in m, one per control period: ramps at the speed that the open-loop command asks for, and stops."""
    limits = speed_limits(rig.parameters)
    speed = rig.voltage / 10.0 * min(limits)
    positions, place = [np.full(_periods(rig, SETTLE_FIRST + HELD), rig.start)], rig.start
    for duration, share in MOVES:
        steps = np.arange(1, _periods(rig, duration) + 1)
        way = place + share * speed * CONTROL_PERIOD * steps
        positions.append(way)
        place = float(way[-1])
    return np.concatenate(positions)


def _periods(rig: Rig, duration: float) -> int:
    return round(rig.stretch * duration / CONTROL_PERIOD)


def closed_moves_table(rig: Rig) -> pd.DataFrame:
    """Reference, position and error in mm and command (1 = 10 V) by leak; throttle in parallel.

    One row per control period.
    """
    reference, gain, parts = start_stop_reference(rig), sensible_gain(rig), []
    for leak in LEAKS:
        run = closed_loop_run(with_leak(rig.parameters, leak, "throttle"), reference, gain, rig.start)
        skipped = _periods(rig, SETTLE_FIRST) * CONTROL_PERIOD
        seen = run[run["time_s"] >= skipped - 1e-9].iloc[:: round(CONTROL_PERIOD / INNER)]  # as the controller sees it
        parts.append(
            pd.DataFrame(
                {
                    "leak_lpm": leak,
                    "time_s": seen["time_s"] - skipped,
                    "reference_mm": 1e3 * seen["reference_m"],
                    "position_mm": 1e3 * seen["position_m"],
                    "error_mm": 1e3 * (seen["reference_m"] - seen["position_m"]),
                    "command": seen["command"],
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def told_by(table: pd.DataFrame, rig: Rig) -> pd.DataFrame:
    """Per leak: largest error; error left, ripple of the position and command at the end of the first stop; in mm."""
    end = rig.stretch * (HELD + MOVES[0][0] + MOVES[1][0])
    rows = []
    for leak, part in table.groupby("leak_lpm"):
        late = part[(part["time_s"] > end - JUDGED * rig.stretch) & (part["time_s"] < end)]
        rows.append(
            {
                "leak_lpm": leak,
                "largest_mm": float(part["error_mm"].abs().max()),
                "left_mm": float(late["error_mm"].mean()),
                "ripple_mm": float(np.ptp(late["position_mm"])),
                "command": float(late["command"].mean()),
                "largest_command": float(part["command"].abs().max()),
            }
        )
    return pd.DataFrame(rows).set_index("leak_lpm")


def paint_closed_moves(figure: Figure, table: pd.DataFrame) -> None:
    """Position with the reference, the error, the command."""
    whole, error, command = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])
    for colour, leak in zip(LEAK_COLOURS, LEAKS, strict=True):
        part = table[table["leak_lpm"] == leak]
        whole.plot(part["time_s"], part["position_mm"], color=colour, linewidth=1.2, label=f"{leak:g} l/min")
        error.plot(part["time_s"], part["error_mm"], color=colour, linewidth=1.0)
        command.plot(part["time_s"], 10.0 * part["command"], color=colour, linewidth=1.0)
    part = table[table["leak_lpm"] == LEAKS[0]]
    whole.plot(
        part["time_s"], part["reference_mm"], color="black", linewidth=1.0, linestyle=(0, (4, 2)), label="reference"
    )
    whole.set_ylabel("position, mm")
    error.set_ylabel("error, mm")
    command.set(ylabel="command, V", xlabel="time, s", xlim=(0.0, float(part["time_s"].max())))
    for axes in (error, command):
        axes.axhline(0.0, color="#6b6b6b", linewidth=0.7)
    panel_title(whole, "The same start–stop moves, loop closed")
    panel_title(error, "Reference minus position")
    panel_title(command, "Valve command")
    legend(whole, title="leak at 100 bar", loc="upper right")
    figure.align_ylabels()


def closed_moves_figure(rig: Rig) -> ReproducedFigure:
    """The moves in a closed loop with their words."""
    table = closed_moves_table(rig)
    told = told_by(table, rig)
    first, last = told.iloc[0], told.iloc[-1]
    ratio = last["largest_mm"] / first["largest_mm"]
    differs = []
    if ratio < LITTLE:
        stays = abs(last["left_mm"] - first["left_mm"]) > NOTABLE * first["largest_mm"]
        differs.append(
            f"Behind a closed loop the slowing of Fig. 12 "
            f"{'hardly shows' if ratio > 1.0 + NOTABLE else 'does not show'} in the moves: the largest error is "
            f"{first['largest_mm']:.2f} mm when tight and {last['largest_mm']:.2f} mm at {LEAKS[-1]:g} l/min. "
            + (
                f"What the leak changes is the error that is left at rest, {first['left_mm']:+.2f} and "
                f"{last['left_mm']:+.2f} mm, and the command."
                if stays
                else "Feedback hides the leak from the position; it is seen in the command."
            )
        )
    gain = sensible_gain(rig)
    return ReproducedFigure(
        table=table,
        paint=paint_closed_moves,
        height=6.2,
        equations="(1)–(3), (8)–(14), (17)",
        paper="Fig. 12 does not say whether the recorded moves were made under the position controller of the PC. If "
        "so, the controller takes part in what is seen.",
        how=f"Nonlinear plant{' with its friction' if rig.has_friction else ''}, a throttle between the chambers; "
        f"proportional controller with "
        f"{gain:.4g} per metre (1 = 10 V), the largest gain that is stable over the reach with a tight seal "
        f"({TIGHT:g} l/min) divided by {GAIN_MARGIN:g}; {TIMING}, position without noise. Ramps at "
        f"{1e3 * rig.voltage / 10 * min(speed_limits(rig.parameters)):.0f} mm/s.",
        found=[
            f"At the end of the first stop {first['left_mm']:+.3f} mm of error are left with the tight seal and "
            f"{last['left_mm']:+.3f} mm at {LEAKS[-1]:g} l/min"
            + (
                f": a proportional controller replaces the leaking oil with a lasting command, "
                f"{10 * first['command']:+.2f} V and {10 * last['command']:+.2f} V."
                if abs(last["command"]) > 1e-3
                else ": nothing leaks there, since no force asks for a pressure difference."
            ),
            f"While moving the error reaches {first['largest_mm']:.2f} mm when tight and {last['largest_mm']:.2f} mm "
            f"at "
            f"{LEAKS[-1]:g} l/min; the command reaches {10 * told['largest_command'].max():.1f} V.",
            f"In the last {JUDGED * rig.stretch:.1f} s of the stop the position still moves by "
            f"{1e3 * first['ripple_mm']:.1f} µm when tight and {1e3 * last['ripple_mm']:.1f} µm at {LEAKS[-1]:g} "
            f"l/min.",
        ],
        differs=differs,
    )
