"""Drawings of further figures beside the paper's: maps, frequency responses, stability, holding, sensitivity."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from hydro_agents.report.canvas import COLOURS, GREY, INK, PAPER, legend_inside, log_leak_axis, looks_of, ticks
from hydro_agents.report.leaks import FINE_ABOVE, LEVELS, SCAN
from hydro_agents.report.text import number, setting
from paper.closed_loop import GAIN_MARGIN
from paper.frequency import NYQUIST
from paper.pictures import TIME_TICKS, leak_lines
from paper.results import RESULTS
from paper.rig import LAWS, SHORT_LAWS, Rig
from paper.sensitivity import effects
from paper.settling import FRICTION_SHARES

ROUND = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
SHARES_OF_MAP = (0.1, 0.3, 0.5, 0.65, 0.8, 0.92)
WIDE_RANGE = 5.0
"""Ratio of largest to smallest value above which contours have round numbers of each decade."""

DEEPEST = 0.5
"""Largest opacity of a shade; the background of the page, light or dark, shows through."""

SHOWN = 20
"""Parameters in the picture of the sensitivities."""

MINUS_3_DB = math.sqrt(0.5)


def contour_levels(values: NDArray[np.float64]) -> tuple[float, ...]:
    """Values of the contours: round numbers, or numbers of two digits that divide the map into similar shares."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high > WIDE_RANGE * low:
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        levels = [factor * 10.0**decade for decade in decades for factor in ROUND]
    else:
        levels = sorted({float(f"{level:.2g}") for level in np.nanquantile(values, SHARES_OF_MAP)})
    return tuple(level for level in levels if low < level < high) or (0.5 * (low + high),)


def paint_maps(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """Two maps with labelled contours."""
    titles = {"natural_frequency_hz": "Natural frequency, Hz", "damping_ratio": "Damping ratio"}
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (column, title), colour in zip(panels, titles.items(), COLOURS, strict=False):
        grid = table.pivot(index="leak_lpm", columns="position_mm", values=column)
        values = np.ma.masked_invalid(grid.to_numpy())
        levels = contour_levels(grid.to_numpy())
        axes.grid(visible=False)
        shades = [(colour, share) for share in np.linspace(0.0, DEEPEST, len(levels) + 1)]
        axes.contourf(grid.columns, grid.index, values, levels=levels, colors=shades, extend="both")
        lines = axes.contour(grid.columns, grid.index, values, levels=levels, colors=INK, linewidths=0.8)
        for label in axes.clabel(lines, fontsize=8, fmt="%g", inline=False, colors=INK):
            # Labels along the contours could be upside down.
            label.set(rotation=0.0, path_effects=[withStroke(linewidth=2.5, foreground=PAPER)])
        axes.set(yscale="log", xlabel="position, mm (0 = mid-stroke, + = extending)")
        ticks(axes.yaxis, (0.01, 0.1, 1.0, 4.0))
        axes.set_title(title)
    panels[0].set_ylabel("leak, l/min at 100 bar")


def _gain_and_phase(figure: Figure, table: pd.DataFrame, column: str, unit: str, title: str) -> tuple[Axes, Axes]:
    """Two panels with a line per leak: a column of gains, and ``phase_deg``, over ``frequency_hz``."""
    gain, phase = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
    leak_lines(gain, table, "frequency_hz", column)
    leak_lines(phase, table, "frequency_hz", "phase_deg")
    gain.set(xscale="log", yscale="log", ylabel=f"gain, {unit}")
    phase.set(xlabel="frequency, Hz", ylabel="phase, degrees")
    gain.set_xlim(table["frequency_hz"].min(), table["frequency_hz"].max())
    for axis in (gain.yaxis, phase.xaxis):
        axis.set_major_locator(LogLocator(base=10, numticks=6))
        axis.set_major_formatter(FuncFormatter(lambda value, _: number(value, digits=1)))
        axis.set_minor_formatter(NullFormatter())
    gain.set_title(title)
    legend_inside(gain, title="leak at 100 bar", loc="lower left", handlelength=3.0)
    figure.align_ylabels()
    return gain, phase


def paint_bode(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """Gain above phase, valve command to position."""
    _, phase = _gain_and_phase(figure, table, "gain_mm_per_v", "mm per V", "From valve command to position")
    ticks(phase.yaxis, range(-450, 1, 90))


def paint_closed_bode(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """Gain above phase, reference to position."""
    gain, phase = _gain_and_phase(figure, table, "gain", "mm per mm", "From reference to position, loop closed")
    gain.axhline(MINUS_3_DB, color=GREY, linewidth=0.7, linestyle=(0, (4, 2)))
    start = (float(table["frequency_hz"].min()), MINUS_3_DB)
    gain.annotate("−3 dB", start, xytext=(3, -9), textcoords="offset points", fontsize=7.5)
    gain.set_xlim(right=NYQUIST)
    lowest = 90 * int(np.floor(table["phase_deg"].min() / 90))
    ticks(phase.yaxis, range(lowest, 1, 90 if lowest >= -450 else 180))


def paint_stability(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """The limits at several positions for both laws; bandwidth and settling time with the gain margin."""
    grid = figure.subplots(2, 2, sharex=True)
    looks = looks_of(sorted(table["position_mm"].unique())[::2])
    for axes, law in zip(grid[0], LAWS, strict=True):
        for position, look in looks.items():
            part = table[(table["law"] == law) & (table["position_mm"] == position)]
            label = f"{number(position, 0, signed=True)} mm"
            axes.plot(part["leak_lpm"], part["limit_per_m"], color=look.colour, marker=look.marker, ms=4, label=label)
            rule = part["continuous_limit_per_m"]
            axes.plot(part["leak_lpm"], rule, color=look.colour, linestyle=(0, (2, 2)), linewidth=0.9)
        axes.set(yscale="log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if str(value)[0] in "25" else "")
        axes.tick_params(axis="y", which="minor", labelsize=7.5)
        axes.set_title(f"Largest stable gain, {SHORT_LAWS[law].lower()}")
    ends = [axes.get_ylim() for axes in grid[0]]
    for axes in grid[0]:
        axes.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
    grid[0, 0].set_ylabel("command per metre (1 = 10 V)")
    laminar = table[table["law"] == "laminar"]
    speeds = {"bandwidth_hz": ("Bandwidth", "bandwidth, Hz"), "settling_s": ("Settling time", "settling to 2 %, s")}
    for axes, (column, (title, label)) in zip(grid[1], speeds.items(), strict=True):
        for position, look in looks.items():
            part = laminar[laminar["position_mm"] == position]
            axes.plot(part["leak_lpm"], part[column], color=look.colour, marker=look.marker, ms=4)
        axes.set(ylim=(0.0, 1.1 * np.nanmax(laminar[column])), ylabel=label)
        axes.set_title(f"{title} at 1/{GAIN_MARGIN:g} of the limit, laminar leak")
        log_leak_axis(axes, [leak for leak in FINE_ABOVE if leak not in (0.5, 3.0)])
    figure.legend(
        *grid[0, 0].get_legend_handles_labels(),
        title="position (dotted: rule 2 ζ ω, no sampling, ideal valve)",
        title_fontsize=8.5,
        loc="outside upper center",
        ncols=len(looks),
        fontsize=8.0,
    )


def paint_holding(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """Error over leak."""
    axes = figure.subplots()
    for name, look in looks_of(("P", "PI", "PID")).items():
        part, size = table[table["controller"] == name], 4.0 if name == "PID" else 7.0
        axes.plot(part["leak_lpm"], part["error_mm"], **look.stroke, marker=look.marker, markersize=size, label=name)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set_ylabel("remaining error, mm")
    log_leak_axis(axes, LEVELS, "leak (throttle in parallel), l/min at 100 bar")
    axes.set_title("Remaining error while holding")
    legend_inside(axes, loc="best")


def paint_energy(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """Power while holding; energy of a cycle."""
    left, right = figure.subplots(1, 2)
    looks = looks_of(("first", "second", "cycle"))
    for law, line in zip(LAWS, ("-", "--"), strict=True):
        part = table[table["law"] == law]
        for name in ("first", "second"):
            # The first place is drawn wider: both stay visible where they are equal.
            style = {"linestyle": line, "color": looks[name].colour, "linewidth": 2.8 if name == "first" else 1.2}
            label = f"{number(part[f'{name}_place_mm'].iloc[0], 0, signed=True)} mm, {law}"
            left.plot(
                part["leak_lpm"], part[f"holding_{name}_w"], label=label, marker=looks[name].marker, ms=3, **style
            )
        right.plot(part["leak_lpm"], part["cycle_j"], color=looks["cycle"].colour, linestyle=line, marker="o", ms=3)
        right.lines[-1].set_label(law)
    columns = (["holding_first_w", "holding_second_w"], ["cycle_j"])
    for axes, values, what, title in zip(
        (left, right), columns, ("power", "energy"), ("While holding", "One start–stop cycle"), strict=True
    ):
        axes.set_ylim(0.0, 1.6 * float(table[values].max().max()))
        axes.set_ylabel(f"{what} from the supply, {'W' if what == 'power' else 'J'}")
        log_leak_axis(axes, LEVELS)
        axes.set_title(title)
        legend_inside(axes, loc="upper left", handlelength=3.5)


def paint_friction_scan(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """Settling time over friction."""
    axes = figure.subplots()
    positive = [100 * share for share in FRICTION_SHARES if share > 0.0]
    zero = 0.5 * positive[0]
    drawn = table.assign(percent=np.maximum(100 * table["friction_share"], zero))
    leak_lines(axes, drawn, "percent", "settling_s", SCAN, markersize=4)
    axes.set(xscale="log", yscale="log", xlabel="friction, % of what is assumed", ylabel="settling time, s")
    ticks(axes.xaxis, [zero, *positive], lambda value: "0" if value == zero else setting(value))
    low, high = axes.get_ylim()
    ticks(axes.yaxis, [tick for tick in TIME_TICKS if low <= tick <= high])
    axes.set_title("Settling time against friction")
    legend_inside(axes, title="leak at 100 bar", loc="best", handlelength=3.0)


def paint_sensitivity(figure: Figure, table: pd.DataFrame, rig: Rig) -> None:
    """A table of effects: the darker, the more the result changes."""
    grid = effects(table).head(SHOWN)
    axes = figure.subplots()
    words = {result.name: result.words for result in RESULTS}
    values = np.nan_to_num(grid.to_numpy(), nan=0.0)
    norm = LogNorm(vmin=0.5, vmax=100.0, clip=True)
    shade = DEEPEST * np.asarray(norm(np.maximum(values, 0.5)))
    for (row, column), share in np.ndenumerate(shade):
        axes.add_patch(Rectangle((column, row), 1.0, 1.0, facecolor=COLOURS[0], alpha=float(share), linewidth=0))
    axes.set(xlim=(0, values.shape[1]), ylim=(values.shape[0], 0))
    for (row, column), value in np.ndenumerate(values):
        text = f"{value:.0f}" if value >= 10.0 else f"{value:.1f}" if value >= 0.1 else "·"
        axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", fontsize=7.5)
    axes.set_yticks(np.arange(len(grid)) + 0.5, [name.replace(".", ": ").replace("_", " ") for name in grid.index])
    axes.set_xticks(np.arange(grid.shape[1]) + 0.5, [words[name] for name in grid.columns], rotation=38, ha="left")
    axes.xaxis.tick_top()
    axes.set_xlabel("largest change of the result, %; · below 0.1 %")
    axes.xaxis.set_label_position("bottom")
    axes.tick_params(length=0)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
