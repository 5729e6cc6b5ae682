"""The figures of a study: errors and costs by leak and by kind of reference, and ratios to the first controller."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from hydro_agents.report.canvas import INK, PALE, Array, Plot, curve_plot
from hydro_agents.report.content import Content, intervals
from hydro_agents.running.statistics import mean_interval
from hydro_agents.running.text import family_name, setting


def tracking_plots(content: Content) -> list[Plot]:
    """Errors over leak and by reference, paired comparisons, valve travel, worst cases."""
    error, travel = ("mean_error_mm", "error, mm"), ("valve_travel_per_s", "travel, strokes per second")
    reversals, energy = ("reversals_per_s", "reversals, per second"), ("supply_energy_j", "energy, J")
    wear = "Changes of direction that the valve follows; they wear it."
    motions = "Mean over all runs; the motions are the same for every leak."
    tail = "Mean error of a run, averaged over the worst 5 % of the runs (conditional value at risk)."
    worst, compared = "Mean error of the single worst run.", content.has("ratios")
    return [
        _by_leak(content, *error, "Mean error", f"Mean over all runs.{_hint(content)}"),
        _by_leak(content, *travel, "Valve travel", "Cost of the positioning: travel of the valve's spool."),
        *([_difference(content)] if compared else []),
        _by_leak(content, *reversals, "Reversals of the command", wear),
        _by_leak(content, *energy, "Energy from the supply", motions),
        _by_family(content),
        *([_ratios(content)] if compared else []),
        _by_leak(content, *error, "Worst 5 % of the runs", tail, "cvar_5_percent"),
        _by_leak(content, *error, "Worst run", worst, "worst"),
    ]


def _hint(content: Content) -> str:
    """A hint on intervals: with several controllers, overlapping intervals of single means mislead."""
    if not content.has("ratios"):
        return " Bars: 95 % interval."
    return " The tables hold the intervals; the paired comparison shows which differences are certain."


def _by_leak(content: Content, metric: str, label: str, title: str, note: str, column: str = "mean") -> Plot:
    """A column of the table ``levels`` for one metric over the leak; a controller alone has its intervals."""
    curves = {}
    for name in content.controllers:
        own = content.rows("levels", metric=metric, controller=name).sort_values("leakage_flow_lpm")
        frame = intervals(own, column, "leakage_flow_lpm")
        curves[name] = frame if column == "mean" and not content.has("ratios") else frame[["value"]]

    def finish(axes: Axes) -> None:
        axes.set_ylabel(label)
        _error_scale(axes, pd.concat(curves).to_numpy(), "y")

    key, unit = f"level-{metric}-{column}", f" {label.split(', ')[1]}"
    return curve_plot(key, f"{title} by leak size", note, curves, content.looks, unit, finish, drawn="levels")


def _difference(content: Content) -> Plot:
    """Error minus the baseline's error on the same plants, with intervals of the difference."""
    base, *names = content.controllers
    table = content.table("cases").pivot_table("mean_error_mm", ["leakage_flow_lpm", "plant"], "controller")
    curves = {}
    for name in names:
        changes = (table[name] - table[base]).groupby(level=0)
        rows = {level: mean_interval(change.to_numpy()).columns("value") for level, change in changes}
        curves[name] = pd.DataFrame(rows).T

    def finish(axes: Axes) -> None:
        axes.axhline(0.0, **content.looks[base].stroke, label=base)
        axes.set_ylabel(f"error − error of {base}, mm")

    title = f"Difference to {base} by leak size"
    note = "On the same plants, references and noise; bars: 95 % interval of the difference. Below 0 is better."
    named = ("difference", title, note)
    return curve_plot(*named, curves, content.looks, " mm", finish, apart=0.03, drawn="levels")


def _by_family(content: Content) -> Plot:
    parts = {}
    for name in content.controllers:
        parts[name] = intervals(content.rows("families", metric="mean_error_mm", controller=name), "mean", "family")
        parts[name].index = parts[name].index.map(family_name)
        if content.has("ratios"):
            parts[name][["low", "high"]] = np.nan  # no bars

    def finish(axes: Axes) -> None:
        axes.set_xlabel("mean error, mm")
        _error_scale(axes, pd.concat(parts).to_numpy(), "x")

    title, note = "Mean error by kind of reference", "Mean over all leak sizes." + _hint(content)
    return curve_plot("family", title, note, parts, content.looks, " mm", finish, drawn="rows")


def _error_scale(axes: Axes, values: Array, which: str) -> None:
    """Scale an axis from zero, or logarithmically if the values differ by a factor of more than 20."""
    axis = axes.yaxis if which == "y" else axes.xaxis
    positive = values[values > 0.0]
    if len(positive) and positive.max() > 20.0 * positive.min():
        _log_scale(axes, which)
        axis.set_label_text(f"{axis.get_label_text()} (logarithmic)")
    else:
        axes.set(**{f"{which}lim": (0.0, 1.07 * float(np.nanmax(values)) or None)})


def _log_scale(axes: Axes, which: str) -> None:
    axes.set(**{f"{which}scale": "log"})
    axis = axes.yaxis if which == "y" else axes.xaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: setting(value)))


def _ratios(content: Content) -> Plot:
    """Error over the baseline's error on the same plants, by kind of reference."""
    table = content.table("ratios")
    table = table[table["group"].isin(["all", "family"])]
    looks, base = content.looks, table["against"].iloc[0]
    table = table.assign(value=table["value"].map(lambda value: family_name(value) or "all runs"))
    parts = {name: intervals(own, "ratio", "value") for name, own in table.groupby("controller", sort=False)}

    def finish(axes: Axes) -> None:
        axes.axvline(1.0, color=INK, linewidth=1.0)
        axes.axhline(0.5, color=PALE, linewidth=0.8)
        values = pd.concat(parts).to_numpy()
        if np.nanmax(values) > 3.0 * np.nanmin(values):
            _log_scale(axes, "x")
        axes.set_xlabel(f"error ÷ error of {base}")

    title = "Ratio of errors by kind of reference"
    note = f"Mean error over that of {base} on the same runs; bars: 95 % interval. Left of the line is better."
    return curve_plot("ratio", title, note, parts, looks, f" × {base}", finish, drawn="rows")
