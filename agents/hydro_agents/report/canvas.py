"""Drawing of all figures: one style, one palette, and the same SVG and PNG on every machine.

Each controller has the same colour, marker and line in all figures. The same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.style
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import NDArray

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

MARKED_LEAKS = (0.01, 0.1, 0.3, 1.0, 2.0, 4.0, 8.0)
"""Ticks of a scale of many leaks, l/min at 100 bar."""

MOST_TOLD = 12
"""Largest number of points of a curve in the text for readers who cannot see the figure."""

STYLE = Path(__file__).with_name("figures.mplstyle")
COLOURS = {
    **dict.fromkeys(("axes.labelcolor", "text.color", "xtick.labelcolor", "ytick.labelcolor"), INK),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), GREY),
    "grid.color": PALE,
}
"""Settings of matplotlib."""


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
    with matplotlib.style.context([STYLE, COLOURS], after_reset=True):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        paint(figure)
        files = []
        for kind in kinds:
            file = io.BytesIO()
            left_out = ("Date", "Creator", "Format", "Type") if kind == "svg" else ("Software",)
            figure.savefig(file, format=kind, dpi=120, metadata=dict.fromkeys(left_out), facecolor=PAPER)
            files.append(file.getvalue())
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
    rounded = re.compile(r"\.(\d)\d+")  # to a tenth of a point
    short = re.sub(r'(?<= )(d|x|y)="[^"]*"', lambda match: rounded.sub(r".\1", match[0]), text)
    label = f'role="img" aria-label="{escape(alt)}"'
    return themed(re.sub(r'width="[^"]*" height="[^"]*"', lambda _: label, short, count=1))


def curve_plot(
    key: str,
    title: str,
    note: str,
    curves: Mapping[str, Any],
    looks: Mapping[Any, Look],
    unit: str,
    finish: Callable[[Axes], object] | None = None,
    per: str = " l/min",
    apart: float = 0.0,
    drawn: str = "line",
    **options: Any,
) -> Plot:
    """A figure of one panel with a curve per participant.

    Args:
        key: name of its file.
        title: of the figure.
        note: how to read it.
        curves: by participant, a series over its index; or a frame with the columns ``value``, ``low`` and ``high``,
            which become bars. Texts in the index are categories, the same for all participants.
        looks: of the participants.
        unit: of the values, after a space.
        finish: sets scales of the axes when the curves are drawn.
        per: unit of the index, after a space.
        apart: distance of the participants' bars, in units of the axis; rows have their own.
        drawn: ``line``; ``levels``: a line over leaks, with a tight seal at the left end; ``points``; ``band``: a line
            in the band of its interval; ``rows``: a row for each category, from top to bottom.
        options: of ``Axes.set``, such as labels and limits.
    """
    frames = {name: curve.to_frame("value") if curve.ndim == 1 else curve for name, curve in curves.items()}
    index = next(iter(frames.values())).index

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        gap = min(0.24, 0.7 / len(frames)) if drawn == "rows" else apart
        values = sorted({x for frame in frames.values() for x in frame.index})
        places = _axis_of(axes, drawn, values, list(index))
        for count, (name, frame) in enumerate(frames.items()):
            look = looks[name]
            at = np.array([places.get(x, x) for x in frame.index]) + dodge(len(frames), count, gap)
            if drawn == "band" or "low" not in frame:
                stroke = look.stroke | ({"linestyle": "none"} if drawn in ("points", "rows") else {})
                place = (frame["value"], at) if drawn == "rows" else (at, frame["value"])
                axes.plot(*place, marker=look.marker, label=name, **stroke)
                if "low" in frame:
                    axes.fill_between(at, frame["low"], frame["high"], color=look.colour, alpha=0.2, linewidth=0)
            elif frame["value"].notna().any():
                bars(axes, at, frame, look, name, drawn)
        if finish is not None:
            finish(axes)
        axes.set(**options)
        add_legend(axes)

    height = HEIGHT
    if drawn == "rows":
        height = max(HEIGHT, 0.9 + 0.25 * len(index) * max(1.2, 0.6 * len(frames)))
    rows = {name: _points(frame["value"].dropna(), per) for name, frame in frames.items()}
    return make_plot(key, title, note, description(title, rows, unit), paint, height)


def _axis_of(axes: Axes, drawn: str, values: list[Any], labels: list[Any]) -> dict[Any, float]:
    """The axis of the index of curves; returns the places of those values that do not stand at themselves."""
    if drawn == "levels":
        places = level_axis(axes, values)
        axes.margins(x=0.06)  # no marker is cut at the edge
        return places
    if drawn == "rows":
        row_axis(axes, labels)
    elif isinstance(labels[0], str):
        axes.set_xticks(range(len(labels)), labels)
        axes.grid(visible=False, axis="x")
    else:
        return {}
    return {label: place for place, label in enumerate(labels)}


def _points(values: Any, per: str) -> list[tuple[str, float]]:
    """Labels and values of a curve, of a long one evenly thinned."""
    if len(values) > MOST_TOLD:
        values = values.iloc[np.linspace(0, len(values) - 1, MOST_TOLD).astype(np.int64)]
    return [(x if isinstance(x, str) else f"{setting(x)}{per}", y) for x, y in values.items()]


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


def ticks(axis: Axis, values: Sequence[float], labels: Callable[[float], str] = setting) -> None:
    """Put ticks at these values only, with their labels."""
    axis.set_major_locator(FixedLocator(values))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: labels(value)))


def level_axis(axes: Axes, levels: Sequence[float]) -> dict[float, float]:
    """Scale the axis by the logarithm of the levels, with a leak of zero at the left end; returns their places."""
    zero = float(np.log10(min((level for level in levels if level > 0.0), default=1.0))) - 0.5
    places = {level: float(np.log10(level)) if level > 0.0 else zero for level in levels}
    shown = [level for level in places if len(places) < 8 or level in MARKED_LEAKS]
    axes.set_xticks([places[level] for level in shown], [setting(level) for level in shown])
    axes.set_xlabel("leak, l/min at 100 bar")
    axes.grid(visible=False, axis="x")
    return places


def row_axis(axes: Axes, labels: Sequence[str]) -> None:
    """Categories from top to bottom."""
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def bars(axes: Axes, places: Any, frame: pd.DataFrame, look: Look, label: str, drawn: str = "line") -> None:
    """Draw values with their intervals (columns value, low, high): as a line, as points, or as points in rows."""
    value, low, high = frame[["value", "low", "high"]].to_numpy(dtype=np.float64).T
    lengths = np.maximum(np.nan_to_num(np.array([value - low, high - value])), 0.0)
    at: dict[str, Any] = {"x": places, "y": value, "yerr": lengths}
    if drawn == "rows":
        at = {"x": value, "y": places, "xerr": lengths}
    line = "none" if drawn in ("rows", "points") else look.line
    axes.errorbar(**at, color=look.colour, marker=look.marker, label=label, linestyle=line)


def dodge(count: int, index: int, width: float) -> float:
    """Offset of one of several controllers that share a place on the axis."""
    return width * (index - 0.5 * (count - 1))


def with_gaps(time: Array, values: Array) -> tuple[Array, Array]:
    """A line that breaks where rows are missing."""
    steps = np.diff(time)
    rising = steps[steps > 0.0]
    usual = np.median(rising) if len(rising) else np.inf
    after = np.flatnonzero(steps > 5.0 * usual) + 1
    return np.insert(time, after, time[after]), np.insert(values, after, np.nan)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """A line of at most MOST_POINTS points: lowest and highest value of each stretch."""
    size = -(-len(time) // (MOST_POINTS // 2))
    if size <= 2:
        return time, values
    ends = pd.Series(values).groupby(np.arange(len(values)) // size).agg(["min", "max"])
    return np.repeat(time[::size], 2), ends.to_numpy().ravel()
