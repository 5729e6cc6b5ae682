"""The figures of the report: tracking errors and single runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from agents.report.canvas import (
    HEIGHT,
    INK,
    PALE,
    Array,
    Look,
    Plot,
    add_legend,
    bars,
    bars_by,
    controllers_of,
    description,
    dodge,
    draw,
    level_axis,
    looks_of,
    one_panel,
    row_axis,
    ticks,
)
from agents.report.text import family_name, number, setting

if TYPE_CHECKING:
    from agents.evaluation.protocol import Evaluation
    from agents.report.report import Example

JUMP = 2e-4
"""m between two samples; a larger change of the reference is a step."""

RATIO_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def tracking_plots(evaluation: Evaluation) -> list[Plot]:
    """Errors over leak and by reference, ratios, worst cases."""
    ratios = (("level", "Ratio of errors by leak size"), ("family", "Ratio of errors by kind of reference"))
    tail = "Mean error of a run, averaged over the worst 5 % of the runs (conditional value at risk)."
    return [
        _by_level(evaluation, "mean", "Mean error by leak size", "Mean over all runs; bars: 95 % interval."),
        _by_family(evaluation),
        *(_ratio_plot(evaluation, *ratio) for ratio in ratios if not evaluation.ratios.empty),
        _by_level(evaluation, "cvar_5_percent", "Worst 5 % of the runs by leak size", tail),
        _by_level(evaluation, "worst", "Worst run by leak size", "Mean error of the single worst run."),
    ]


def _by_level(evaluation: Evaluation, column: str, title: str, note: str) -> Plot:
    frame = evaluation.levels[evaluation.levels["metric"] == "mean_error_mm"]
    looks = looks_of(controllers_of(evaluation))
    levels = sorted({float(level) for level in frame["leakage_flow_lpm"]})
    parts = {name: frame[frame["controller"] == name].sort_values("leakage_flow_lpm") for name in looks}

    def paint(axes: Axes) -> None:
        places = level_axis(axes, levels)
        for index, (name, part) in enumerate(parts.items()):
            look = looks[name]
            x = np.array([places[float(level)] for level in part["leakage_flow_lpm"]])
            x = x + dodge(len(parts), index, 0.025)
            if column == "mean":
                bars(axes, x, part, column, look, name)
            else:
                axes.plot(x, part[column], color=look.colour, marker=look.marker, linestyle=look.line, label=name)
        axes.set_ylabel("error, mm")
        axes.margins(x=0.06)  # no marker is cut at the edge
        _error_scale(axes, _ends(frame, column))

    rows = {
        name: [
            (f"{setting(level)} l/min", value)
            for level, value in zip(part["leakage_flow_lpm"], part[column], strict=True)
        ]
        for name, part in parts.items()
    }
    return one_panel(f"level-{column}", title, note, description(title, rows, " mm"), paint)


def _by_family(evaluation: Evaluation) -> Plot:
    frame = evaluation.families[evaluation.families["metric"] == "mean_error_mm"]
    looks = looks_of(controllers_of(evaluation))
    families = [str(family) for family in frame["family"].unique()]
    labels = [family_name(family) for family in families]
    parts = {name: frame[frame["controller"] == name] for name in looks}

    def paint(axes: Axes) -> None:
        bars_by(axes, parts, "family", families, "mean", looks, "rows")
        row_axis(axes, labels)
        axes.set_xlabel("mean error, mm")
        _error_scale(axes, _ends(frame, "mean"), "x")

    title, note = "Mean error by kind of reference", "Mean over all leak sizes; bars: 95 % interval."
    rows = {name: list(zip(labels, part["mean"], strict=True)) for name, part in parts.items()}
    return one_panel("family", title, note, description(title, rows, " mm"), paint, _height(len(families), len(parts)))


def _ends(frame: pd.DataFrame, column: str) -> Array:
    """Values that the scale must show: those of a column, and the intervals of means."""
    columns = ["mean", "low", "high"] if column == "mean" else [column]
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


def _ratio_plot(evaluation: Evaluation, group: str, title: str) -> Plot:
    frame = evaluation.ratios[evaluation.ratios["group"].isin(["all", group])]
    looks = looks_of(controllers_of(evaluation))
    base, names = str(frame["against"].iloc[0]), [str(name) for name in frame["controller"].unique()]
    values = list(dict.fromkeys(str(value) for value in frame["value"]))
    labels = [_row_label(group, value) for value in values]
    parts = {name: frame[frame["controller"] == name] for name in names}

    def paint(axes: Axes) -> None:
        axes.axvline(1.0, color=INK, linewidth=1.0)
        bars_by(axes, parts, "value", values, "ratio", looks, "rows")
        if len(names) == 1:
            axes.containers[0].set_label("")  # the axis names it: no legend
            text: dict[str, Any] = {"color": looks[names[0]].colour, "va": "center", "fontsize": 8.5}
            for row, value in enumerate(frame["ratio"]):
                axes.text(1.01, row, number(value), transform=axes.get_yaxis_transform(), **text)
        row_axis(axes, labels)
        axes.axhline(0.5, color=PALE, linewidth=0.8)
        _ratio_scale(axes, frame[["ratio", "low", "high"]].to_numpy(dtype=np.float64))
        axes.set_xlabel(f"error of {names[0]} ÷ error of {base}" if len(names) == 1 else f"error ÷ error of {base}")
        axes.set_ylabel("leak, l/min" if group == "level" else "")

    rows = {name: list(zip(labels, part["ratio"], strict=True)) for name, part in parts.items()}
    alt = description(f"{title}, relative to {base}", rows, "")
    note = f"Mean error over that of {base} on the same runs; bars: 95 % interval. Left of the line is better."
    return one_panel(f"ratio-{group}", title, note, alt, paint, _height(len(values), len(names)))


def _row_label(group: str, value: str) -> str:
    if value == "":
        return "all runs"
    return f"{float(value):g}" if group == "level" else family_name(value)


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


def example_plot(example: Example, key: int, looks: Mapping[str, Look]) -> Plot:
    """Position and reference, error in mm, command in V of one episode under every controller."""
    names = list(example.position)
    jumps = example.time[1:][np.abs(np.diff(example.reference)) > JUMP]

    def paint(figure: Figure) -> None:
        above, middle, below = panels = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.5, 1.2])
        for axes in panels if example.preview > 0.0 else ():
            for jump in jumps:
                axes.axvspan(jump - example.preview, jump, color=PALE, linewidth=0.0)
        above.plot(example.time, 1e3 * example.reference, color=INK, linewidth=1.0, label="reference")
        for name in names:
            look = looks[name]
            above.plot(example.time, 1e3 * example.position[name], label=name, linewidth=1.2, **look.stroke)
            middle.plot(example.time, 1e3 * (example.reference - example.position[name]), linewidth=1.2, **look.stroke)
            below.plot(example.time, 10.0 * example.command[name], linewidth=0.9, **look.stroke)
        middle.axhline(0.0, color=INK, linewidth=0.6)
        above.set_ylabel("position, mm")
        middle.set_ylabel("error, mm")
        below.set(ylabel="command, V", xlabel="time, s", ylim=(-10.8, 10.8), yticks=[-10, 0, 10])
        below.set_xlim(0.0, float(example.time[-1]))
        for axes in (above, middle):
            axes.yaxis.set_major_locator(MaxNLocator(5))
        figure.align_ylabels()
        add_legend(above)

    errors = [
        f"{name} {number(1e3 * float(np.mean(np.abs(example.reference - example.position[name]))))} mm"
        for name in names
    ]
    note = f"Mean error of this run: {', '.join(errors)}."
    if len(jumps) and example.preview > 0.0:
        note += (
            f" Grey: a preview shows the step {setting(1e3 * example.preview)} ms ahead; a controller may start then."
        )
    alt = f"Position, error and valve command over time: {example.title}. {note}"
    return Plot(example.title[:1].upper() + example.title[1:], note, alt, draw(f"example-{key}", alt, paint, 4.6))
