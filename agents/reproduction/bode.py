"""Frequency response from valve command to position at several leaks."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import simplified, with_leak
from hydro_env import PlantParameters
from hydro_env.plant.analysis import linearise
from hydro_env.plant.equations import STATE_NAMES

LEAKS = (0.01, 0.3, 1.0, 2.0, 4.0)
FREQUENCIES = np.geomspace(0.01, 200.0, 400)
POSITION = 0.02


def bode_table(base: PlantParameters) -> pd.DataFrame:
    """Gain (mm/V) and phase (degrees) over frequency; laminar leak, null leakage, no friction, holding +20 mm."""
    parts = []
    for leak in LEAKS:
        axis = linearise(with_leak(simplified(base, False, True), leak, "laminar"), position=POSITION)
        row = STATE_NAMES.index("position")
        unit = np.eye(len(STATE_NAMES))
        response = np.array(
            [np.linalg.solve(2j * math.pi * hertz * unit - axis.a, axis.b)[row] for hertz in FREQUENCIES]
        )
        parts.append(
            pd.DataFrame(
                {
                    "leak_lpm": leak,
                    "frequency_hz": FREQUENCIES,
                    "gain_mm_per_v": 1e3 * np.abs(response),
                    "phase_deg": np.degrees(np.unwrap(np.angle(response))),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def paint_bode(figure: Figure, table: pd.DataFrame) -> None:
    """Gain above phase."""
    gain, phase = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
    for colour, leak in zip(LEAK_COLOURS, LEAKS, strict=True):
        part = table[table["leak_lpm"] == leak]
        gain.plot(part["frequency_hz"], part["gain_mm_per_v"], color=colour, label=f"{leak:g} l/min")
        phase.plot(part["frequency_hz"], part["phase_deg"], color=colour)
    gain.set(xscale="log", yscale="log", ylabel="gain, mm per V")
    phase.set(xlabel="frequency, Hz", ylabel="phase, degrees", yticks=[0, -90, -180, -270, -360, -450])
    gain.set_xlim(FREQUENCIES[0], FREQUENCIES[-1])
    gain.set_yticks([1e-4, 1e-2, 1, 100], ["0.0001", "0.01", "1", "100"])
    phase.set_xticks([0.01, 0.1, 1, 10, 100], ["0.01", "0.1", "1", "10", "100"])
    panel_title(gain, "From valve command to position")
    legend(gain, title="leak at 100 bar", loc="lower left")
    figure.align_ylabels()


def bode_figure(base: PlantParameters) -> ReproducedFigure:
    """The Bode plots with their words."""
    table = bode_table(base)
    slow = {leak: part.iloc[0] for leak, part in table.groupby("leak_lpm")}
    high = table[table["frequency_hz"] > 20.0]
    peaks = high.loc[high.groupby("leak_lpm")["gain_mm_per_v"].idxmax()].set_index("leak_lpm")
    base_line = table[(table["frequency_hz"] - 20.0).abs() == (table["frequency_hz"] - 20.0).abs().min()].set_index(
        "leak_lpm"
    )
    first, last = LEAKS[0], LEAKS[-1]
    ratio = {leak: peaks.loc[leak, "gain_mm_per_v"] / base_line.loc[leak, "gain_mm_per_v"] for leak in (first, last)}
    return ReproducedFigure(
        key="bode_position",
        title="Further: frequency response at several leaks",
        table=table,
        paint=paint_bode,
        height=4.8,
        paper="What a controller meets: the paper speaks of worse controllability, without a frequency response.",
        how=f"Linearised axis holding {1e3 * POSITION:+.0f} mm against the spring; laminar leak, null leakage, no "
        f"friction.",
        found=[
            f"At {FREQUENCIES[0]:g} Hz one volt is worth {slow[first]['gain_mm_per_v']:.0f} mm with the tight seal and "
            f"{slow[last]['gain_mm_per_v']:.1f} mm at {last:g} l/min: against the spring the leaking axis is no "
            f"integrator any more, a constant command holds a constant place.",
            f"The resonance stands at {peaks.loc[first, 'frequency_hz']:.0f} Hz; its peak over the gain at 20 Hz falls "
            f"from {ratio[first]:.2f} to {ratio[last]:.2f}: more damping, as the paper says.",
        ],
    )
