"""Drawing of all figures: one style, one palette, and the same SVG and PNG on every machine.

Each controller has the same colour, marker and line in all figures. The same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, ClassVar

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import NDArray

from hydro_agents.report.hover import name_categories, with_values
from hydro_agents.report.palette import NEUTRALS, Look, themed
from hydro_agents.running.text import number, setting

Array = NDArray[np.floating[Any]]

WIDTH, HEIGHT = 4.6, 3.0
"""inches; 440 pixels, about the width of a phone, so that text keeps its size there."""

WIDE = 8.6
"""inches; a figure of several panels side by side."""

INK, GREY, PALE, PAPER = (NEUTRALS[name].light for name in ("ink", "grey", "line", "paper"))

MOST_POINTS = 4000
"""Largest number of points of a line of samples; a longer one shows the lowest and highest value of each stretch."""

STYLE: Any = {
    "svg.hashsalt": "hydro_env",
    "svg.fonttype": "path",  # letters as outlines: the browser needs no font
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "text.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": PALE,
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "legend.columnspacing": 1.4,
    "legend.borderpad": 0.2,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.0,
    "errorbar.capsize": 2.5,
}


@dataclass(frozen=True)
class Plot:
    """A figure of a page, with title, note and description."""

    kind: ClassVar[str] = "plot"

    key: str  # name of its file
    title: str
    note: str  # how to read it
    alt: str  # description for readers who cannot see it
    svg: str  # element of the page, in the colours of the reader's theme
    file: bytes  # SVG in light colours
    wide: bool = False  # as wide as the page


def render(paint: Callable[[Figure], None], size: tuple[float, float], *kinds: str) -> list[bytes]:
    """Files (``svg``, ``png``) of a figure of a size (inches) that ``paint`` draws."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        paint(figure)
        files = []
        for kind in kinds:
            file = io.BytesIO()
            nothing: dict[str, Any] = dict.fromkeys(
                ("Date", "Creator", "Format", "Type") if kind == "svg" else ["Software"]
            )
            figure.savefig(file, format=kind, dpi=120, metadata=nothing, facecolor=PAPER)
            files.append(with_values(file.getvalue(), figure) if kind == "svg" else file.getvalue())
    return files


def make_plot(
    key: str,
    title: str,
    note: str,
    alt: str,
    paint: Callable[[Figure], None],
    height: float = HEIGHT,
    width: float = WIDTH,
) -> Plot:
    """A figure of a page (inches); ``key`` is unique on it."""
    (file,) = render(paint, (width, height), "svg")
    return as_plot(key, title, note, alt, file, wide=width > WIDTH)


def as_plot(key: str, title: str, note: str, alt: str, file: bytes, wide: bool = False) -> Plot:
    """A figure of a page from an SVG file."""
    return Plot(key, title, note, alt, _inline(file, key, alt), file, wide)


def _inline(file: bytes, key: str, alt: str) -> str:
    """The SVG element for a page; its ids begin with ``key``, except those of letters, which all figures share."""
    svg = file.decode()
    own = r'(\bid="|url\(#|href="#)(?!DejaVuSans)'
    text = re.sub(own, lambda match: f"{match.group(0)}{key}-", svg[svg.index("<svg") :])
    short = re.sub(r'(?<= )(d|x|y)="[^"]*"', lambda match: _shortened(match.group(0)), text)
    label = f'role="img" aria-label="{escape(alt)}"'
    return themed(re.sub(r'width="[^"]*" height="[^"]*"', lambda _: label, short, count=1))


def _shortened(path: str) -> str:
    """An SVG path rounded to a tenth of a point, without the letters of its straight lines."""
    rounded = re.sub(r"\.(\d)\d+", r".\1", path)
    lines = r"[ML][^A-Za-z]+(?:L[^A-Za-z]+)+"
    return re.sub(lines, lambda match: re.sub(r"\s+L ", " ", match.group(0)), rounded)


def one_panel(key: str, title: str, note: str, alt: str, paint: Callable[[Axes], None], height: float = HEIGHT) -> Plot:
    """A figure of one panel that ``paint`` draws, with a legend above."""

    def painted(figure: Figure) -> None:
        axes = figure.subplots()
        paint(axes)
        add_legend(axes)

    return make_plot(key, title, note, alt, painted, height)


def curve_plot(
    key: str,
    title: str,
    note: str,
    curves: Mapping[str, pd.Series | pd.DataFrame],
    looks: Mapping[Any, Look],
    unit: str,
    finish: Callable[[Axes], None],
    per: str = " l/min",
    levels: bool = False,
    apart: float = 0.0,
) -> Plot:
    """A figure of one panel with a curve per participant.

    Args:
        key: name of its file.
        title: of the figure.
        note: how to read it.
        curves: values over their index; a frame has the columns ``value``, ``low`` and ``high``, which become bars.
        looks: of the participants.
        unit: of the values, after a space.
        finish: sets scales and labels of the axes when the curves are drawn.
        per: unit of the index, after a space.
        levels: whether the index holds leaks, to be shown with a tight seal at the left end.
        apart: distance of the participants' bars, in units of the axis.
    """
    frames = {
        name: curve.to_frame("value") if isinstance(curve, pd.Series) else curve for name, curve in curves.items()
    }

    def paint(axes: Axes) -> None:
        known = sorted({float(x) for frame in frames.values() for x in frame.index})
        places = level_axis(axes, known) if levels else {x: x for x in known}
        for index, (name, frame) in enumerate(frames.items()):
            at = np.array([places[float(x)] for x in frame.index]) + dodge(len(frames), index, apart)
            if "low" in frame:
                bars(axes, at, frame, looks[name], name)
            else:
                axes.plot(at, frame["value"], marker=looks[name].marker, label=name, **looks[name].stroke)
        if levels:
            axes.margins(x=0.06)  # no marker is cut at the edge
        finish(axes)

    rows = {name: [(f"{setting(x)}{per}", y) for x, y in frame["value"].items()] for name, frame in frames.items()}
    return one_panel(key, title, note, description(title, rows, unit), paint)


def rows_plot(
    key: str,
    title: str,
    note: str,
    parts: Mapping[str, pd.DataFrame],
    looks: Mapping[Any, Look],
    unit: str,
    finish: Callable[[Axes], None],
) -> Plot:
    """A figure of one panel: rows from top to bottom, in each a point with its interval for every participant.

    Args:
        key: name of its file.
        title: of the figure.
        note: how to read it.
        parts: by participant: columns ``value``, ``low`` and ``high``, NaN where there is none; the index holds the
            labels of the rows, the same for all participants.
        looks: of the participants.
        unit: of the values, after a space.
        finish: sets scale and label of the axis when the points are drawn.
    """
    labels = [str(label) for label in next(iter(parts.values())).index]

    def paint(axes: Axes) -> None:
        apart = min(0.24, 0.7 / len(parts))
        for index, (name, part) in enumerate(parts.items()):
            if part["value"].notna().any():
                bars(axes, np.arange(len(labels)) + dodge(len(parts), index, apart), part, looks[name], name, "rows")
        row_axis(axes, labels)
        finish(axes)

    rows = {name: list(part["value"].dropna().items()) for name, part in parts.items()}
    height = max(HEIGHT, 0.9 + 0.25 * len(labels) * max(1.2, 0.6 * len(parts)))
    return one_panel(key, title, note, description(title, rows, unit), paint, height)


def description(title: str, rows: Mapping[str, Iterable[tuple[str, float]]], unit: str) -> str:
    """All numbers of a figure as text, by controller; one line alone needs no name."""
    parts = [
        (f"{name}: " if name else "") + ", ".join(f"{label} {number(value)}{unit}" for label, value in rows[name])
        for name in rows
    ]
    return f"{title}. {'; '.join(parts)}."


# Parts of figures ---------------------------------------------------------------------------------------------------


def add_legend(axes: Axes) -> None:
    """Add a legend above the axes, where it covers no data."""
    handles, labels = axes.get_legend_handles_labels()
    if labels:
        columns = max(min(len(labels), 52 // (max(map(len, labels)) + 6)), 1)
        axes.legend(handles, labels, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns)


def legend_inside(axes: Axes, **options: Any) -> None:
    """Add a legend with a white background, which covers the lines behind it."""
    axes.legend(**({"fontsize": 8.0, "frameon": True, "framealpha": 0.9, "edgecolor": "none"} | options))


def ticks(axis: Axis, values: Sequence[float], labels: Callable[[float], str] = setting) -> None:
    """Put ticks at these values only, with their labels."""
    axis.set_major_locator(FixedLocator(values))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: labels(value)))


def log_leak_axis(axes: Axes, levels: Sequence[float], label: str = "leak, l/min at 100 bar") -> None:
    """A logarithmic horizontal axis with a tick at every level."""
    axes.set(xscale="log", xlabel=label)
    ticks(axes.xaxis, levels)


def level_axis(axes: Axes, levels: Sequence[float]) -> dict[float, float]:
    """Scale the axis by the logarithm of the levels, with a leak of zero at the left end; returns their places."""
    zero = float(np.log10(min((level for level in levels if level > 0.0), default=1.0))) - 0.5
    places = {level: float(np.log10(level)) if level > 0.0 else zero for level in levels}
    name_categories(axes.xaxis, places.values(), [setting(level) for level in places])
    axes.set_xlabel("leak, l/min at 100 bar")
    axes.grid(visible=False, axis="x")
    return places


def row_axis(axes: Axes, labels: Sequence[str]) -> None:
    """Categories from top to bottom."""
    name_categories(axes.yaxis, range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def bars(axes: Axes, places: Any, frame: pd.DataFrame, look: Look, label: str, kind: str = "line") -> None:
    """Draw values with their intervals (columns value, low, high): as a line, as points, or as points in rows."""
    value, low, high = (frame[name].to_numpy(dtype=np.float64) for name in ("value", "low", "high"))
    lengths = np.maximum(np.nan_to_num(np.array([value - low, high - value])), 0.0)
    at: dict[str, Any] = {"x": value, "y": places, "xerr": lengths}
    if kind != "rows":
        at = {"x": places, "y": value, "yerr": lengths}
    line = look.line if kind == "line" else "none"
    axes.errorbar(**at, color=look.colour, marker=look.marker, label=label, linestyle=line)


def dodge(count: int, index: int, width: float) -> float:
    """Offset of one of several controllers that share a place on the axis."""
    return width * (index - 0.5 * (count - 1))


def with_gaps(time: Array, values: Array) -> tuple[Array, Array]:
    """A line that breaks where rows are missing."""
    steps = np.diff(time)
    after = np.flatnonzero(steps > 5.0 * np.median(steps[steps > 0.0])) + 1
    return np.insert(time, after, time[after]), np.insert(values, after, np.nan)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """A line of at most MOST_POINTS points: lowest and highest value of each stretch."""
    size = -(-len(time) // (MOST_POINTS // 2))
    if size <= 2:
        return time, values
    count = len(time) // size
    blocks = values[: count * size].reshape(count, size)
    low = np.where(np.isfinite(blocks), blocks, np.inf).min(axis=1)
    high = np.where(np.isfinite(blocks), blocks, -np.inf).max(axis=1)
    ends = np.column_stack([low, high]).ravel()
    return np.repeat(time[: count * size : size], 2), np.where(np.isfinite(ends), ends, np.nan)
