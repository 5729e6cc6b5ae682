"""Which of the assumed parameters each result of the page hangs on, ranked."""

from __future__ import annotations

import math

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from agents.reproduction.drawing import ReproducedFigure, plain
from agents.reproduction.results import FRICTION_SHARE, LEAK, MODERATE, RESULTS, Result, Setting, setting_of
from agents.reproduction.rig import Rig
from agents.reproduction.variations import CHANGE, Variation, leak_variation, unused_parameters, variations
from hydro_env import HydroError, PlantParameters

SHOWN = 20
LEAST = 1e-9
"""Results smaller than this are zero: nothing relative can be said of them."""

LEAK_NAME = "leakage.internal_resistance"


def sensitivity_table(rig: Rig) -> pd.DataFrame:
    """One row per result and parameter, the weightiest first within each result.

    ``normal``, ``at_low`` and ``at_high`` in the result's unit; ``change_low_percent`` and ``change_high_percent`` of
    the normal value; ``effect_percent`` the larger of their sizes; ``rank`` from 1. NaN where a value is not possible.
    """
    at, moved = setting_of(rig), variations(rig)
    rows = []
    for result in RESULTS:
        normal = _tried(result, rig.parameters, at)
        if not math.isfinite(normal) or abs(normal) < LEAST:
            continue
        for variation in (*moved, leak_variation(LEAK)):
            low, high = _moved(result, variation, rig, at)
            changes = [100.0 * (value / normal - 1.0) for value in (low, high)]
            known = [abs(change) for change in changes if math.isfinite(change)]
            rows.append(
                {
                    "result": result.name,
                    "unit": result.unit,
                    "parameter": variation.name,
                    "value": variation.value,
                    "low_value": variation.low_value,
                    "high_value": variation.high_value,
                    "normal": normal,
                    "at_low": low,
                    "at_high": high,
                    "change_low_percent": changes[0],
                    "change_high_percent": changes[1],
                    "effect_percent": max(known) if known else math.nan,
                }
            )
    if not rows:
        raise HydroError("none of the results can be computed for this rig")
    table = pd.DataFrame(rows)
    table["rank"] = table.groupby("result")["effect_percent"].rank(ascending=False, method="first")
    order = {result.name: number for number, result in enumerate(RESULTS)}
    return table.sort_values(["result", "rank"], key=lambda c: c.map(order) if c.name == "result" else c).reset_index(
        drop=True
    )


def _moved(result: Result, variation: Variation, rig: Rig, at: Setting) -> tuple[float, float]:
    if variation.name == LEAK_NAME:  # a smaller resistance is a larger leak
        return _tried(result, rig.parameters, at, 1 + CHANGE), _tried(result, rig.parameters, at, 1 - CHANGE)
    low, high = (
        _tried(result, plant, at) if plant is not None else math.nan for plant in (variation.low, variation.high)
    )
    return low, high


def _tried(result: Result, plant: PlantParameters, at: Setting, factor: float = 1.0) -> float:
    try:
        return result.compute(plant, at, factor)
    except (HydroError, ArithmeticError, ValueError):  # cannot be held, does not oscillate, no root
        return math.nan


def effects(table: pd.DataFrame) -> pd.DataFrame:
    """Effects in %, parameters (weightiest first) by results."""
    grid = table.pivot(index="parameter", columns="result", values="effect_percent")
    grid = grid[[result.name for result in RESULTS if result.name in grid.columns]]
    return grid.loc[grid.max(axis=1).sort_values(ascending=False).index]


def paint_sensitivity(figure: Figure, table: pd.DataFrame) -> None:
    """A chequered table: the darker, the more the result changes."""
    grid = effects(table).head(SHOWN)
    axes = figure.subplots()
    words = {result.name: result.words for result in RESULTS}
    values = np.nan_to_num(grid.to_numpy(), nan=0.0)
    shades = matplotlib.colormaps["Blues"]
    norm = LogNorm(vmin=0.5, vmax=100.0, clip=True)
    axes.pcolormesh(0.75 * np.asarray(norm(np.maximum(values, 0.5))), cmap=shades, vmin=0.0, vmax=1.0)
    axes.invert_yaxis()
    for row, column in np.ndindex(values.shape):
        value = values[row, column]
        text = f"{value:.0f}" if value >= 10.0 else f"{value:.1f}" if value >= 0.1 else "·"
        ink = "white" if float(norm(max(value, 0.5))) > 0.75 else "#222222"
        axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", fontsize=7.5, color=ink)
    axes.set_yticks(np.arange(len(grid)) + 0.5, [name.replace(".", ": ").replace("_", " ") for name in grid.index])
    axes.set_xticks(np.arange(grid.shape[1]) + 0.5, [words[name] for name in grid.columns], rotation=38, ha="left")
    axes.xaxis.tick_top()
    axes.set_xlabel("largest change of the result, %; · below 0.1 %")
    axes.xaxis.set_label_position("bottom")
    axes.tick_params(length=0)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def sensitivity_figure(rig: Rig) -> ReproducedFigure:
    """The table of effects with its words."""
    table = sensitivity_table(rig)
    grid = effects(table)
    own = table[table["parameter"] != LEAK_NAME]
    found = []
    for result in RESULTS:
        part = own[own["result"] == result.name].head(3)
        if len(part):
            listed = ", ".join(
                f"{_named(row['parameter'])} {plain(row['effect_percent'], 2)} %" for _, row in part.iterrows()
            )
            normal = part["normal"].iloc[0]
            unit = "" if result.unit == "1" else f" {result.unit}"
            found.append(f"{result.words} ({plain(normal)}{unit}): {listed}.")
    idle = [_named(name) for name in grid.index[grid.max(axis=1) < 1.0]]
    if idle:
        found.append(f"No result changes by 1 % or more with: {', '.join(idle)}.")
    unused = [_named(name) for name in unused_parameters(rig)]
    missing = [result.words for result in RESULTS if result.name not in grid.columns]
    special = [row for row in own.drop_duplicates("parameter").itertuples() if not _plain(row.value, row.low_value)]
    others = "; ".join(f"{_named(row.parameter)} {row.value} → {row.low_value}, {row.high_value}" for row in special)
    return ReproducedFigure(
        table=table,
        paint=paint_sensitivity,
        height=1.6 + 0.25 * min(len(grid), SHOWN),
        paper="The paper gives no supply pressure, friction or air content, so that its values cannot be recomputed. "
        "This is how much each unknown matters for each result."
        + (
            ""
            if rig.is_paper
            else " Varied is what is assumed for the paper's rig: which of its own numbers are sure, this rig's file "
            "does not say."
        ),
        how=f"Largest change of each result in %, one assumed parameter at a time by ±{100 * CHANGE:.0f} %; shown "
        f"are the "
        f"{min(len(grid), SHOWN)} of {len(grid)} parameters with the largest effects, the CSV file has all, with rank "
        f"and sign. Zero, infinite or a choice, and so moved otherwise: {others or 'none'}. The leak itself "
        f"(internal resistance) by ±{100 * CHANGE:.0f} % is the yardstick. Results hold {LEAK:g} l/min (holding and "
        f"energy {MODERATE:g} l/min), the closed loop a fixed gain; settling is judged with friction at "
        f"{100 * FRICTION_SHARE:g} % of what is assumed, since else friction alone would decide, and the held error "
        f"without friction."
        + (f" Not used by the models of this rig, and so left out: {', '.join(unused)}." if unused else "")
        + (f" Zero or impossible for this rig, and so left out: {', '.join(missing)}." if missing else ""),
        found=found,
    )


def _named(path: str) -> str:
    return path.replace(".", ": ").replace("_", " ")


def _plain(value: str, low: str) -> bool:
    try:
        return abs(float(low) / float(value) - (1 - CHANGE)) < 1e-3
    except (ValueError, ZeroDivisionError):
        return False
