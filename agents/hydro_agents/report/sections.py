"""Pages are lists of sections; a section is a registered function from the content of a page to blocks.

.. code-block:: python

    @section("Errors and costs", needs=("summary",))
    def costs(content: Content) -> list[Block]:
        return [Text("Means over all runs."), *ranking_table(content), absolute_table(content)]

A page leaves out a section whose needed tables are missing or empty, and one without blocks. The name of the function
names the section in lists and files; a section without a title belongs into the head of the page.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeAlias

import pandas as pd

from hydro_agents.report.canvas import Plot
from hydro_agents.report.content import Content
from hydro_agents.report.page import Page, make_page
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table
from hydro_env import ConfigurationError
from hydro_env.mistakes import unknown

TEMPLATE = Path(__file__).parent / "page.html.j2"
PARTS = ("recorded", "training_plots")
MODULES = tuple(f"hydro_agents.report.{name}" for name in PARTS)
"""Modules whose sections any list may name; parts of pages first, as a page's own module is loaded with its command."""


@dataclass(frozen=True)
class Text:
    """A paragraph; a ``markupsafe.Markup`` may hold HTML, any other text is escaped."""

    kind: ClassVar[str] = "text"
    text: str
    style: str = ""  # soft, caution, verdict, or verdict with good, worse or doubtful


@dataclass(frozen=True)
class Points:
    """A list of sentences."""

    kind: ClassVar[str] = "points"
    lines: Sequence[str]


@dataclass(frozen=True)
class Code:
    """A text with fixed line breaks, such as a file of settings."""

    kind: ClassVar[str] = "code"
    text: str


@dataclass(frozen=True)
class Fold:
    """Blocks below a line that opens and closes them."""

    kind: ClassVar[str] = "fold"
    summary: str
    blocks: Sequence[Block]
    opened: bool = False
    style: str = ""  # caution


Block: TypeAlias = Text | Points | Code | Fold | Plot | Table


class Section(NamedTuple):
    """A part of a page."""

    name: str
    title: str  # empty: a part of the head of the page
    needs: tuple[str, ...]  # tables, and other parts of the content
    blocks: Callable[[Content], Sequence[Block]]
    heading: bool  # whether the page shows the title above it


SECTIONS: dict[str, Section] = {}
"""All sections that were imported, by name."""


def section(
    title: str, needs: Sequence[str] = (), heading: bool = True
) -> Callable[[Callable[[Content], Sequence[Block]]], Callable[[Content], Sequence[Block]]]:
    """Register a function as a section under its own name.

    Args:
        title: for the list of contents and the heading; empty for a part of the head of the page.
        needs: names of tables or other parts of the content without which the section is left out.
        heading: whether the page shows the title above it.
    """

    def registered(blocks: Callable[[Content], Sequence[Block]]) -> Callable[[Content], Sequence[Block]]:
        name = blocks.__name__
        assert name not in SECTIONS or SECTIONS[name].blocks.__module__ == blocks.__module__, f"two sections {name}"
        SECTIONS[name] = Section(name, title, tuple(needs), blocks, heading)
        return blocks

    return registered


def sections_named(names: Iterable[str], where: str = "sections") -> list[Section]:
    """The sections of a list, in its order.

    Args:
        names: of registered sections.
        where: file and field of the list, for the message.

    Raises:
        ConfigurationError: a name is unknown, or occurs twice.
    """
    names = list(names)
    for module in MODULES:  # as far as the names need them
        if any(name not in SECTIONS for name in names):
            import_module(module)
    for name in names:
        if name not in SECTIONS:
            raise ConfigurationError(f"{where}: {unknown(name, sorted(SECTIONS), 'section')}")
        if names.count(name) > 1:
            raise ConfigurationError(f"{where}: section '{name}' occurs {names.count(name)} times")
    return [SECTIONS[name] for name in names]


def render_page(
    title: str, names: Iterable[str], content: Content, origin: Origin | None = None, sources: str = ""
) -> Page:
    """The page of some sections.

    Args:
        title: of the page.
        names: of its sections, in order.
        content: what they show.
        origin: command, date and version; default: those of the facts.
        sources: sentence about the files that hold the numbers; default: the tables beside the page.

    Raises:
        ConfigurationError: a section is unknown.
    """
    parts = [
        (part, blocks)
        for part in sections_named(names)
        if all(map(content.has, part.needs)) and (blocks := part.blocks(content))
    ]
    return make_page(
        TEMPLATE,
        origin or Origin.of(content.facts),
        title=title,
        head=[block for part, blocks in parts if not part.title for block in blocks],
        sections=[(part, blocks) for part, blocks in parts if part.title],
        plots=[plot for _, blocks in parts for plot in plots_of(blocks)],
        sources=sources,
    )


def words_table(table: pd.DataFrame) -> Table:
    """A data frame as a table of texts, with its own column names."""
    texts = table.dropna(axis=1, how="all").astype(object).fillna("").astype(str)
    return Table("", tuple(texts), list(texts.itertuples(index=False, name=None)), style="words")


def plots_of(blocks: Iterable[Block]) -> list[Plot]:
    """All figures in some blocks."""
    plots: list[Plot] = []
    for block in blocks:
        if isinstance(block, Plot):
            plots.append(block)
        elif isinstance(block, Fold):
            plots += plots_of(block.blocks)
    return plots
