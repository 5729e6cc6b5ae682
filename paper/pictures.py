"""Drawings of the figures: each function gets a table and returns the panels."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hydro_agents.report.kit import GREY, INK, WIDE, figure_of
from hydro_agents.running.text import setting
from paper.force_rate import DRAWN, DRIVE, TERMS
from paper.loop import NYQUIST
from paper.moves import FIRST_STOP
from paper.rig import FEW_LEAKS, LAWS, LEAKS, VOLTAGE, flow
from paper.settling import friction_words

ENLARGED = (0.01, 1.0, 4.0)  # leaks whose stop is enlarged
SECONDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def grid(rows: int, columns: int, height: float, **options: Any) -> Any:
    """Panels (rows, columns) as wide as the page; height in inches, ``options`` of ``subplots``."""
    figure = Figure(figsize=(WIDE, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure.subplots(rows, columns, squeeze=False, **options)


def legend_below(panels: Sequence[Axes], columns: int) -> list[Axes]:
    """One legend of the first panel's lines below all panels, which need no own one; returns the panels."""
    handles, labels = panels[0].get_legend_handles_labels()
    figure_of(panels).legend(handles, labels, loc="outside lower center", ncols=columns)
    for axes in panels:
        artists: list[Any] = [*axes.lines, *axes.collections, *axes.containers]
        for artist in artists:
            artist.set_label("_none")
    return list(panels)


def leak_lines(
    axes: Axes, table: pd.DataFrame, x: str, y: str, leaks: Sequence[float] = LEAKS, mark: bool = False
) -> None:
    """A line per leak: column ``y`` over column ``x``."""
    for index, leak in enumerate(leaks):
        part = table[table["leak_lpm"] == leak]
        (line,) = axes.plot(part[x], part[y], label=f"leak {flow(leak)}", color=f"C{index}")
        if not mark:
            line.set_marker("")


def paint_displacement(table: pd.DataFrame) -> list[Axes]:
    """The whole move, and an enlarged time after the first stop, with and without friction."""
    panels = list(grid(3, 1, 7.5)[:, 0])
    leak_lines(panels[0], table[table["friction"]], "time_s", "recorded_position_mm")
    panels[0].set(xlabel="time, s", ylabel="recorded position, mm")
    panels[0].text(0.0, 1.0, f"valve +{VOLTAGE:g} V twice, then −{VOLTAGE:g} V", transform=panels[0].transAxes)
    for friction, axes in zip((True, False), panels[1:], strict=True):
        for leak in ENLARGED:
            part = table[(table["leak_lpm"] == leak) & (table["friction"] == friction)]
            time, position = part["time_s"].to_numpy() - FIRST_STOP, part["recorded_position_mm"].to_numpy()
            position = position - position[(time > 0.02) & (time < 0.05)].mean()
            window = (time >= 0.005) & (time <= 0.15)
            axes.plot(1e3 * time[window], position[window], color=f"C{LEAKS.index(leak)}", marker="", linewidth=1.0)
        axes.set(xlabel="time after the first stop command, ms", ylabel="from where it\nstopped, mm")
        axes.set_title(f"{'With' if friction else 'Without'} friction")
    return panels


def paint_settling(table: pd.DataFrame) -> list[Axes]:
    """Two laws by friction models; the theory is dotted."""
    models = list(table["friction"].unique())
    panels = grid(len(LAWS), len(models), 6.0, sharex=True, sharey=True)
    for (row, column), axes in np.ndenumerate(panels):
        law, model = list(LAWS)[row], models[column]
        shown = table[(table["friction"] == model) & (table["law"] == law)]
        for colour, (underlap, part) in zip(("C0", "C1"), shown.groupby("valve_null_leakage"), strict=False):
            label = "valve with null leakage" if underlap else "zero-lapped valve"
            lines = {"clean_s": ("-", "noise-free"), "theory_s": (":", "linear theory")}
            for name, (style, words) in lines.items():
                if part[name].notna().any():
                    axes.plot(
                        part["resistance_pa_s_m3"], part[name], style + colour, marker="", label=f"{label}, {words}"
                    )
        axes.set(xscale="log", yscale="log", title=f"{LAWS[law]},\n{friction_words(model)}")
        axes.set_yticks(SECONDS, [setting(tick) for tick in SECONDS])
        axes.set_xlabel("leakage resistance at 100 bar, Pa s/m³" if row else "")
        axes.set_ylabel("" if column else "settling time, s")
    return legend_below(list(panels.flat), 2)


def paint_force_rate(table: pd.DataFrame) -> list[Axes]:
    """Stacked terms with their sum, the leakage terms alone, the pressure difference; move and stop."""
    panels = grid(3, 2, 6.8, sharex="col", sharey="row", height_ratios=[2.2, 1.2, 1.0])
    part = table[table["leak_lpm"] == DRAWN]
    for column, (start, event) in enumerate(((0.0, "move"), (DRIVE, "stop"))):
        after = 1e3 * (part["time_s"] - start)
        rows = part[(after >= -10) & (after <= 100)]
        time = after[rows.index].to_numpy()
        stack, leaks, difference = panels[:, column]
        _stacked(stack, time, rows)
        for index, term in enumerate(TERMS):
            if term.endswith("leakage_n_s"):
                leaks.plot(time, 1e-3 * rows[term], color=f"C{index}", marker="", linestyle="-")
        difference.plot(time, rows["pressure_difference_bar"], color=INK, marker="")
        difference.set_xlabel(f"time after the command to {event}, ms")
    labels = ("terms of dF/dt, kN/s", "leakage terms\nalone, kN/s", "P_a − P_b, bar")
    for axes, label in zip(panels[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    return legend_below(list(panels.flat), 5)


def _stacked(axes: Axes, time: np.ndarray, rows: pd.DataFrame) -> None:
    """Stack positive parts above zero and negative ones below: upper edge plus lower edge is the sum."""
    above, below = np.zeros(len(rows)), np.zeros(len(rows))
    for index, (name, words) in enumerate(TERMS.items()):
        values = 1e-3 * rows[name].to_numpy()
        up, down = np.maximum(values, 0.0), np.minimum(values, 0.0)
        axes.fill_between(time, above, above + up, label=words, facecolor=f"C{index}", alpha=0.75)
        axes.fill_between(time, below, below + down, facecolor=f"C{index}", alpha=0.75)
        above, below = above + up, below + down
    axes.plot(time, 1e-3 * rows["sum_n_s"], color=INK, linewidth=1.3, marker="", linestyle="-", label="sum = dF/dt")


def paint_share(table: pd.DataFrame) -> list[Axes]:
    """Share over pressure difference, one panel per law."""
    panels = list(grid(1, len(LAWS), 3.6, sharey=True)[0])
    middle = 0.5 * (table["difference_low_bar"] + table["difference_high_bar"])
    drawn = table.assign(middle_bar=middle, percent=100.0 * table["leakage_share"])
    for axes, law in zip(panels, LAWS, strict=True):
        leak_lines(axes, drawn[drawn["law"] == law], "middle_bar", "percent", FEW_LEAKS, mark=True)
        axes.set(yscale="log", xlabel=f"{LAWS[law]}: size of the pressure difference, bar")
    panels[0].set_ylabel("leakage's share of the terms of dF/dt, %")
    return legend_below(panels, 4)


def paint_closed_bode(table: pd.DataFrame) -> list[Axes]:
    """Gain above phase, reference to position."""
    gain, phase = grid(2, 1, 5.0, sharex=True)[:, 0]
    leak_lines(gain, table, "frequency_hz", "gain")
    leak_lines(phase, table, "frequency_hz", "phase_deg")
    gain.set(xscale="log", yscale="log", ylabel="gain, mm per mm", xlim=(table["frequency_hz"].min(), NYQUIST))
    gain.axhline(math.sqrt(0.5), color=GREY, linewidth=0.7)
    phase.set(xlabel="frequency, Hz", ylabel="phase, degrees")
    return legend_below([gain, phase], 5)
