"""Figures of the bounds: the search for the best found, the bound of a leak, and the test move."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from hydro_agents.estimation.information import TASK
from hydro_agents.estimation.known_windows import KnownWindows
from hydro_agents.estimation.move_design import Move
from hydro_agents.evaluation.leak_bound import ALL_SENSORS
from hydro_agents.evaluation.paired_cases import DRAWN_FAMILIES
from hydro_agents.report.canvas import COLOURS, GREY, WIDE, looks_of, render, row_axis, ticks
from hydro_agents.report.leak_bound import ORDINARY, shown


def convergence_picture(table: pd.DataFrame) -> bytes:
    """A PNG of :func:`convergence`: the error of steps, and of all other families, over each setting."""

    def paint(figure: Figure) -> None:
        settings = list(table["setting"].unique())
        smooth = [name for name in DRAWN_FAMILIES if name in table and name != "step"]
        looks = looks_of(["steps", "other families"])
        panels = figure.subplots(1, len(settings), squeeze=False, sharey=True)[0]
        for place, setting in zip(panels, settings, strict=True):
            rows = table[table["setting"] == setting]
            lines = {"steps": rows.get("step"), "other families": rows[smooth].mean(axis=1) if smooth else None}
            for name, values in lines.items():
                if values is not None:
                    ticks = np.arange(len(rows))
                    place.plot(ticks, 1e3 * values, marker=looks[name].marker, label=name, **looks[name].stroke)
                    place.set_xticks(ticks, rows["value"].astype(str))
            place.set(title=setting.replace("_", " "), yscale="log")
        panels[0].set_ylabel("mean error, µm")
        panels[0].legend(loc="center right")

    return render(paint, (WIDE, 3.0), "png")[0]


def bound_picture(table: pd.DataFrame) -> bytes:
    """A PNG: the bound over the length of the window for each set of unknowns, by sensors, and over the leak."""
    length, leak = shown(table)
    ordinary, whole = table["motion"] == ORDINARY, table["sensors"] == ALL_SENSORS
    window, level, drawn = table["window_s"] == length, table["leakage_flow_lpm"] == leak, table["unknowns"] == TASK

    def paint(figure: Figure) -> None:
        left, centre, right = figure.subplots(1, 3, width_ratios=(1.0, 0.9, 1.0))
        _lines(left, table[ordinary & whole & level], "window_s", "unknowns")
        left.set(xscale="log", xlabel="window, s", title=f"Sets of unknowns (leak of {leak:g} l/min)")
        ticks(left.xaxis, sorted(table["window_s"].unique()))
        _rows_of_sensors(centre, table[ordinary & drawn & window & level])
        centre.set_title(f"Sensors, {length:g} s")
        positive = table["leakage_flow_lpm"] > 0.0  # the axis is logarithmic
        _lines(right, table[whole & drawn & window & positive], "leakage_flow_lpm", "motion")
        right.set(xscale="log", xlabel="leak, l/min at 100 bar", title=f"Motion, {length:g} s")
        ticks(right.xaxis, sorted(table.loc[positive, "leakage_flow_lpm"].unique()))

    return render(paint, (1.5 * WIDE, 4.2), "png")[0]


def _lines(axes: Axes, rows: pd.DataFrame, across: str, by: str) -> None:
    medians = rows.pivot_table("sigma_lpm", across, by, aggfunc="median", sort=False).sort_index()
    for name, look in looks_of(medians.columns).items():
        axes.plot(medians.index, medians[name], marker=look.marker, label=name, **look.stroke)
    axes.set(yscale="log", ylabel="smallest standard deviation, l/min")
    decades(axes.yaxis, medians.min(axis=None), medians.max(axis=None))
    axes.legend(fontsize=7.5)


def _rows_of_sensors(axes: Axes, rows: pd.DataFrame) -> None:
    names = [str(name) for name in rows["sensors"].unique()]
    groups = [rows.loc[rows["sensors"] == name, "sigma_lpm"] for name in names]
    low, median, high = np.array([np.quantile(group, [0.1, 0.5, 0.9]) for group in groups]).T
    axes.errorbar(median, range(len(names)), xerr=[median - low, high - median], fmt="o", color=COLOURS[0])
    row_axis(axes, names)
    axes.set(xscale="log", xlabel="smallest standard deviation, l/min; 10 to 90 % of the plants")
    decades(axes.xaxis, low.min(), high.max())


def decades(axis: Axis, low: float, high: float) -> None:
    """Ticks of a logarithmic axis as plain numbers: 1, 2 and 5 of each decade, or 1 alone where there are many."""
    exponents = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)
    values = np.outer(10.0**exponents, steps).ravel()
    ticks(axis, [float(value) for value in values if 0.8 * low <= value <= 1.25 * high])


def move_picture(move: Move, windows: KnownWindows, table: pd.DataFrame, period: float) -> bytes:
    """A PNG: the move and the measured positions of all test axes, and the bound by motion on each of them."""
    leak = table["leakage_flow_lpm"].max()

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
        time = period * np.arange(windows.signals.shape[2])
        left.plot(time, 1e3 * windows.signals[:, 0].T, color=GREY, linewidth=0.6, alpha=0.6)
        left.plot(time, 1e3 * move.reference(period), color=COLOURS[1], label="reference")
        left.plot([], [], color=GREY, linewidth=0.6, label=f"{windows.count} axes, measured")
        left.set(xlabel="time, s", ylabel="position, mm", title="The test move")
        left.legend()
        rows = table[table["leakage_flow_lpm"] == leak]
        names = list(rows["motion"].unique())
        for place, (name, look) in enumerate(looks_of(names).items()):
            values = rows.loc[rows["motion"] == name, "sigma_lpm"]
            right.plot(values, np.full(len(values), place), look.marker, color=look.colour, alpha=0.5)
            right.plot([values.median()] * 2, [place - 0.3, place + 0.3], color=look.colour, linewidth=2.5)
        row_axis(right, names)
        right.set(xscale="log", xlabel="smallest standard deviation, l/min; bar: median")
        decades(right.xaxis, rows["sigma_lpm"].min(), rows["sigma_lpm"].max())
        right.set_title(f"Bound of a leak of {leak:g} l/min")

    return render(paint, (1.2 * WIDE, 3.4), "png")[0]
