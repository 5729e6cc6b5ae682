"""Drawings of the figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from hydro_agents.report.canvas import GREY, INK, PALE, PAPER, ticks
from hydro_agents.report.palette import COLOURS, LINES, looks_of
from hydro_agents.report.palette import LEAK_LOOKS as LOOKS
from hydro_agents.running.text import number, setting
from hydro_env import resistance_from_flow
from paper.force_rate import DRAWN, DRIVE, TERMS
from paper.loop import NYQUIST
from paper.moves import FIRST_STOP
from paper.rig import FEW_LEAKS, LAWS, LEAKS, TIGHT, VOLTAGE, flow
from paper.settling import FRICTION_SHARES, SCAN_LEAKS, friction_words

ENLARGED = (0.01, 1.0, 4.0)
"""Leaks whose stop is enlarged."""

TIME_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)

MINUS_3_DB = math.sqrt(0.5)


def legend_inside(axes: Axes, **options: Any) -> None:
    """Add a legend with a white background, which covers the lines behind it."""
    axes.legend(**({"fontsize": 8.0, "frameon": True, "framealpha": 0.9, "edgecolor": "none"} | options))


def leak_lines(
    axes: Axes, table: pd.DataFrame, x: str, y: str, leaks: Sequence[float] = LEAKS, unit: float = 1.0, **options: Any
) -> None:
    """A line per leak: column ``y`` times ``unit`` over column ``x``; with a ``markersize``, the leak's marker too."""
    for leak in leaks:
        part, look = table[table["leak_lpm"] == leak], LOOKS[leak]
        marker = look.marker if "markersize" in options else ""
        axes.plot(part[x], unit * part[y], label=flow(leak), marker=marker, **look.stroke, **options)


def paint_displacement(figure: Figure, table: pd.DataFrame) -> None:
    """Draw the whole move, and an enlarged time after the first stop, with and without friction."""
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.25, 1.0])
    frictions = [bool(friction) for friction in table["friction"].unique()]
    whole, panels = parts[0].subplots(), parts[1].subplots(1, len(frictions), sharey=True, squeeze=False)[0]
    first = table[table["friction"] == frictions[0]]
    leak_lines(whole, first, "time_s", "recorded_position_mm", linewidth=1.2)
    command = first[first["leak_lpm"] == TIGHT]
    volts = command["command_v"].abs()
    bottom, top = whole.get_ylim()
    moving = (volts > 0.9 * volts.max()).tolist()
    whole.fill_between(command["time_s"], bottom, top, where=moving, color=INK, alpha=0.06, linewidth=0)
    whole.set(xlabel="time, s", ylabel="recorded position, mm", ylim=(bottom, top), xlim=(0.0, command["time_s"].max()))
    whole.set_title(f"Start–stop moves (grey: valve open, +{VOLTAGE:g} V twice, then −{VOLTAGE:g} V)")
    legend_inside(whole, title="leak at 100 bar", loc="upper right", handlelength=3.0)
    stop, low, high = FIRST_STOP, 0.0, 0.0
    for friction, axes in zip(frictions, panels, strict=True):
        for leak in ENLARGED:
            part = table[(table["leak_lpm"] == leak) & (table["friction"] == friction)]
            time, position = part["time_s"].to_numpy() - stop, part["recorded_position_mm"].to_numpy()
            window = (time >= -0.01) & (time <= 0.15)
            position = position - position[(time > 0.02) & (time < 0.05)].mean()
            axes.plot(1e3 * time[window], position[window], **LOOKS[leak].stroke, linewidth=1.0)
            later = position[window & (time > 0.005)]
            low, high = min(low, float(later.min())), max(high, float(later.max()))
        axes.set(xlabel="time after the first stop command, ms", xlim=(-10, 150))
        axes.set_title(f"After the first stop, {'with' if friction else 'no'} friction")
    panels[0].set_ylim(1.5 * low, 1.15 * high)
    panels[0].set_ylabel("recorded position, mm\n(from where it stopped)")


def paint_settling(figure: Figure, table: pd.DataFrame) -> None:
    """Two laws by friction models; zero-lapped valve and null leakage in colours; signal as points, theory dashed."""
    models, underlaps = list(table["friction"].unique()), list(table["valve_null_leakage"].unique())
    grid = figure.subplots(len(LAWS), len(models), sharex=True, sharey=True, squeeze=False)
    for (row, column), axes in np.ndenumerate(grid):
        law, model = list(LAWS)[row], models[column]
        for look, underlap in zip(looks_of(underlaps).values(), underlaps, strict=True):
            part = table[
                (table["friction"] == model) & (table["valve_null_leakage"] == underlap) & (table["law"] == law)
            ]
            ohm, signal = part["resistance_pa_s_m3"], part["signal_s"]
            axes.plot(ohm, part["clean_s"], color=look.colour)
            spread = [signal - part["signal_low_s"], part["signal_high_s"] - signal]
            axes.errorbar(ohm, signal, yerr=spread, fmt=look.marker, mfc=PAPER, color=look.colour, markersize=4.0)
            if model == "none":
                axes.plot(ohm, part["theory_s"], color=look.colour, linestyle=(0, (4, 2)), linewidth=1.0)
        axes.set(xscale="log", yscale="log")
        ticks(axes.yaxis, TIME_TICKS)
        axes.set_title(f"{LAWS[law]},\n{friction_words(model)}")
        axes.set_xlabel("leakage resistance at 100 bar, Pa s/m³" if row else "")
        axes.set_ylabel("settling time, s" if column == 0 else "")
        for leak in (0.01, 0.1, 1.0, 4.0):  # the same in l/min, along the lower edge
            place, label = resistance_from_flow(leak), flow(leak) if leak == TIGHT else f"{leak:g}"
            axes.axvline(place, color=PALE, linewidth=0.6, zorder=0)
            side = {"ha": "right" if leak == TIGHT else "left", "fontsize": 7.0, "color": GREY}
            axes.annotate(label, (place, 0.02), xycoords=("data", "axes fraction"), **side)
    bottom, top = grid[0, 0].get_ylim()  # room for these labels below the lowest line
    grid[0, 0].set_ylim(bottom * (bottom / top) ** 0.06, top)
    valves = ("zero-lapped valve", "valve with null leakage")[: len(underlaps)]
    handles = [
        *(Line2D([], [], color=look.colour, marker=look.marker, mfc=PAPER, label=valve, markersize=4.0)
          for valve, look in looks_of(valves).items()),
        Line2D([], [], color=INK, label="noise-free"),
        Line2D([], [], color=INK, marker="o", mfc=PAPER, linestyle="none", label="from the accelerometer"),
        Line2D([], [], color=INK, linestyle=(0, (4, 2)), linewidth=1.0, label="linear theory (no friction)"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8.0, columnspacing=1.2)


def paint_force_rate(figure: Figure, table: pd.DataFrame) -> None:
    """Stacked terms with their sum, the leakage terms enlarged, the pressure difference; move and stop."""
    grid = figure.subplots(3, 2, sharex="col", sharey="row", height_ratios=[2.2, 1.2, 1.0])
    part = table[table["leak_lpm"] == DRAWN]
    for column, (start, event) in enumerate(((0.0, "move"), (DRIVE, "stop"))):
        after = 1e3 * (part["time_s"] - start)
        rows = part[(after >= -10) & (after <= 100)]
        time = after[rows.index].to_numpy()
        stack, leaks, difference = grid[:, column]
        _stacked(stack, time, rows)
        stack.set_title("Start of the move" if event == "move" else "Stop")
        for term, colour, line in zip(list(TERMS)[2:], ("green", "purple"), LINES, strict=False):
            leaks.plot(time, 1e-3 * rows[term], color=COLOURS[colour], linestyle=line)
        difference.plot(time, rows["pressure_difference_bar"], color=INK)
        difference.axhline(0.0, color=GREY, linewidth=0.7)
        difference.set_xlabel(f"time after the command to {event}, ms")
        difference.set_xlim(-10, 100)
    labels = ("terms of dF/dt, kN/s", "leakage terms\nalone, kN/s", "P_a − P_b, bar")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    figure.legend(*grid[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8.0)


def _stacked(axes: Axes, time: np.ndarray, rows: pd.DataFrame) -> None:
    """Stack positive parts above zero and negative ones below: upper edge plus lower edge is the sum."""
    above, below = np.zeros(len(rows)), np.zeros(len(rows))
    for colour, hatch, (name, words) in zip(COLOURS.values(), ("", "", "////", "...."), TERMS.items(), strict=False):
        values = 1e-3 * rows[name].to_numpy()
        up, down = np.maximum(values, 0.0), np.minimum(values, 0.0)
        fill: Any = {"facecolor": colour, "alpha": 0.75, "linewidth": 0, "hatch": hatch, "edgecolor": PAPER}
        axes.fill_between(time, above, above + up, label=words, **fill)
        axes.fill_between(time, below, below + down, **fill)
        above, below = above + up, below + down
    axes.plot(time, 1e-3 * rows["sum_n_s"], color=INK, linewidth=1.3, label="sum = dF/dt")


def paint_share(figure: Figure, table: pd.DataFrame) -> None:
    """Share over pressure difference, one panel per law."""
    panels = figure.subplots(1, len(LAWS), sharey=True)
    middle = 0.5 * (table["difference_low_bar"] + table["difference_high_bar"])
    drawn = table.assign(middle_bar=middle, percent=100.0 * table["leakage_share"])
    for axes, law in zip(panels, LAWS, strict=True):
        part = drawn[drawn["law"] == law]
        leak_lines(axes, part, "middle_bar", "percent", FEW_LEAKS, markersize=4.0)
        axes.set(yscale="log", xlabel="size of the pressure difference, bar")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_title(LAWS[law])
    panels[0].set_ylabel("leakage's share of the terms of dF/dt, %")
    handles = panels[0].get_legend_handles_labels()
    figure.legend(
        *handles, title="leak at 100 bar", loc="outside lower center", ncols=4, fontsize=8.0, handlelength=3.0
    )


def paint_closed_bode(figure: Figure, table: pd.DataFrame) -> None:
    """Gain above phase, reference to position."""
    gain, phase = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
    leak_lines(gain, table, "frequency_hz", "gain")
    leak_lines(phase, table, "frequency_hz", "phase_deg")
    lowest = float(table["frequency_hz"].min())
    gain.set(xscale="log", yscale="log", ylabel="gain, mm per mm", xlim=(lowest, NYQUIST))
    phase.set(xlabel="frequency, Hz", ylabel="phase, degrees")
    for axis in (gain.yaxis, phase.xaxis):
        axis.set_major_locator(LogLocator(base=10, numticks=6))
        axis.set_major_formatter(FuncFormatter(lambda value, _: number(value, digits=1)))
        axis.set_minor_formatter(NullFormatter())
    bottom = 90 * int(np.floor(table["phase_deg"].min() / 90))
    ticks(phase.yaxis, range(bottom, 1, 90 if bottom >= -450 else 180))
    gain.set_title("From reference to position, loop closed")
    gain.axhline(MINUS_3_DB, color=GREY, linewidth=0.7, linestyle=(0, (4, 2)))
    gain.annotate("−3 dB", (lowest, MINUS_3_DB), xytext=(3, -9), textcoords="offset points", fontsize=7.5)
    legend_inside(gain, title="leak at 100 bar", loc="lower left", handlelength=3.0)
    figure.align_ylabels()


def paint_friction_scan(figure: Figure, table: pd.DataFrame) -> None:
    """Settling time over friction."""
    axes = figure.subplots()
    positive = [100 * share for share in FRICTION_SHARES if share > 0.0]
    zero = 0.5 * positive[0]
    drawn = table.assign(percent=np.maximum(100 * table["friction_share"], zero))
    leak_lines(axes, drawn, "percent", "settling_s", SCAN_LEAKS, markersize=4)
    axes.set(xscale="log", yscale="log", xlabel="friction, % of what is assumed", ylabel="settling time, s")
    ticks(axes.xaxis, [zero, *positive], lambda value: "0" if value == zero else setting(value))
    low, high = axes.get_ylim()
    ticks(axes.yaxis, [tick for tick in TIME_TICKS if low <= tick <= high])
    axes.set_title("Settling time against friction")
    legend_inside(axes, title="leak at 100 bar", loc="best", handlelength=3.0)
