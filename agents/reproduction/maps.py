"""Natural frequency and damping of the axis over stroke and leakage."""

from __future__ import annotations

import math

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import ReproducedFigure, panel_title
from agents.reproduction.rig import simplified, with_leak
from hydro_env import PlantParameters
from hydro_env.plant.analysis import linearise

POSITIONS = np.linspace(-0.19, 0.19, 21)
LEAKS = np.geomspace(0.01, 4.0, 17)


def map_table(base: PlantParameters) -> pd.DataFrame:
    """Natural frequency (Hz) and damping ratio at rest; laminar leak, no friction, no spring, with null leakage.

    Without the spring the whole stroke can be held. NaN where the linearised axis does not oscillate.
    """
    plain = simplified(base, False, True).replace(load={"spring_stiffness": 0.0})
    rows = []
    for leak in LEAKS:
        plant = with_leak(plain, float(leak), "laminar")
        for position in POSITIONS:
            frequency = damping = math.nan
            try:
                mode = linearise(plant, position=float(position)).hydraulic_mode
                frequency, damping = mode.natural_frequency / (2 * math.pi), mode.damping_ratio
            except ArithmeticError:
                pass
            rows.append(
                {
                    "position_mm": 1e3 * position,
                    "leak_lpm": leak,
                    "natural_frequency_hz": frequency,
                    "damping_ratio": damping,
                }
            )
    return pd.DataFrame(rows)


LEVELS = {
    "natural_frequency_hz": (65.0, 70.0, 80.0, 90.0, 100.0, 120.0),
    "damping_ratio": (0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2),
}


def paint_maps(figure: Figure, table: pd.DataFrame) -> None:
    """Two maps with labelled contours."""
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (column, levels), title, colours in zip(
        panels, LEVELS.items(), ("Natural frequency, Hz", "Damping ratio"), ("Blues", "Oranges"), strict=True
    ):
        grid = table.pivot(index="leak_lpm", columns="position_mm", values=column)
        values = grid.to_numpy()
        axes.grid(visible=False)
        shades = matplotlib.colormaps[colours](np.linspace(0.0, 0.6, len(levels) + 1))
        axes.contourf(grid.columns, grid.index, values, levels=levels, colors=shades, extend="both")
        lines = axes.contour(grid.columns, grid.index, values, levels=levels, colors="#222222", linewidths=0.8)
        axes.clabel(lines, fontsize=8, fmt="%g")
        axes.set(yscale="log", xlabel="position, mm (0 = mid-stroke, + = extending)")
        axes.set_yticks([0.01, 0.1, 1, 4], ["0.01", "0.1", "1", "4"])
        axes.minorticks_off()
        panel_title(axes, title)
    panels[0].set_ylabel("leak, l/min at 100 bar")


def map_figure(base: PlantParameters) -> ReproducedFigure:
    """The maps with their words."""
    table = map_table(base)
    rows = table.set_index(["leak_lpm", "position_mm"]).sort_index()
    tight, worst = rows.loc[LEAKS[0]], rows.loc[LEAKS[-1]]
    slowest = tight["natural_frequency_hz"].idxmin()
    middle = POSITIONS[len(POSITIONS) // 2] * 1e3
    return ReproducedFigure(
        key="maps_frequency_damping",
        title="Further: natural frequency and damping over the stroke",
        table=table,
        paint=paint_maps,
        height=3.6,
        paper="The paper damps one stop at one place. How much a leak changes depends on where the piston stands.",
        how="Eigenvalues of the linearised axis at rest; laminar leak, valve with null leakage, no friction, and no "
        "spring, so that the whole stroke can be held.",
        found=[
            f"With a tight seal the natural frequency is lowest, {tight['natural_frequency_hz'].min():.0f} Hz, at "
            f"{slowest:.0f} mm, and rises to {tight['natural_frequency_hz'].max():.0f} Hz near the ends.",
            f"At mid-stroke the damping ratio grows from {tight.loc[middle, 'damping_ratio']:.3f} at {LEAKS[0]:g} "
            f"l/min to {worst.loc[middle, 'damping_ratio']:.3f} at {LEAKS[-1]:g} l/min.",
            f"At {LEAKS[-1]:g} l/min it lies between {worst['damping_ratio'].min():.3f} and "
            f"{worst['damping_ratio'].max():.3f} depending on the place: a settling time tells a leak only when the "
            f"place is known.",
        ],
    )
