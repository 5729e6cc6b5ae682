"""Natural frequency and damping of the axis over stroke and leakage."""

from __future__ import annotations

import math

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agents.reproduction.drawing import ReproducedFigure, panel_title
from agents.reproduction.rig import Rig, simplified, with_leak
from hydro_env import HydroError
from hydro_env.plant.linearisation import linearise

Array = NDArray[np.float64]

SHARES = np.linspace(-0.95, 0.95, 21)
"""Positions, in parts of half the stroke."""

LEAKS = np.geomspace(0.01, 4.0, 17)


def map_table(rig: Rig) -> pd.DataFrame:
    """Natural frequency (Hz) and damping ratio at rest; laminar leak, no friction, no spring, with null leakage.

    Without the spring the whole stroke can be held. NaN where the linearised axis does not oscillate, or where the
    leak is more than the supply can feed.
    """
    plain = simplified(rig.parameters, "none", True).replace(load={"spring_stiffness": 0.0})
    positions, rows = 0.5 * rig.parameters.cylinder.stroke * SHARES, []
    for leak in LEAKS:
        plant = with_leak(plain, float(leak), "laminar")
        for position in positions:
            frequency = damping = math.nan
            try:
                mode = linearise(plant, position=float(position)).hydraulic_mode
                frequency, damping = mode.natural_frequency / (2 * math.pi), mode.damping_ratio
            except (ArithmeticError, HydroError):  # overdamped, or more leak than the supply can feed
                pass
            rows.append(
                {
                    "position_mm": 1e3 * position,
                    "leak_lpm": leak,
                    "natural_frequency_hz": frequency,
                    "damping_ratio": damping,
                }
            )
    table = pd.DataFrame(rows)
    if table[table["leak_lpm"] == LEAKS[0]]["damping_ratio"].isna().all():
        raise ArithmeticError("the axis oscillates nowhere: it is overdamped")
    return table


ROUND = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
SHARES_OF_MAP = (0.1, 0.3, 0.5, 0.65, 0.8, 0.92)
WIDE = 5.0
"""Largest over smallest value from which on lines stand at round numbers of each decade."""


def contour_levels(values: Array) -> tuple[float, ...]:
    """Values of the contour lines: round numbers, or numbers of two digits that part the map into like shares."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high > WIDE * low:
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        levels = [factor * 10.0**decade for decade in decades for factor in ROUND]
    else:
        levels = sorted({float(f"{level:.2g}") for level in np.nanquantile(values, SHARES_OF_MAP)})
    return tuple(level for level in levels if low < level < high) or (0.5 * (low + high),)


def paint_maps(figure: Figure, table: pd.DataFrame) -> None:
    """Two maps with labelled contours."""
    panels = figure.subplots(1, 2, sharey=True)
    for axes, column, title, colours in zip(
        panels,
        ("natural_frequency_hz", "damping_ratio"),
        ("Natural frequency, Hz", "Damping ratio"),
        ("Blues", "Oranges"),
        strict=True,
    ):
        grid = table.pivot(index="leak_lpm", columns="position_mm", values=column)
        values = np.ma.masked_invalid(grid.to_numpy())
        levels = contour_levels(grid.to_numpy())
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


def map_figure(rig: Rig) -> ReproducedFigure:
    """The maps with their words."""
    table = map_table(rig)
    rows = table.set_index(["leak_lpm", "position_mm"]).sort_index()
    tight, worst = rows.loc[LEAKS[0]], rows.loc[LEAKS[-1]]
    slowest = tight["natural_frequency_hz"].idxmin()
    middle = tight.index[len(tight) // 2]
    return ReproducedFigure(
        table=table,
        paint=paint_maps,
        height=3.6,
        paper="The paper damps one stop at one place. How much a leak changes depends on where the piston stands.",
        how="Eigenvalues of the linearised axis at rest; laminar leak, valve as assumed, no friction"
        + (", and no spring, so that the whole stroke can be held." if rig.has_spring else "."),
        found=[
            f"With a tight seal the natural frequency is lowest, {tight['natural_frequency_hz'].min():.0f} Hz, at "
            f"{slowest:.0f} mm, and highest, {tight['natural_frequency_hz'].max():.0f} Hz, at "
            f"{tight['natural_frequency_hz'].idxmax():.0f} mm.",
            f"At mid-stroke the damping ratio is {_ratio(tight.loc[middle, 'damping_ratio'])} at {LEAKS[0]:g} l/min "
            f"and {_ratio(worst.loc[middle, 'damping_ratio'])} at {LEAKS[-1]:g} l/min.",
            f"At {LEAKS[-1]:g} l/min it exists nowhere: the axis is overdamped, or cannot be held."
            if worst["damping_ratio"].isna().all()
            else f"At {LEAKS[-1]:g} l/min it lies between {worst['damping_ratio'].min():.3f} and "
            f"{worst['damping_ratio'].max():.3f} depending on the place"
            + (
                ": a settling time tells a leak only when the place is known."
                if worst["damping_ratio"].max() > 1.3 * worst["damping_ratio"].min()
                else "."
            ),
        ],
    )


def _ratio(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "none (overdamped, or not to be held)"
