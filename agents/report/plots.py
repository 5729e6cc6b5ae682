"""The figures of the report: tracking errors, single runs, training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator, NullLocator

from agents.report.canvas import (
    FAMILY_NAMES,
    HEIGHT,
    INK,
    PALE,
    Array,
    Look,
    Plot,
    add_legend,
    bars,
    controllers_of,
    description,
    dodge,
    draw,
    level_axis,
    looks_of,
    row_axis,
)

if TYPE_CHECKING:
    from agents.evaluation.protocol import Evaluation
    from agents.report.report import Example

RATIO_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def tracking_plots(evaluation: Evaluation) -> list[Plot]:
    """Errors over leak and by reference, ratios, worst cases."""
    tail = "Mean error of a run, averaged over the worst 5 % of the runs (conditional value at risk)."
    return [
        _by_level(evaluation, "mean", "Mean error by leak size", "Mean over all runs; bars: 95 % interval."),
        _by_family(evaluation),
        *_ratio_plots(evaluation),
        _by_level(evaluation, "cvar_5_percent", "Worst 5 % of the runs by leak size", tail),
        _by_level(evaluation, "worst", "Worst run by leak size", "Mean error of the single worst run."),
    ]


def _by_level(evaluation: Evaluation, column: str, title: str, note: str) -> Plot:
    frame = evaluation.levels[evaluation.levels["metric"] == "mean_error_mm"]
    looks = looks_of(controllers_of(evaluation))
    levels = sorted({float(level) for level in frame["leakage_flow_lpm"]})
    parts = {name: frame[frame["controller"] == name].sort_values("leakage_flow_lpm") for name in looks}

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
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
        _error_scale(axes, _ends(frame, column))
        add_legend(axes)

    rows = {
        name: [(f"{level:g} l/min", value) for level, value in zip(part["leakage_flow_lpm"], part[column], strict=True)]
        for name, part in parts.items()
    }
    alt = description(title, rows, " mm")
    return Plot(title, note, alt, draw(f"level-{column}", alt, paint))


def _by_family(evaluation: Evaluation) -> Plot:
    frame = evaluation.families[evaluation.families["metric"] == "mean_error_mm"]
    looks = looks_of(controllers_of(evaluation))
    families = [str(family) for family in frame["family"].unique()]
    labels = [FAMILY_NAMES.get(family, family) for family in families]
    parts = {name: frame[frame["controller"] == name] for name in looks}

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        for index, (name, part) in enumerate(parts.items()):
            rows = np.array([families.index(str(family)) for family in part["family"]])
            bars(
                axes,
                rows + dodge(len(parts), index, min(0.2, 0.7 / len(parts))),
                part,
                "mean",
                looks[name],
                name,
                "rows",
            )
        row_axis(axes, labels)
        axes.set_xlabel("mean error, mm")
        _error_scale(axes, _ends(frame, "mean"), "x")
        add_legend(axes)

    title = "Mean error by kind of reference"
    alt = description(
        title, {name: list(zip(labels, part["mean"], strict=True)) for name, part in parts.items()}, " mm"
    )
    note = "Mean over all leak sizes; bars: 95 % interval."
    return Plot(title, note, alt, draw("family", alt, paint, _height(len(families), len(parts))))


def _ends(frame: pd.DataFrame, column: str) -> Array:
    """What must be seen of a column: its values, and the intervals of means."""
    columns = ["mean", "low", "high"] if column == "mean" else [column]
    values: Array = frame[columns].to_numpy(dtype=np.float64).ravel()
    return values


def _error_scale(axes: Axes, values: Array, which: str = "y") -> None:
    """From zero, unless the values differ so much that only a logarithm shows them."""
    positive = values[values > 0.0]
    if len(positive) and positive.max() > 20.0 * positive.min():
        axes.set(**{f"{which}scale": "log"})
        axis = axes.yaxis if which == "y" else axes.xaxis
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_label_text(f"{axis.get_label_text()} (logarithmic)")
    else:
        axes.set(**{f"{which}lim": (0.0, None)})


def _ratio_plots(evaluation: Evaluation) -> list[Plot]:
    if evaluation.ratios.empty:
        return []
    return [
        _ratio_plot(evaluation, "level", "Ratio of errors by leak size"),
        _ratio_plot(evaluation, "family", "Ratio of errors by kind of reference"),
    ]


def _ratio_plot(evaluation: Evaluation, group: str, title: str) -> Plot:
    frame = evaluation.ratios[evaluation.ratios["group"].isin(["all", group])]
    looks = looks_of(controllers_of(evaluation))
    base, names = str(frame["against"].iloc[0]), [str(name) for name in frame["controller"].unique()]
    values = list(dict.fromkeys(str(value) for value in frame["value"]))
    labels = [_row_label(group, value) for value in values]
    parts = {name: frame[frame["controller"] == name] for name in names}

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.axvline(1.0, color=INK, linewidth=1.0)
        for index, (name, part) in enumerate(parts.items()):
            rows = np.array([values.index(str(value)) for value in part["value"]]) + dodge(
                len(names), index, min(0.2, 0.7 / len(names))
            )
            bars(axes, rows, part, "ratio", looks[name], name, "rows")
            if len(names) == 1:
                text: dict[str, Any] = {"color": looks[name].colour, "va": "center", "fontsize": 8.5}
                for row, value in zip(rows, part["ratio"], strict=True):
                    axes.text(1.01, row, f"{value:.2f}", transform=axes.get_yaxis_transform(), **text)
        row_axis(axes, labels)
        axes.axhline(0.5, color=PALE, linewidth=0.8)
        _ratio_scale(axes, frame[["ratio", "low", "high"]].to_numpy(dtype=np.float64))
        axes.set_xlabel(f"error of {names[0]} ÷ error of {base}" if len(names) == 1 else f"error ÷ error of {base}")
        axes.set_ylabel("leak, l/min" if group == "level" else "")
        if len(names) > 1:
            add_legend(axes)

    rows = {name: list(zip(labels, part["ratio"], strict=True)) for name, part in parts.items()}
    alt = description(f"{title}, relative to {base}", rows, "")
    note = f"Mean error over that of {base} on the same runs; bars: 95 % interval. Left of the line is better."
    return Plot(title, note, alt, draw(f"ratio-{group}", alt, paint, _height(len(values), len(names))))


def _row_label(group: str, value: str) -> str:
    if value == "":
        return "all runs"
    return f"{float(value):g}" if group == "level" else FAMILY_NAMES.get(value, value)


def _height(rows: int, controllers: int) -> float:
    return max(HEIGHT, 0.9 + 0.25 * rows * max(1.0, 0.6 * controllers))


def _ratio_scale(axes: Axes, values: Array) -> None:
    finite = np.append(values[np.isfinite(values) & (values > 0.0)], 1.0)
    low, high = float(finite.min()), float(finite.max())
    if high > 3.0 * low:
        ticks = [tick for tick in RATIO_TICKS if 0.8 * low <= tick <= 1.25 * high]
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(ticks))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(low / 1.15, high * 1.15)
    else:
        room = max(0.08 * (high - low), 0.02)
        axes.set_xlim(low - room, high + room)
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))


def example_plot(example: Example, number: int, looks: Mapping[str, Look]) -> Plot:
    """Position and reference, error in mm, command in V of one episode under every controller."""
    names = list(example.position)

    def paint(figure: Figure) -> None:
        above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.5, 1.2])
        above.plot(example.time, 1e3 * example.reference, color=INK, linewidth=1.0, label="reference")
        for name in names:
            look = looks[name]
            line: dict[str, Any] = {"color": look.colour, "linewidth": 1.2, "linestyle": look.line}
            above.plot(example.time, 1e3 * example.position[name], label=name, **line)
            middle.plot(example.time, 1e3 * (example.reference - example.position[name]), **line)
            below.plot(example.time, 10.0 * example.command[name], **(line | {"linewidth": 0.9}))
        middle.axhline(0.0, color=INK, linewidth=0.6)
        above.set_ylabel("position, mm")
        middle.set_ylabel("error, mm")
        below.set_ylabel("command, V")
        below.set_xlabel("time, s")
        below.set_ylim(-10.8, 10.8)
        below.set_yticks([-10, 0, 10])
        below.set_xlim(0.0, float(example.time[-1]))
        for axes in (above, middle):
            axes.yaxis.set_major_locator(MaxNLocator(5))
        figure.align_ylabels()
        add_legend(above)

    errors = [
        f"{name} {1e3 * float(np.mean(np.abs(example.reference - example.position[name]))):.3g} mm" for name in names
    ]
    note = f"Mean error of this run: {', '.join(errors)}."
    alt = f"Position, error and valve command over time: {example.title}. {note}"
    return Plot(example.title[:1].upper() + example.title[1:], note, alt, draw(f"example-{number}", alt, paint, 4.6))


def training_plot(curve: pd.DataFrame) -> Plot | None:
    """Mean reward over training steps; ``None`` without a curve."""
    curve = curve.dropna(subset=["mean_reward"]) if "mean_reward" in curve else curve
    if curve.empty:
        return None
    steps, reward = (curve[name].to_numpy(dtype=np.float64) for name in ("steps", "mean_reward"))
    factor, unit = (1e6, "million steps") if steps.max() >= 1e6 else (1e3, "thousand steps")

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot(steps / factor, reward, color=INK, linewidth=1.2)
        axes.set_xlim(left=0.0)
        axes.set_xlabel(f"training, {unit}")
        axes.set_ylabel("mean reward")

    title = "Reward while learning"
    alt = f"{title}: from {reward[0]:.3g} at the start to {reward[-1]:.3g} after {steps[-1] / factor:.3g} {unit}."
    note = "Higher is better; zero would be perfect tracking without effort. Measured on training plants."
    return Plot(title, note, alt, draw("training", alt, paint))
