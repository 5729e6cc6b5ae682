"""Section 4 of the paper: the four terms of dF/dt (24) along a move and along a stop."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.reproduction.drawing import COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import SAMPLE_TIME, simplified, with_leak
from hydro_env import PlantParameters, equilibrium, resistance_from_flow, simulate
from hydro_env.plant.analysis import force_rate_terms
from hydro_env.plant.arrays import coefficient_array, derivative_array
from hydro_env.plant.equations import STATE_NAMES

LEAKS = (0.01, 0.3, 1.0, 4.0)
DRAWN = 1.0
"""l/min at 100 bar; the leak of the picture."""

EXTERNAL_LEAK = 0.1
"""l/min at 100 bar past the rod seal, so that the fourth term is there at all."""

TERMS = {
    "valve_n_s": "flow through the valve",
    "motion_n_s": "motion of the piston",
    "internal_leakage_n_s": "internal leakage",
    "external_leakage_n_s": "external leakage",
}
START, DRIVE, HELD, WATCH, VOLTAGE = 0.005, 0.15, 0.02, 0.25, 4.0
WINDOWS = {"move": (0.0, DRIVE), "stop": (DRIVE, DRIVE + 0.15)}
"""s after the command to move."""


def force_rate_table(base: PlantParameters) -> pd.DataFrame:
    """The four terms over time for each leak, their sum, and dF/dt from the two chambers (23) as a check."""
    parts = []
    for leak in LEAKS:
        plant = with_leak(simplified(base, False, True), leak, "laminar")
        plant = plant.replace(leakage={"external_resistance": resistance_from_flow(EXTERNAL_LEAK)})
        _, holding = equilibrium(plant, START)
        spans = ((HELD, holding), (DRIVE, VOLTAGE), (WATCH, 0.0))
        voltage = np.concatenate([np.full(round(seconds / SAMPLE_TIME), volts) for seconds, volts in spans])
        run = simulate(plant, voltage, SAMPLE_TIME, {"position": START})
        terms = force_rate_terms(run)
        c = coefficient_array(plant)
        rates = np.array([derivative_array(state, c, 0.0) for state in run.states])
        row_a, row_b = STATE_NAMES.index("pressure_a"), STATE_NAMES.index("pressure_b")
        area_a = 0.25 * np.pi * plant.cylinder.bore_diameter**2
        area_b = area_a - 0.25 * np.pi * plant.cylinder.rod_diameter**2
        parts.append(
            pd.DataFrame(
                {
                    "leak_lpm": leak,
                    "time_s": run.time - HELD,
                    **dict(zip(TERMS, terms, strict=True)),
                    "sum_n_s": sum(terms),
                    "from_chambers_n_s": area_a * rates[:, row_a] - area_b * rates[:, row_b],
                    "pressure_difference_bar": (run.pressure_a - run.pressure_b) / 1e5,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def shares(table: pd.DataFrame) -> pd.DataFrame:
    """Per leak and window: internal leakage's share of all four sizes, and the mean pressure difference."""
    rows = []
    for leak, part in table.groupby("leak_lpm"):
        for window, (first, last) in WINDOWS.items():
            seen = part[(part["time_s"] >= first) & (part["time_s"] < last)]
            sizes = seen[list(TERMS)].abs().sum()
            difference = seen["pressure_difference_bar"]
            rows.append(
                {
                    "leak_lpm": leak,
                    "window": window,
                    "leakage_share": float(sizes["internal_leakage_n_s"] / sizes.sum()),
                    "mean_difference_bar": float(difference.mean()),
                    "mean_size_of_difference_bar": float(difference.abs().mean()),
                    "mean_leakage_n_s": float(seen["internal_leakage_n_s"].mean()),
                }
            )
    return pd.DataFrame(rows)


def paint_force_rate(figure: Figure, table: pd.DataFrame) -> None:
    """Stacked terms with their sum, the leakage terms enlarged, the pressure difference; move and stop."""
    grid = figure.subplots(3, 2, sharex="col", sharey="row", height_ratios=[2.2, 1.2, 1.0])
    part = table[table["leak_lpm"] == DRAWN]
    for column, (first, title) in enumerate(((0.0, "Start of the move"), (DRIVE, "Stop"))):
        seen = part[(part["time_s"] >= first - 0.01) & (part["time_s"] <= first + 0.1)]
        time = 1e3 * (seen["time_s"].to_numpy() - first)
        stack, leaks, difference = grid[:, column]
        _stacked(stack, time, seen)
        panel_title(stack, title)
        for colour, name in list(zip(COLOURS, TERMS, strict=False))[2:]:
            leaks.plot(time, 1e-3 * seen[name], color=colour, label=TERMS[name])
        difference.plot(time, seen["pressure_difference_bar"], color="#222222")
        difference.axhline(0.0, color="#6b6b6b", linewidth=0.7)
        difference.set_xlabel(f"time after the command to {'stop' if first else 'move'}, ms")
        difference.set_xlim(-10, 100)
    for axes, label in zip(
        grid[:, 0], ("terms of dF/dt, kN/s", "leakage terms\nalone, kN/s", "P_a − P_b, bar"), strict=True
    ):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    legend(grid[0, 1], loc="lower right")
    legend(grid[1, 1], loc="upper right")


def _stacked(axes: Axes, time: np.ndarray, seen: pd.DataFrame) -> None:
    """Positive parts pile up above zero, negative ones below: upper edge plus lower edge is the sum."""
    above, below = np.zeros(len(seen)), np.zeros(len(seen))
    for colour, (name, words) in zip(COLOURS, TERMS.items(), strict=False):
        values = 1e-3 * seen[name].to_numpy()
        up, down = np.maximum(values, 0.0), np.minimum(values, 0.0)
        axes.fill_between(time, above, above + up, color=colour, alpha=0.75, linewidth=0, label=words)
        axes.fill_between(time, below, below + down, color=colour, alpha=0.75, linewidth=0)
        above, below = above + up, below + down
    axes.plot(time, 1e-3 * seen["sum_n_s"], color="black", linewidth=1.3, label="sum = dF/dt")


def force_rate_figure(base: PlantParameters) -> ReproducedFigure:
    """The terms of (24) with their words."""
    table = force_rate_table(base)
    told = shares(table)
    at = {window: told[told["window"] == window].set_index("leak_lpm") for window in WINDOWS}
    listed = {
        window: ", ".join(f"{100 * row['leakage_share']:.2g} % at {leak:g} l/min" for leak, row in rows.iterrows())
        for window, rows in at.items()
    }
    error = (table["sum_n_s"] - table["from_chambers_n_s"]).abs().max() / table["from_chambers_n_s"].abs().max()
    part = table[table["leak_lpm"] == DRAWN]
    rest = part[part["time_s"] < 0.0].iloc[0]
    stop = at["stop"].loc[DRAWN]
    return ReproducedFigure(
        key="section4_force_rate",
        title="Section 4: what changes the force",
        table=table,
        paint=paint_force_rate,
        height=6.8,
        equations="(19), (20), (23), (24)",
        paper="Equation (24) splits the rate of the force into valve flow, piston motion, internal and external "
        "leakage. Leakage is called negligible while the pressure difference is low, and later slows the build-up of "
        "the force, which damps.",
        how=f"Laminar leak (picture: {DRAWN:g} l/min at 100 bar), {EXTERNAL_LEAK:g} l/min past the rod seal, no "
        f"friction; 4 V from +5 mm for 0.15 s, then 0 V. Coloured areas pile up from zero, positive upwards, negative "
        f"downwards; the black line is their sum.",
        found=[
            "Valve flow and motion are large and all but cancel; leakage is small beside each, yet it always acts "
            "against the pressure difference, and so takes energy out of every swing.",
            f"The four terms add up to dF/dt of the two chambers (23) to within {error:.0e} of its largest value.",
            f"Share of internal leakage in the sizes of all four terms: while moving {listed['move']}; in the 0.15 s "
            f"after the stop {listed['stop']}. The mean size of the pressure difference is "
            f"{at['move'].loc[DRAWN, 'mean_size_of_difference_bar']:.1f} bar while moving and "
            f"{stop['mean_size_of_difference_bar']:.1f} bar after the stop (at {DRAWN:g} l/min).",
        ],
        differs=[
            f"The pressure difference is not small just because nothing moves: at rest at +5 mm it is "
            f"{rest['pressure_difference_bar']:.1f} bar on this one-sided rod, and the leakage term is "
            f"{1e-3 * rest['internal_leakage_n_s']:+.1f} kN/s. The sign is that of P_b − P_a: leakage raises the force "
            f"as well as lowers it.",
            f"A small pressure difference does not make the leak unimportant: after the stop it is "
            f"{stop['mean_difference_bar']:+.1f} bar in the mean, and yet this leak shortens the oscillation (Fig. "
            f"13). What damps is how steeply the leak answers to the difference, not the difference.",
        ],
    )
