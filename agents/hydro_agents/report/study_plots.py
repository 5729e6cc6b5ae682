"""The figures of a study: errors and costs by leak and by kind of reference, and ratios to the first controller."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from hydro_agents.report.canvas import INK, Array, Plot, curve_plot
from hydro_agents.report.content import Content, intervals
from hydro_agents.running.text import family_name, setting


def tracking_plots(content: Content) -> list[Plot]:
    """Errors over leak and by reference, paired comparisons, valve travel, worst cases."""
    error, travel = ("mean_error_mm", "error, mm"), ("valve_travel_per_s", "travel, strokes per second")
    reversals, energy = ("reversals_per_s", "reversals, per second"), ("supply_energy_j", "energy, J")
    mean = "Mean over all runs; the tables hold the intervals."
    wear = "Changes of direction that the valve follows; they wear it."
    motions = "Mean over all runs; the motions are the same for every leak."
    worst, compared = "Mean error of the single worst run.", content.has("ratios")
    return [
        _by_leak(content, *error, "Mean error", mean),
        _by_leak(content, *travel, "Valve travel", "Cost of the positioning: travel of the valve's spool."),
        _by_leak(content, *reversals, "Reversals of the command", wear),
        _by_leak(content, *energy, "Energy from the supply", motions),
        _by_family(content),
        *([_ratios(content)] if compared else []),
        _by_leak(content, *error, "Worst run", worst, "worst"),
    ]


def _by_leak(content: Content, metric: str, label: str, title: str, note: str, column: str = "mean") -> Plot:
    """A column of the table ``levels`` for one metric over the leak."""
    table = content.rows("levels", metric=metric).pivot_table(column, "leakage_flow_lpm", "controller")

    def finish(axes: Axes) -> None:
        axes.set_ylabel(label)
        _scale(axes, "y", table.to_numpy())

    key, unit = f"level-{metric}-{column}", f" {label.split(', ')[1]}"
    curves = {name: table[name] for name in content.controllers}
    return curve_plot(key, f"{title} by leak size", note, curves, content.looks, unit, finish, drawn="levels")


def _by_family(content: Content) -> Plot:
    table = content.rows("families", metric="mean_error_mm")
    table = table.assign(family=table["family"].map(family_name))
    parts = {name: table[table["controller"] == name].set_index("family")["mean"] for name in content.controllers}

    def finish(axes: Axes) -> None:
        axes.set_xlabel("mean error, mm")
        _scale(axes, "x", pd.concat(parts).to_numpy())

    named = ("family", "Mean error by kind of reference", "Mean over all leak sizes; the tables hold the intervals.")
    return curve_plot(*named, parts, content.looks, " mm", finish, drawn="rows")


def _scale(axes: Axes, which: str, values: Array, factor: float = 20.0) -> None:
    """Scale an axis from zero, or logarithmically if the values differ by more than a factor."""
    positive = values[values > 0.0]
    if not len(positive) or positive.max() <= factor * positive.min():
        axes.set(**{f"{which}lim": (0.0, 1.07 * float(np.nanmax(values)) or None)})
        return
    axes.set(**{f"{which}scale": "log"})
    axis = axes.yaxis if which == "y" else axes.xaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: setting(value)))


def _ratios(content: Content) -> Plot:
    """Error over the baseline's error on the same plants, by kind of reference."""
    table = content.table("ratios")
    table = table[table["group"].isin(["all", "family"])]
    looks, base = content.looks, content.baseline
    table = table.assign(value=table["value"].map(lambda value: family_name(value) or "all runs"))
    parts = {name: intervals(own, "ratio", "value") for name, own in table.groupby("controller", sort=False)}

    def finish(axes: Axes) -> None:
        axes.axvline(1.0, color=INK, linewidth=1.0)
        _scale(axes, "x", pd.concat(parts).to_numpy(), 3.0)
        axes.set_xlabel(f"error ÷ error of {base}")

    title = "Ratio of errors by kind of reference"
    note = f"Mean error over that of {base} on the same runs; bars: 95 % interval. Left of the line is better."
    return curve_plot("ratio", title, note, parts, looks, f" × {base}", finish, drawn="rows")
