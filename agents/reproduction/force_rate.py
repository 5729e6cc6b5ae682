"""Section 4 of the paper: the four terms of dF/dt (24) along a move and along a stop."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.reproduction.drawing import COLOURS, ReproducedFigure, panel_title
from agents.reproduction.rig import LAWS, Law, Rig, simplified, with_leak
from hydro_env import equilibrium, resistance_from_flow, simulate
from hydro_env.plant.analysis import force_rate_terms
from hydro_env.plant.arrays import coefficient_array, derivative_array
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.states import STATE_NAMES

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
DRIVE, HELD, WATCH = 0.15, 0.02, 0.25
WINDOWS = {"move": (0.0, DRIVE), "stop": (DRIVE, DRIVE + 0.15)}
"""s after the command to move; all times of this file times Rig.stretch."""


@lru_cache(maxsize=4)
def force_rate_table(
    rig: Rig, law: Law = "laminar", leaks: tuple[float, ...] = LEAKS, orifice: float = 0.0
) -> pd.DataFrame:
    """The four terms over time for each leak, their sum, and dF/dt from the two chambers (23) as a check.

    ``orifice``: gain of a throttle besides, m³/(s √Pa).
    """
    parts = []
    for leak in leaks:
        plant = with_leak(simplified(rig.parameters, "none", True), leak, law)
        leakage = {"external_resistance": resistance_from_flow(EXTERNAL_LEAK)}
        if orifice:
            leakage["orifice_gain"] = plant.leakage.orifice_gain + orifice
        plant = plant.replace(leakage=leakage)
        _, holding = equilibrium(plant, rig.start)
        spans = ((HELD, holding), (DRIVE, rig.voltage), (WATCH, 0.0))
        voltage = np.concatenate([np.full(rig.count(rig.stretch * seconds), volts) for seconds, volts in spans])
        run = simulate(plant, voltage, rig.sample_time, {"position": rig.start})
        terms = force_rate_terms(run)
        c = coefficient_array(plant)
        rates = np.array([derivative_array(state, c, 0.0) for state in run.states])
        row_a, row_b = STATE_NAMES.index("pressure_a"), STATE_NAMES.index("pressure_b")
        area_a, area_b = (getattr(Coefficients(*c), f"area_{chamber}") for chamber in "ab")
        parts.append(
            pd.DataFrame(
                {
                    "leak_lpm": leak,
                    "time_s": run.time - rig.count(rig.stretch * HELD) * rig.sample_time,
                    **dict(zip(TERMS, terms, strict=True)),
                    "sum_n_s": sum(terms),
                    "from_chambers_n_s": area_a * rates[:, row_a] - area_b * rates[:, row_b],
                    "pressure_difference_bar": (run.pressure_a - run.pressure_b) / 1e5,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def shares(table: pd.DataFrame, stretch: float = 1.0) -> pd.DataFrame:
    """Per leak and window: internal leakage's share of all four sizes, and the mean pressure difference."""
    rows = []
    for leak, part in table.groupby("leak_lpm"):
        for window, (first, last) in WINDOWS.items():
            seen = part[(part["time_s"] >= stretch * first) & (part["time_s"] < stretch * last)]
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
    stretch = float(table["time_s"].max()) / (DRIVE + WATCH)
    for column, (start, title) in enumerate(((0.0, "Start of the move"), (DRIVE, "Stop"))):
        first = stretch * start
        seen = part[(part["time_s"] >= first - 0.01 * stretch) & (part["time_s"] <= first + 0.1 * stretch)]
        time = 1e3 * (seen["time_s"].to_numpy() - first)
        stack, leaks, difference = grid[:, column]
        _stacked(stack, time, seen)
        panel_title(stack, title)
        for colour, name in list(zip(COLOURS, TERMS, strict=False))[2:]:
            leaks.plot(time, 1e-3 * seen[name], color=colour, label=TERMS[name])
        difference.plot(time, seen["pressure_difference_bar"], color="#222222")
        difference.axhline(0.0, color="#6b6b6b", linewidth=0.7)
        difference.set_xlabel(f"time after the command to {'stop' if first else 'move'}, ms")
        difference.set_xlim(-10 * stretch, 100 * stretch)
    for axes, label in zip(
        grid[:, 0], ("terms of dF/dt, kN/s", "leakage terms\nalone, kN/s", "P_a − P_b, bar"), strict=True
    ):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    handles, labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles), fontsize=8.0)


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


def laminar_force_rate_figure(rig: Rig) -> ReproducedFigure:
    """The terms of (24) with a laminar leak."""
    return _figure(rig, "laminar")


def throttle_force_rate_figure(rig: Rig) -> ReproducedFigure:
    """The terms of (24) with a throttle in parallel, as on the paper's rig."""
    return _figure(rig, "throttle")


def _figure(rig: Rig, law: Law) -> ReproducedFigure:
    table = force_rate_table(rig, law)
    told = shares(table, rig.stretch)
    at = {window: told[told["window"] == window].set_index("leak_lpm") for window in WINDOWS}
    listed = {
        window: ", ".join(f"{100 * row['leakage_share']:.2g} % at {leak:g} l/min" for leak, row in rows.iterrows())
        for window, rows in at.items()
    }
    error = (table["sum_n_s"] - table["from_chambers_n_s"]).abs().max() / table["from_chambers_n_s"].abs().max()
    part = table[table["leak_lpm"] == DRAWN]
    rest = part[part["time_s"] < 0.0].iloc[0]
    move, stop = at["move"].loc[DRAWN], at["stop"].loc[DRAWN]
    against = bool(
        (np.sign(table["internal_leakage_n_s"]) == -np.sign(table["pressure_difference_bar"])).mean() > 0.999
    )
    sizes = part[list(TERMS)].abs().max()
    second = sizes[["valve_n_s", "motion_n_s"]].min()
    return ReproducedFigure(
        table=table,
        paint=paint_force_rate,
        height=6.8,
        equations="(19), (20), (23), (24)" if law == "laminar" else "(14), (19), (20), (23), (24) with Q_i = K_i √ΔP",
        paper="Equation (24) splits the rate of the force into valve flow, piston motion, internal and external "
        "leakage. Leakage is called negligible while the pressure difference is low, and later slows the build-up of "
        "the force, which damps."
        + ("" if law == "laminar" else " The paper writes a laminar leak, but its rig leaks through a throttle."),
        how=f"{LAWS[law].capitalize()} (picture: {DRAWN:g} l/min at 100 bar), {EXTERNAL_LEAK:g} l/min past the rod "
        f"seal, no friction; {rig.voltage:g} V from {1e3 * rig.start:+.0f} mm for {DRIVE * rig.stretch:.2f} s, then 0 "
        f"V. Coloured areas pile up from zero, positive upwards, negative downwards; the black line is their sum.",
        found=[
            f"At {DRAWN:g} l/min the terms reach {1e-3 * sizes['valve_n_s']:.0f} kN/s (valve flow), "
            f"{1e-3 * sizes['motion_n_s']:.0f} kN/s (motion), {1e-3 * sizes['internal_leakage_n_s']:.0f} kN/s "
            f"(internal "
            f"leakage) and {1e-3 * sizes['external_leakage_n_s']:.1f} kN/s (external leakage): the leak is "
            f"{'small beside' if sizes['internal_leakage_n_s'] < 0.2 * second else 'comparable to'} the first two"
            + (", yet it always acts against the pressure difference." if against else "."),
            f"The four terms add up to dF/dt of the two chambers (23) to within {error:.0e} of its largest value.",
            f"Share of internal leakage in the sizes of all four terms: while moving {listed['move']}; in the "
            f"{0.15 * rig.stretch:.2f} s after the stop {listed['stop']}. The mean size of the pressure difference is "
            f"{move['mean_size_of_difference_bar']:.1f} bar while moving and "
            f"{stop['mean_size_of_difference_bar']:.1f} bar after the stop (at {DRAWN:g} l/min).",
        ],
        differs=_differences(rig, rest, stop, table),
    )


def _differences(rig: Rig, rest: pd.Series, stop: pd.Series, table: pd.DataFrame) -> list[str]:
    sentences = []
    if abs(rest["pressure_difference_bar"]) > 1.0:
        sentences.append(
            f"The pressure difference is not small just because nothing moves: at rest at {1e3 * rig.start:+.0f} mm it "
            f"is {rest['pressure_difference_bar']:.1f} bar, since areas and load ask for unequal pressures, and the "
            f"leakage term is {1e-3 * rest['internal_leakage_n_s']:+.1f} kN/s."
        )
    signs = table["internal_leakage_n_s"]
    if signs.min() < 0.0 < signs.max():
        sentences.append(
            "Leakage does not only slow the force: its sign is that of P_b − P_a, so that it raises the force as well "
            "as lowers it."
        )
    if abs(stop["mean_difference_bar"]) < 0.5 * stop["mean_size_of_difference_bar"]:
        sentences.append(
            f"A small mean pressure difference does not make the leak unimportant: after the stop it is "
            f"{stop['mean_difference_bar']:+.1f} bar in the mean ({stop['mean_size_of_difference_bar']:.1f} bar in "
            f"size). What damps is how steeply the leak answers to the swing of the difference (Fig. 13)."
        )
    return sentences
