"""How figures are drawn: one panel wide, as SVG text that looks the same in every browser and on every machine.

Each controller keeps its colour, marker and line over all figures. The same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

if TYPE_CHECKING:
    from agents.evaluation.protocol import Evaluation

Array = NDArray[np.floating[Any]]

WIDTH, HEIGHT = 4.6, 3.0
"""inches; 440 pixels, about a phone, so that text keeps its size there."""

INK, GREY, PALE = "#222222", "#6b6b6b", "#dddddd"

STYLE: Any = {
    "svg.hashsalt": "hydro_env",
    "svg.fonttype": "path",  # letters are outlines: no font is needed where the report is read
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
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

FAMILY_NAMES = {
    "step": "steps",
    "point_to_point": "point-to-point moves",
    "ramp": "ramps",
    "sine": "sines",
    "multi_sine": "sums of sines",
    "start_stop": "start–stop runs",
    "user": "own reference",
}
"""What a person calls the families of references."""


@dataclass(frozen=True)
class Plot:
    """A figure with its words."""

    title: str
    note: str  # how to read it
    alt: str  # what it shows, for those who cannot see it
    svg: str


@dataclass(frozen=True)
class Look:
    """How a controller looks in every figure."""

    colour: str
    marker: str
    line: str


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#8A6D00", "#56B4E9")
"""After Okabe and Ito: told apart by colour-blind readers too."""

MARKERS, LINES = "osD^vP", ("-", "--", "-.", ":")


def looks_of(names: Iterable[str]) -> dict[str, Look]:
    """The look of each controller, by its place."""
    return {
        name: Look(COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)], LINES[i % len(LINES)])
        for i, name in enumerate(names)
    }


def controllers_of(evaluation: Evaluation) -> list[str]:
    """Names of the controllers; the first is the one that the others are compared with."""
    return [str(name) for name in evaluation.cases["controller"].unique()]


def draw(key: str, alt: str, paint: Callable[[Figure], None], height: float = HEIGHT) -> str:
    """The SVG element that ``paint`` draws; its ids start with ``key``, so that figures on one page do not mix."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        paint(figure)
        buffer = io.StringIO()
        nothing: dict[str, Any] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="|url\(#|href="#', lambda found: f"{found.group(0)}{key}-", text)
    label = alt.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return re.sub(r'width="[^"]*" height="[^"]*"', lambda _: f'role="img" aria-label="{label}"', text, count=1)


def description(title: str, rows: Mapping[str, Iterable[tuple[str, float]]], unit: str) -> str:
    """All numbers of a figure in words, by controller."""
    parts = [
        f"{name}: " + ", ".join(f"{label} {value:.3g}{unit}" for label, value in row) for name, row in rows.items()
    ]
    return f"{title}. {'; '.join(parts)}."


def add_legend(axes: Axes) -> None:
    """Above the axes, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    if labels:
        columns = max(min(len(labels), 52 // (max(map(len, labels)) + 6)), 1)
        axes.legend(handles, labels, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns)


def level_axis(axes: Axes, levels: Sequence[float]) -> dict[float, float]:
    """A logarithmic axis with a tick at every level; places of the levels. No leak stands left of all others."""
    zero = float(np.log10(min((level for level in levels if level > 0.0), default=1.0))) - 0.5
    places = {level: float(np.log10(level)) if level > 0.0 else zero for level in levels}
    axes.set_xticks(list(places.values()), [f"{level:g}" for level in places])
    axes.set_xlabel("leak, l/min at 100 bar")
    axes.grid(visible=False, axis="x")
    return places


def row_axis(axes: Axes, labels: Sequence[str]) -> None:
    """Categories from top to bottom."""
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def bars(axes: Axes, places: Any, frame: pd.DataFrame, column: str, look: Look, label: str, kind: str = "line") -> None:
    """Values with their intervals (columns ``low`` and ``high``): as a line, as points, or as points in rows."""
    value, low, high = (frame[name].to_numpy(dtype=np.float64) for name in (column, "low", "high"))
    lengths = np.maximum(np.nan_to_num(np.array([value - low, high - value])), 0.0)
    style: dict[str, Any] = {"color": look.colour, "marker": look.marker, "label": label}
    style["linestyle"] = look.line if kind == "line" else "none"
    if kind == "rows":
        axes.errorbar(value, places, xerr=lengths, **style)
    else:
        axes.errorbar(places, value, yerr=lengths, **style)


def dodge(count: int, index: int, width: float) -> float:
    """How far one of several controllers stands beside the place that they share."""
    return width * (index - 0.5 * (count - 1))
