"""Values that a browser shows when the pointer is on a point of a figure, as ``<title>`` elements of SVG."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

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
    panels = figure.get_axes()
    labels = _labels(panels)
    height = 72.0 * figure.get_figheight()
    marks = []
    for axes in panels:
        for line in axes.lines:
            if line.get_transform() != axes.transData or np.size(line.get_xdata(orig=False)) == 0:
                continue  # lines that mark a place have no values
            name = labels.get(line) or labels.get(line.get_color(), "")
            for x, y in _points(axes, line):
                across, up = 72.0 / figure.dpi * axes.transData.transform((x, y))
                text = escape("\n".join(filter(None, (name, _value(axes, "x", x), _value(axes, "y", y)))))
                place = f'cx="{across:.1f}" cy="{height - up:.1f}" r="{REACH}"'
                marks.append(f"<circle {place}><title>{text}</title></circle>")
    group = f'<g id="values" fill="none" pointer-events="all">{"".join(marks)}</g>\n</svg>'
    return svg.decode().replace("</svg>", group).encode() if marks else svg


def _labels(panels: list[Axes]) -> dict[Any, str]:
    """Names of lines, and of their colours for the same lines in another panel."""
    names: dict[Any, str] = {}
    for axes in panels:
        groups = [(box[0], box.get_label()) for box in axes.containers if isinstance(box, ErrorbarContainer)]
        for line, label in [*((line, line.get_label()) for line in axes.lines), *groups]:
            if isinstance(line, Line2D) and label and not str(label).startswith("_"):
                names[line] = str(label)
                names.setdefault(line.get_color(), str(label))
    return names


def _points(axes: Axes, line: Line2D) -> list[tuple[float, float]]:
    """Visible points of a line, thinned; none for a cloud, whose points are too close."""
    x, y = (np.asarray(values, dtype=np.float64) for values in line.get_data(orig=False))
    if len(x) > 4 * MOST_POINTS and line.get_linestyle() == "None":
        return []
    (left, right), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    seen = np.flatnonzero((x >= left) & (x <= right) & (y >= bottom) & (y <= top))
    chosen = seen[thinned_rows(len(seen), MOST_POINTS)]
    return list(zip(x[chosen].tolist(), y[chosen].tolist(), strict=True))


def thinned_rows(count: int, most: int) -> NDArray[np.int64]:
    """Numbers of at most ``most`` rows, evenly from the first to the last."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)


def _value(axes: Axes, which: str, value: float) -> str:
    """A coordinate as text, with the label of its axis: "leak 0.3 l/min at 100 bar"."""
    group = axes.get_shared_x_axes() if which == "x" else axes.get_shared_y_axes()
    labels = [getattr(each, f"get_{which}label")() for each in (axes, *group.get_siblings(axes))]
    name, _, unit = " ".join(next(filter(None, labels), "").split()).partition(", ")
    text = getattr(axes, f"fmt_{which}data") or number
    return " ".join(filter(None, (name, text(value), unit)))
