"""The figures of the report: tracking errors and single runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from hydro_agents.report.canvas import (
    HEIGHT,
    INK,
    PALE,
    Array,
    Plot,
    bars_by,
    curve_plot,
    description,
    one_panel,
    row_axis,
    ticks,
)
from hydro_agents.report.content import Content
from hydro_agents.running.resampling import mean_interval
from hydro_agents.running.text import family_name, number, setting

RATIO_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def tracking_plots(content: Content) -> list[Plot]:
    """Errors over leak and by reference, paired comparisons, valve travel, worst cases."""
    tail = "Mean error of a run, averaged over the worst 5 % of the runs (conditional value at risk)."
    error = ("mean_error_mm", "error, mm")
    travel = ("valve_travel_per_s", "travel, strokes per second", "mean", "Valve travel by leak size")
    energy = ("supply_energy_j", "energy, J", "mean", "Energy from the supply by leak size")
    reversals = ("reversals_per_s", "reversals, per second", "mean", "Reversals of the command by leak size")
    compared = content.has("ratios")
    return [
        level_plot(content, *error, "mean", "Mean error by leak size", "Mean over all runs."),
        level_plot(content, *travel, "Cost of the positioning: travel of the valve's spool."),
        *([_difference_plot(content)] if compared else []),
        level_plot(content, *reversals, "Changes of direction that the valve follows; they wear it."),
        level_plot(content, *energy, "Mean over all runs; the motions are the same for every leak."),
        _by_family(content),
        *([_ratio_plot(content)] if compared else []),
        level_plot(content, *error, "cvar_5_percent", "Worst 5 % of the runs by leak size", tail),
        level_plot(content, *error, "worst", "Worst run by leak size", "Mean error of the single worst run."),
    ]


def _hint(content: Content) -> str:
    """A hint on intervals: with several controllers, overlapping intervals of single means mislead."""
    if not content.has("ratios"):
        return " Bars: 95 % interval."
    return " The tables hold the intervals; the paired comparison shows which differences are certain."


def level_plot(content: Content, metric: str, label: str, column: str, title: str, note: str) -> Plot:
    """A column of the table ``levels`` for one metric over the leak.

    Args:
        content: of the page.
        metric: name of the metric.
        label: of the vertical axis, with the unit.
        column: ``mean``, ``cvar_5_percent`` or ``worst``.
        title: of the figure.
        note: how to read it.
    """
    frame = content.table("levels")[content.table("levels")["metric"] == metric]
    alone = column == "mean" and not content.has("ratios")
    curves = {}
    for name in content.controllers:
        own = frame[frame["controller"] == name].set_index("leakage_flow_lpm").sort_index()
        curves[name] = own.rename(columns={column: "value"}) if alone else own[column]

    def finish(axes: Axes) -> None:
        axes.set_ylabel(label)
        _error_scale(axes, _ends(frame, column, alone))

    unit = f" {label.split(', ')[1]}"
    note += _hint(content) if column == "mean" and metric == "mean_error_mm" else ""
    return curve_plot(f"level-{metric}-{column}", title, note, curves, content.looks, unit, finish, levels=True)


def _difference_plot(content: Content) -> Plot:
    """Error minus the baseline's error on the same plants, with intervals of the difference."""
    base, *names = content.controllers
    levels = sorted({float(level) for level in content.table("cases")["leakage_flow_lpm"]})
    table = content.table("cases").pivot_table("mean_error_mm", ["leakage_flow_lpm", "plant"], "controller")
    curves: dict[str, pd.Series | pd.DataFrame] = {}
    for name in names:
        change = table[name] - table[base]
        rows = [mean_interval(change.loc[level].to_numpy()).columns("value") for level in levels]
        curves[name] = pd.DataFrame(rows, index=levels)

    def finish(axes: Axes) -> None:
        axes.axhline(0.0, **content.looks[base].stroke, label=base)
        axes.set_ylabel(f"error − error of {base}, mm")

    title = f"Difference to {base} by leak size"
    note = "On the same plants, references and noise; bars: 95 % interval of the difference. Below 0 is better."
    return curve_plot("difference", title, note, curves, content.looks, " mm", finish, levels=True, apart=0.03)


def _by_family(content: Content) -> Plot:
    frame = content.table("families")[content.table("families")["metric"] == "mean_error_mm"]
    looks = content.looks
    families = [str(family) for family in frame["family"].unique()]
    labels = [family_name(family) for family in families]
    alone = not content.has("ratios")
    if not alone:
        frame = frame.assign(low=np.nan, high=np.nan)  # no bars
    parts = {name: frame[frame["controller"] == name] for name in looks}

    def paint(axes: Axes) -> None:
        bars_by(axes, parts, "family", families, "mean", looks, "rows")
        row_axis(axes, labels)
        axes.set_xlabel("mean error, mm")
        _error_scale(axes, _ends(frame, "mean", alone), "x")

    title, note = "Mean error by kind of reference", "Mean over all leak sizes." + _hint(content)
    rows = {name: list(zip(labels, part["mean"], strict=True)) for name, part in parts.items()}
    return one_panel("family", title, note, description(title, rows, " mm"), paint, _height(len(families), len(parts)))


def _ends(frame: pd.DataFrame, column: str, intervals: bool) -> Array:
    """Values that the scale must include: those of a column, with or without intervals."""
    columns = [column, "low", "high"] if intervals else [column]
    values: Array = frame[columns].to_numpy(dtype=np.float64).ravel()
    return values


def _error_scale(axes: Axes, values: Array, which: str = "y") -> None:
    """Scale an axis from zero, or logarithmically if the values differ by a factor of more than 20."""
    positive = values[values > 0.0]
    if len(positive) and positive.max() > 20.0 * positive.min():
        axes.set(**{f"{which}scale": "log"})
        axis = axes.yaxis if which == "y" else axes.xaxis
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: setting(value)))
        axis.set_label_text(f"{axis.get_label_text()} (logarithmic)")
    else:
        axes.set(**{f"{which}lim": (0.0, 1.07 * float(np.nanmax(values)) or None)})


def _ratio_plot(content: Content) -> Plot:
    """Error over the baseline's error on the same plants, by kind of reference."""
    frame = content.table("ratios")[content.table("ratios")["group"].isin(["all", "family"])]
    looks = content.looks
    base, names = str(frame["against"].iloc[0]), [str(name) for name in frame["controller"].unique()]
    values = list(dict.fromkeys(str(value) for value in frame["value"]))
    labels = [family_name(value) if value else "all runs" for value in values]
    parts = {name: frame[frame["controller"] == name] for name in names}

    def paint(axes: Axes) -> None:
        axes.axvline(1.0, color=INK, linewidth=1.0)
        bars_by(axes, parts, "value", values, "ratio", looks, "rows")
        if len(names) == 1:
            axes.containers[0].set_label("")  # the axis label names it
            text: dict[str, Any] = {"color": looks[names[0]].colour, "va": "center", "fontsize": 8.5}
            for row, value in enumerate(frame["ratio"]):
                axes.text(1.01, row, number(value), transform=axes.get_yaxis_transform(), **text)
        row_axis(axes, labels)
        axes.axhline(0.5, color=PALE, linewidth=0.8)
        _ratio_scale(axes, frame[["ratio", "low", "high"]].to_numpy(dtype=np.float64))
        axes.set_xlabel(f"error of {names[0]} ÷ error of {base}" if len(names) == 1 else f"error ÷ error of {base}")

    title = "Ratio of errors by kind of reference"
    rows = {name: list(zip(labels, part["ratio"], strict=True)) for name, part in parts.items()}
    alt = description(f"{title}, relative to {base}", rows, "")
    note = f"Mean error over that of {base} on the same runs; bars: 95 % interval. Left of the line is better."
    return one_panel("ratio", title, note, alt, paint, _height(len(values), len(names)))


def _height(rows: int, controllers: int) -> float:
    return max(HEIGHT, 0.9 + 0.25 * rows * max(1.0, 0.6 * controllers))


def _ratio_scale(axes: Axes, values: Array) -> None:
    finite = np.append(values[np.isfinite(values) & (values > 0.0)], 1.0)
    low, high = float(finite.min()), float(finite.max())
    if high > 3.0 * low:
        axes.set_xscale("log")
        ticks(axes.xaxis, [tick for tick in RATIO_TICKS if 0.8 * low <= tick <= 1.25 * high])
        axes.set_xlim(low / 1.15, high * 1.15)
    else:
        room = max(0.08 * (high - low), 0.02)
        axes.set_xlim(low - room, high + room)
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
