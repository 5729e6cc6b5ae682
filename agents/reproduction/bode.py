"""Frequency response from valve command to position at several leaks."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, legend, panel_title, plain
from agents.reproduction.rig import Rig, simplified, with_leak
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.states import STATE_NAMES

LEAKS = (0.01, 0.3, 1.0, 2.0, 4.0)
LOWEST, HIGHEST = 0.01, 200.0
"""Hz; the upper end is higher for an axis that oscillates faster than a third of it."""

BELOW = 0.3
"""Part of the natural frequency at which the gain is compared with that at the resonance."""


def tight_frequency(rig: Rig) -> float:
    """Natural frequency in Hz at the rig's place with a tight seal, without friction."""
    plant = with_leak(simplified(rig.parameters, "none", True), LEAKS[0], "laminar")
    return linearise(plant, position=rig.place).hydraulic_mode.natural_frequency / (2 * math.pi)


def bode_table(rig: Rig) -> pd.DataFrame:
    """Gain (mm/V) and phase (degrees) over frequency; laminar leak, no friction, at the rig's place."""
    parts, highest = [], max(HIGHEST, 3.0 * tight_frequency(rig))
    frequencies = np.geomspace(LOWEST, highest, 400)
    for leak in LEAKS:
        axis = linearise(with_leak(simplified(rig.parameters, "none", True), leak, "laminar"), position=rig.place)
        row = STATE_NAMES.index("position")
        unit = np.eye(len(STATE_NAMES))
        response = np.array(
            [np.linalg.solve(2j * math.pi * hertz * unit - axis.a, axis.b)[row] for hertz in frequencies]
        )
        parts.append(
            pd.DataFrame(
                {
                    "leak_lpm": leak,
                    "frequency_hz": frequencies,
                    "gain_mm_per_v": 1e3 * np.abs(response),
                    "phase_deg": np.degrees(np.unwrap(np.angle(response))),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def decade_ticks(axis: Axis) -> None:
    """Whole decades of a logarithmic axis, written as numbers."""
    axis.set_major_locator(LogLocator(base=10, numticks=6))
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain(value, 1)))
    axis.set_minor_formatter(NullFormatter())


def gain_above_phase(figure: Figure, table: pd.DataFrame, gain_column: str) -> tuple[Axes, Axes]:
    """Two panels with a line per leak: a column of gains, and ``phase_deg``, over ``frequency_hz``."""
    gain, phase = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
    for colour, leak in zip(LEAK_COLOURS, LEAKS, strict=True):
        part = table[table["leak_lpm"] == leak]
        gain.plot(part["frequency_hz"], part[gain_column], color=colour, label=f"{leak:g} l/min")
        phase.plot(part["frequency_hz"], part["phase_deg"], color=colour)
    return gain, phase


def paint_bode(figure: Figure, table: pd.DataFrame) -> None:
    """Gain above phase."""
    gain, phase = gain_above_phase(figure, table, "gain_mm_per_v")
    gain.set(xscale="log", yscale="log", ylabel="gain, mm per V")
    phase.set(xlabel="frequency, Hz", ylabel="phase, degrees", yticks=[0, -90, -180, -270, -360, -450])
    gain.set_xlim(table["frequency_hz"].min(), table["frequency_hz"].max())
    decade_ticks(gain.yaxis)
    decade_ticks(phase.xaxis)
    panel_title(gain, "From valve command to position")
    legend(gain, title="leak at 100 bar", loc="lower left")
    figure.align_ylabels()


def bode_figure(rig: Rig) -> ReproducedFigure:
    """The Bode plots with their words."""
    table, hertz = bode_table(rig), tight_frequency(rig)
    slow = {leak: part["gain_mm_per_v"].iloc[0] for leak, part in table.groupby("leak_lpm")}
    high = table[table["frequency_hz"] > BELOW * hertz]
    lowest = high.loc[high.groupby("leak_lpm")["frequency_hz"].idxmin()].set_index("leak_lpm")["gain_mm_per_v"]
    swing = high[high["frequency_hz"] > 0.7 * hertz]
    peaks = swing.loc[swing.groupby("leak_lpm")["gain_mm_per_v"].idxmax()].set_index("leak_lpm")
    ratio = peaks["gain_mm_per_v"] / lowest
    first, last = LEAKS[0], LEAKS[-1]
    falls = ratio[last] < ratio[first]
    return ReproducedFigure(
        table=table,
        paint=paint_bode,
        height=4.8,
        paper="What a controller meets: the paper speaks of worse controllability, without a frequency response.",
        how=f"Linearised axis holding {1e3 * rig.place:+.0f} mm{' against the spring' if rig.has_spring else ''}; "
        f"laminar leak, valve as assumed, no friction.",
        found=[
            f"At {LOWEST:g} Hz one volt is worth {slow[first]:.3g} mm with the tight seal and {slow[last]:.3g} mm at "
            f"{last:g} l/min: "
            + (
                "the leaking axis is no integrator any more, a constant command holds a constant place."
                if slow[last] < 0.5 * slow[first]
                else "nothing pushes back with the way (no stiff spring), so that the leaking axis stays an integrator."
            ),
            f"The resonance stands at {peaks.loc[first, 'frequency_hz']:.0f} Hz; its peak over the gain at "
            f"{BELOW * hertz:.0f} Hz {'falls' if falls else 'goes'} from {ratio[first]:.2f} to {ratio[last]:.2f}"
            f"{': more damping, as the paper says' if falls else ''}.",
        ],
    )
