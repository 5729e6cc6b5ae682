"""The kit of all pages: verdicts, tables and figures in one HTML file without external parts, in light and dark.

Comes in: data frames, and figures of matplotlib. Goes out: a file. A page is built from the top down.
"""

import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

import jinja2
import matplotlib.style
import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, number, setting
from hydro_env.files import write_whole
from hydro_env.types import ByName, Floats

Tables = Mapping[str, pd.DataFrame]  # of a run, by the names of their CSV files
Panels = Axes | Sequence[Axes]  # of one figure

# Colours and style ----------------------------------------------------------------------------------------------------

COLOURS = {
    "paper": ("#ffffff", "#15171c"),
    "ink": ("#1d1d1f", "#e8e8ec"),
    "grey": ("#5c5c63", "#a9a9b2"),
    "line": ("#dcdce0", "#3b3d45"),
    "pale": ("#f6f6f8", "#1f2128"),
    "blue": ("#0072b2", "#56b4e9"),
    "orange": ("#d55e00", "#f58f3c"),
    "green": ("#00805c", "#3fc196"),
    "purple": ("#b3508a", "#e592c1"),
    "gold": ("#8a6d00", "#d6b53c"),
    "violet": ("#6a4fb3", "#ab97ec"),
}
"""Every colour in light and dark. Figures are drawn in the light one; on a page each is a CSS variable of its name."""

PAPER, INK, GREY, LINE, _, BLUE, ORANGE, GREEN, PURPLE, GOLD, VIOLET = (light for light, _ in COLOURS.values())

NARROW, WIDE = 4.6, 8.6  # widths of figures, inches: a telephone, and a page

drawn = matplotlib.style.context(Path(__file__).with_name("figures.mplstyle"), after_reset=True)
"""Decorates a function that draws figures, whatever the user's own settings of matplotlib are."""


# Pages ----------------------------------------------------------------------------------------------------------------


class Page:
    """A page that is built from the top down; all texts are escaped but those that are ``markupsafe.Markup``.

    Example:
        >>> page = Page("Trial")
        >>> page.table(pd.DataFrame({"error, mm": [0.5, 0.4]}, index=["PID", "<b>"]))
        >>> "&lt;b&gt;" in page.html(), "0.500" in page.html()
        (True, True)
    """

    def __init__(self, title: str, sources: str = "") -> None:
        self.title = title
        self.sources = sources  # the files that hold the numbers
        self.headings: dict[str, str] = {}  # by their anchors
        self._parts: list[str] = []

    def _add(self, pattern: str, *values: object) -> None:
        self._parts.append(Markup(pattern).format(*values))

    def heading(self, text: str) -> None:
        """Begin a part of the page."""
        anchor = anchor_of(text)
        self.headings[anchor] = text
        self._add('<h2 id="{}">{}</h2>', anchor, text)

    def verdict(self, text: str, kind: str = "") -> None:
        """The result in one sentence; ``kind``: good, worse, doubtful."""
        self._add('<p class="verdict {}">{}</p>', kind, text)

    def text(self, text: str, kind: str = "") -> None:
        """A paragraph; ``kind``: soft, caution."""
        self._add('<p class="{}">{}</p>', kind, text)

    def points(self, lines: Iterable[str]) -> None:
        """A list of sentences."""
        self._add("<ul>{}</ul>", Markup("").join(Markup("<li>{}</li>").format(line) for line in lines))

    def code(self, text: str) -> None:
        """A text with fixed line breaks."""
        self._add('<pre tabindex="0">{}</pre>', text)

    @contextmanager
    def fold(self, summary: str, *, opened: bool = False) -> Iterator[None]:
        """What is added inside stands below a line that opens and closes it."""
        self._add("<details {}><summary>{}</summary>", "open" if opened else "", summary)
        yield
        self._add("</details>")

    @contextmanager
    def links(self) -> Iterator[None]:
        """A list of what is added inside by :meth:`link`."""
        self._add('<nav class="links">')
        yield
        self._add("</nav>")

    def link(self, heading: str, kind: str, cells: Iterable[str], mark: Markup) -> None:
        """A line that leads to a heading: its text, cells and a small figure; ``kind`` as that of a verdict."""
        spans = Markup("").join(Markup("<span>{}</span>").format(cell) for cell in cells)
        self._add('<a class="{}" href="#{}"><b>{}</b>{}{}</a>', kind, anchor_of(heading), heading, spans, mark)

    def table(
        self,
        frame: pd.DataFrame,
        caption: str = "",
        decimals: Mapping[Any, int] | None = None,
        kinds: pd.DataFrame | None = None,
        words: bool = False,
    ) -> None:
        """A data frame in a box of its own that scrolls sideways; its index names the rows.

        Args:
            frame: numbers, with their units in the names of the columns, and texts.
            caption: of the table.
            decimals: by column; other numbers have three significant digits.
            kinds: classes of the cells: better-1 to better-3, worse-1 to worse-3, best.
            words: whether the cells hold sentences, which break into lines.
        """
        style = frame.style.format(shown, escape="html")
        for column, places in (decimals or {}).items():
            style.format(lambda value, places=places: shown(value, places), subset=[column])
        for axis in (0, 1):
            style.format_index(_label, axis=axis).hide(axis=axis, names=True)
        if kinds is not None:
            style.set_td_classes(kinds)
        if caption:
            style.set_caption(Markup("<span>{}</span>").format(caption))
        if words:
            style.set_table_attributes('class="words"')
        style.set_uuid(str(len(self._parts)))
        box = '<div class="scroll" tabindex="0" role="region" aria-label="{}">{}</div>'
        self._add(box, caption or "Table", Markup(style.to_html(cell_ids=False)))

    def facts(self, facts: ByName) -> None:
        """A table of names and values."""
        self.table(pd.DataFrame({"value": pd.Series(facts, dtype=object)}), words=True)

    def figure(self, axes: Panels, title: str, note: str = "") -> None:
        """A figure by its panels; ``note`` says how to read it, the title is its alternate text."""
        wide = "wide" if figure_of(axes).get_figwidth() > NARROW else ""
        self._add('<figure class="{}"><figcaption><strong>{}</strong> {}</figcaption>', wide, title, note)
        self._parts.append(f'<div class="scroll">{inline_svg(axes, f"f{len(self._parts)}-", title)}</div></figure>')

    def html(self, origin: Origin | None = None) -> str:
        """The page as a file; ``origin``: its command, date and version."""
        loader = jinja2.FileSystemLoader(Path(__file__).parent)
        template = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True).get_template("page.html.j2")
        return template.render(page=self, body=Markup("\n".join(self._parts)), origin=origin, colours=COLOURS)

    def write(self, path: Path, origin: Origin | None = None) -> None:
        """Write the page.

        Raises:
            ConfigurationError: the file cannot be written.
        """
        write_whole(path, self.html(origin).encode())


def anchor_of(heading: str) -> str:
    """The name of a heading in a link."""
    return re.sub(r"\W+", "-", heading.lower()).strip("-")


def sparkline(values: Floats, limit: float) -> Markup:
    """A small line of values (n,) above zero on a logarithmic scale, and a dashed one at ``limit``; NaN: a gap."""
    heights = np.log10(np.append(values, limit))
    low, span = np.nanmin(heights), max(np.ptp(heights[np.isfinite(heights)]), 0.3)
    places = 2.0 + 20.0 * (1.0 - (heights - low) / span)
    steps = np.linspace(0.0, 98.0, max(len(values), 2))
    points = " ".join(f"{x:.0f},{y:.1f}" for x, y in zip(steps, places[:-1], strict=False) if np.isfinite(y))
    svg = '<svg viewBox="0 0 100 24" aria-hidden="true"><path d="M0 {:.1f}H100"/><polyline points="{}"/></svg>'
    return Markup(svg).format(places[-1], points)


def shown(value: Any, decimals: int | None = None) -> str:
    """A cell: numbers as a person writes them, other things as text."""
    if isinstance(value, int | np.integer):
        return number(float(value), 0)
    if isinstance(value, float | np.floating):
        return number(float(value), decimals)
    return str(value)


def _label(value: Any) -> str:
    """A heading of a row or column: settings in their shortest form."""
    if isinstance(value, float):
        return setting(value)
    return escape(str(value))


def as_text(frame: pd.DataFrame, caption: str) -> Table:
    """A data frame as a table of texts, for the console."""
    rows = [(str(name), *map(shown, cells)) for name, *cells in frame.itertuples(name=None)]
    return Table(caption, ("", *map(str, frame)), rows)


def with_interval(table: pd.DataFrame, column: str, decimals: int | None = None, factor: float = 1.0) -> pd.Series:
    """A column with its interval as texts: 0.512 (0.400 to 0.625)."""
    texts = []
    for row in factor * table[[column, f"{column}_low", f"{column}_high"]].to_numpy(float):
        middle, low, high = (number(value, decimals) for value in row)
        if np.isfinite(row[1]):
            middle += f" ({low} to {high})"
        texts.append(middle)
    return pd.Series(texts, index=table.index, dtype=object)


# Parts of several pages -----------------------------------------------------------------------------------------------


def problems(page: Page, tables: Tables, who: str) -> None:
    """What failed or did not apply, from the tables ``status`` and ``conditions``."""
    status = tables.get("status", pd.DataFrame({"status": []}))
    table = status[status["status"].isin(["failed", "not applicable"])]
    if len(table):
        labels = tables["conditions"].set_index("condition")["label"].to_dict()
        with page.fold("Some parts did not run", opened=(table["status"] == "failed").any()):
            table = table.replace({"condition": labels}).set_index(who)
            page.table(table[["condition", "status", "message"]], words=True)


def run_facts(page: Page, tables: Tables, configuration: str = "") -> None:
    """The tables ``protocol`` and ``conditions``, and settings (YAML text) of the run."""
    page.heading("This run")
    if "protocol" in tables:
        page.table(tables["protocol"].set_index("key"), words=True)
    if configuration:
        with page.fold("Configuration"):
            page.code(configuration)
    if "conditions" in tables:
        with page.fold("All conditions"):
            used = tables["conditions"].set_index("condition").dropna(axis=1, how="all")
            page.table(used.astype(object).fillna(""), words=True)


# Figures --------------------------------------------------------------------------------------------------------------


def panel(width: float = NARROW, height: float = 3.0, **options: Any) -> Axes:
    """A figure of one panel (inches); ``options`` of ``Axes.set``, such as labels and limits."""
    (axes,) = panels(1, width, height)
    axes.set(**options)
    return axes


def panels(count: int, width: float = WIDE, height: float = 7.5, **options: Any) -> list[Axes]:
    """A figure of several panels below each other that share the horizontal axis; ``options`` of ``subplots``."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return list(figure.subplots(count, 1, sharex=True, squeeze=False, **options)[:, 0])


def time_panels(labels: Sequence[str], height: float = 7.5, **options: Any) -> list[Axes]:
    """A figure of signals over time in s, a panel for each label."""
    axes = panels(len(labels), height=height, **options)
    for one, label in zip(axes, labels, strict=True):
        one.set_ylabel(label)
    axes[-1].set_xlabel("time, s")
    return axes


def draw(
    axes: Axes,
    table: pd.DataFrame,
    over: str,
    value: str,
    names: Sequence[str],
    by: str = "controller",
    factor: float = 1.0,
) -> None:
    """Draw a column with its interval over another one, for each participant.

    Args:
        axes: the panel.
        table: columns ``over``, ``value``, ``by``; VALUE_low and VALUE_high, if there is an interval.
        over: a column of numbers, over which lines run; or of texts, each of which gets a row, from top to bottom.
        value: the column to draw.
        names: the participants, the same in all figures of a page: each keeps its colour and marker.
        by: column of the participants.
        factor: from the unit of the table to that of the figure.
    """
    labels = list(dict.fromkeys(table[over]))
    in_rows = labels and isinstance(labels[0], str)
    apart = 2.0  # points, so that no interval covers another one
    if in_rows:
        apart, table = 7.0, table.assign(**{over: table[over].map(labels.index)})
    scale = figure_of(axes).dpi_scale_trans
    for index, name in enumerate(names):
        own = table[table[by] == name]
        places, middle, lengths = own[over], factor * own[value].to_numpy(float), None
        if f"{value}_low" in own:
            low, high = factor * own[[f"{value}_low", f"{value}_high"]].to_numpy(float).T
            lengths = np.nan_to_num(np.maximum([middle - low, high - middle], 0.0))
        shift = apart / 72.0 * (index - 0.5 * (len(names) - 1))
        label = "_none" if own.empty else name
        if in_rows:
            made, moved = axes.errorbar(middle, places, xerr=lengths, linestyle="none", label=label), (0.0, -shift)
        else:
            made, moved = axes.errorbar(places, middle, yerr=lengths, label=label), (shift, 0.0)
        for artist in made.get_children():
            artist.set_transform(axes.transData + ScaledTranslation(*moved, scale))
    if in_rows:
        axes.set_yticks(range(len(labels)), labels)
        axes.set_ylim(len(labels) - 0.4, -0.6)
        axes.grid(visible=False, axis="y")


def height_of(categories: int, names: int) -> float:
    """Height of a figure with rows, inches."""
    return 0.9 + categories * (7.0 * names + 9.0) / 72.0


def leak_axis(axes: Axes, leaks: Iterable[float]) -> None:
    """Scale the horizontal axis by the logarithm of the leak; a leak of zero stands at the left end."""
    levels = sorted(set(leaks))
    axes.set_xscale("symlog", linthresh=min((level for level in levels if level > 0.0), default=1.0), linscale=0.3)
    marked = levels
    if len(levels) > 7:
        marked = [level for level in levels if level in (0.0, 0.01, 0.1, 0.3, 1.0, 4.0)]
    axes.set_xticks(marked, [setting(level) for level in marked])
    axes.set_xticks([], minor=True)
    axes.margins(x=0.06)
    axes.set_xlabel("leak, l/min at 100 bar")


def signal(axes: Axes, time: Floats, values: Floats, **options: Any) -> None:
    """Draw a line of samples (T,) without markers; it breaks where rows are missing."""
    steps = np.diff(time)
    if (steps > 0.0).any():
        after = np.flatnonzero(steps > 5.0 * np.median(steps[steps > 0.0])) + 1
        time, values = np.insert(time, after, time[after]), np.insert(values, after, np.nan)
    axes.plot(time, values, marker="", **options)


def legend(axes: Axes) -> None:
    """A legend above the panel, where it covers no data, if there are several lines, and none yet."""
    handles, labels = axes.get_legend_handles_labels()
    if len(labels) > 1 and axes.get_legend() is None:
        letters = 11 * figure_of(axes).get_figwidth()
        columns = max(int(letters // (max(map(len, labels)) + 6)), 1)
        axes.legend(handles, labels, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=min(columns, len(labels)))


def figure_of(axes: Panels) -> Figure:
    """The figure of a panel, or of several."""
    (first, *_) = np.atleast_1d(np.asarray(axes, object))
    figure = first.get_figure(root=True)
    assert figure
    return figure


def picture(axes: Panels, kind: str, **options: Any) -> bytes:
    """A figure as a file (``svg``, ``png``), the same bytes for the same numbers."""
    figure = figure_of(axes)
    for axes in figure.axes:
        legend(axes)
    left_out = {"svg": ("Date", "Creator", "Format", "Type"), "png": ("Software",)}[kind]
    file = io.BytesIO()
    figure.savefig(file, format=kind, dpi=120, metadata=dict.fromkeys(left_out), **options)
    return file.getvalue()


def inline_svg(axes: Panels, prefix: str, alt: str) -> str:
    """A figure as an element of a page: its colours are CSS variables, its ids begin with ``prefix``."""
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # letters are those of the page
        svg = picture(axes, "svg", transparent=True).decode()
    svg = re.sub(r'\bid="|url\(#|href="#', lambda match: match[0] + prefix, svg[svg.index("<svg") :])
    svg = re.sub(
        r'(?<= )(d|x|y)="[^"]*"', lambda match: re.sub(r"(\.\d)\d+", r"\1", match[0]), svg
    )  # tenths of a point
    svg = re.sub(r'width="[^"]*" height="[^"]*"', lambda _: f'role="img" aria-label="{escape(alt)}"', svg, count=1)
    for name, (light, _) in COLOURS.items():
        svg = svg.replace(light, f"var(--{name})")
    return svg
