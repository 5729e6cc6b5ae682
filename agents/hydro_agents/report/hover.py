"""Values that a browser shows when the pointer is on a point of a figure, as ``<title>`` elements of SVG."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hydro_agents.running.text import number

MOST_POINTS = 20
"""Largest number of points per line; a longer line is thinned evenly."""

REACH = 6
"""Radius around a point within which its value is shown, in points of the drawing."""


def name_categories(axis: Axis, places: Any, labels: Any) -> None:
    """Give each place on an axis a label: for its tick, and for the values of its points."""
    axis.set_ticks(list(places), list(labels))
    ends, words = np.asarray(list(places), dtype=np.float64), list(labels)

    def nearest(value: float) -> str:
        return str(words[int(np.argmin(np.abs(ends - value)))])

    if axis is axis.axes.xaxis:
        axis.axes.fmt_xdata = nearest
    else:
        axis.axes.fmt_ydata = nearest


def with_values(svg: bytes, figure: Figure) -> bytes:
    """The drawing of a figure with the values of its lines."""
    marks = "".join(_marks(figure))
    if not marks:
        return svg
    group = f'<g id="values" fill="none" pointer-events="all">{marks}</g>\n</svg>'
    return svg.decode().replace("</svg>", group).encode()


def _marks(figure: Figure) -> Iterator[str]:
    labels = _labels(figure)
    height = 72.0 * figure.get_figheight()
    for axes in figure.findobj(Axes):
        assert isinstance(axes, Axes)
        for line in axes.lines:
            if line.get_transform() != axes.transData or np.size(line.get_xdata(orig=False)) == 0:
                continue  # lines that mark a place have no values
            name = labels.get(line) or labels.get(line.get_color(), "")
            for x, y in _points(axes, line):
                across, up = 72.0 / figure.dpi * axes.transData.transform((x, y))
                text = escape("\n".join(filter(None, (name, _value(axes, "x", x), _value(axes, "y", y)))))
                place = f'cx="{across:.1f}" cy="{height - up:.1f}" r="{REACH}"'
                yield f"<circle {place}><title>{text}</title></circle>"


def _labels(figure: Figure) -> dict[Any, str]:
    """Names of lines, and of their colours for the same lines in another panel."""
    known: dict[Any, str] = {}
    for axes in figure.findobj(Axes):
        assert isinstance(axes, Axes)
        groups = [(box[0], box.get_label()) for box in axes.containers if isinstance(box, ErrorbarContainer)]
        for line, label in [*((line, line.get_label()) for line in axes.lines), *groups]:
            if isinstance(line, Line2D) and label and not str(label).startswith("_"):
                known[line] = str(label)
                known.setdefault(line.get_color(), str(label))
    return known


def _points(axes: Axes, line: Line2D) -> list[tuple[float, float]]:
    """Visible points of a line, thinned; none for a cloud, whose points are too close."""
    x, y = (np.asarray(values, dtype=np.float64) for values in line.get_data(orig=False))
    if len(x) > 4 * MOST_POINTS and line.get_linestyle() == "None":
        return []
    (left, right), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    seen = np.flatnonzero((x >= left) & (x <= right) & (y >= bottom) & (y <= top))
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, MOST_POINTS).astype(np.int64))] if len(seen) else seen
    return list(zip(x[chosen].tolist(), y[chosen].tolist(), strict=True))


def _value(axes: Axes, which: str, value: float) -> str:
    """A coordinate as text, with the label of its axis: "leak 0.3 l/min at 100 bar"."""
    group = axes.get_shared_x_axes() if which == "x" else axes.get_shared_y_axes()
    own = getattr(axes, f"get_{which}label")()
    words = own or next(filter(None, (getattr(other, f"get_{which}label")() for other in group.get_siblings(axes))), "")
    name, _, unit = " ".join(words.split()).partition(", ")
    named = getattr(axes, f"fmt_{which}data")
    return " ".join(filter(None, (name, named(value) if named else number(value), unit)))
