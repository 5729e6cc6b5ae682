"""What the commands show of a leakage protocol: the page, and the shares that are found on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hydro_agents.commands.protocols import PageOf
from hydro_agents.evaluation.leak_protocol import DRAWN
from hydro_agents.evaluation.runner import Results
from hydro_agents.report.content import Content, interval
from hydro_agents.report.leakage import LEAKAGE, PAGE_FILE, level_text
from hydro_agents.report.sections import render_page
from hydro_agents.running.text import Table, number


def leakage_page() -> PageOf:
    """The page of a leakage protocol."""
    return PageOf(PAGE_FILE, _draw, _shares)


def _content(results: Results) -> Content:
    protocol = results.protocol
    return Content(results.tables(), protocol.task, {"base": protocol.base})


def _draw(results: Results, file: Path) -> None:
    protocol = results.protocol
    render_page(protocol.title, protocol.sections or LEAKAGE, _content(results)).write(file)


def _shares(results: Results) -> Iterator[Table]:
    """Share of windows that each detector reports under the base condition, by size of the leak."""
    content, protocol = _content(results), results.protocol
    levels = sorted(level for level in protocol.levels_in(protocol.base) if level != DRAWN)
    rows = []
    for name in content.detectors:
        cells = []
        for level in levels:
            row = content.row("detection", detector=name, condition=protocol.base, level=level)
            cells.append(number(interval(row, "flagged", 100.0).value, 1))
        rows.append((name, *cells))
    title = f"Windows reported as a leak, %: {content.label(protocol.base)}"
    yield Table(title, ("detector", *map(level_text, levels)), rows)
