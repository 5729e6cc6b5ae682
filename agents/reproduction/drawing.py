"""A figure of the page, its files, and how it is drawn: the look of the other reports, wider."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from agents.report.canvas import STYLE

WIDTH = 8.6
"""inches"""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6b6b6b")
"""Okabe & Ito: distinct for colour-blind readers as well."""

LEAK_COLOURS = ("#1b6ca8", "#3fa7a0", "#d9a400", "#e8743b", "#a61c3c")
"""From a tight seal to a severe leak."""


@dataclass(frozen=True)
class ReproducedFigure:
    """One figure: its numbers, how to draw it, and what there is to say."""

    table: pd.DataFrame
    paint: Callable[[Figure, pd.DataFrame], None]
    height: float  # inches
    paper: str  # what the paper says, in other words
    how: str  # how it was computed here
    found: list[str]  # what comes out; numbers from the table
    differs: list[str] = field(default_factory=list)  # where the paper's conclusion does not come out
    equations: str = ""
    summary: pd.DataFrame | None = None  # a short table for the page


def render(figure: ReproducedFigure, key: str) -> tuple[bytes, str]:
    """The picture as PNG and as SVG. The same numbers give the same bytes."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE | {"svg.hashsalt": key})
        picture = Figure(figsize=(WIDTH, figure.height), layout="constrained")
        FigureCanvasAgg(picture)
        figure.paint(picture, figure.table)
        png, svg = io.BytesIO(), io.BytesIO()
        nothing: dict[str, Any] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        picture.savefig(png, format="png", dpi=120, facecolor="white", metadata={"Software": None})
        picture.savefig(svg, format="svg", metadata=nothing, facecolor="white")
    return png.getvalue(), svg.getvalue().decode()


def inline_svg(svg: str, key: str, alt: str) -> str:
    """The SVG element for a page: ids that do not mix with those of other figures, and words for who cannot see it."""
    text = svg[svg.index("<svg") :]
    text = re.sub(r'\bid="|url\(#|href="#', lambda found: f"{found.group(0)}{key}-", text)
    label = alt.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return re.sub(r'width="[^"]*" height="[^"]*"', lambda _: f'role="img" aria-label="{label}"', text, count=1)


def plain(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, never in powers of ten."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def millimetres(position: float) -> str:
    """A position in mm with its sign, for a legend; 0 without."""
    return f"{position:+.0f} mm".replace("-", "−").replace("+0 ", "0 ").replace("−0 ", "0 ")


def panel_title(axes: Axes, text: str) -> None:
    """What one panel shows, above it on the left."""
    axes.set_title(text, loc="left", fontsize=9.5, fontweight="bold")


def legend(axes: Axes, **options: Any) -> None:
    """A legend on a white ground, so that lines behind it do not disturb."""
    axes.legend(**({"fontsize": 8.0, "frameon": True, "framealpha": 0.9, "edgecolor": "none"} | options))
