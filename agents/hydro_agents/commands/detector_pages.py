"""What the commands show of a leakage protocol: the page, and the shares that are found on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hydro_agents.commands.protocols import PageOf
from hydro_agents.evaluation.leak_protocol import DRAWN
from hydro_agents.evaluation.runner import Results
from hydro_agents.report.kit import as_text
from hydro_agents.report.leakage_page import PAGE_FILE
from hydro_agents.report.leakage_page import leakage_page as draw_leakage
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, setting


def leakage_page() -> PageOf:
    """The page of a leakage protocol."""
    return PageOf(PAGE_FILE, _draw, _shares)


def _draw(results: Results, file: Path) -> None:
    page = draw_leakage(results.protocol.title, results.tables(), results.protocol.base)
    page.write(file, Origin.of(dict(results.facts)))


def _shares(results: Results) -> Iterator[Table]:
    """Share of windows that each detector reports under the base condition, by size of the leak."""
    found, base = results.table("detection"), results.protocol.base
    found = found[(found["condition"] == base) & (found["level"] != DRAWN)]
    rates = 100.0 * found.pivot(index="detector", columns="level", values="flagged").loc[found["detector"].unique()]
    names = {level: f"{setting(level)} l/min" if level > 0.0 else "healthy" for level in rates}
    yield as_text(rates.rename(columns=names), f"Windows reported as a leak, %: {base}")
