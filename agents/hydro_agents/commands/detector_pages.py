"""What the commands show of a leakage protocol: the page, and the shares that are found on the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from hydro_agents.commands.protocols import PageOf
from hydro_agents.evaluation.leak_protocol import DRAWN
from hydro_agents.evaluation.runner import Results
from hydro_agents.report.kit import Page, as_text
from hydro_agents.report.leakage_page import leakage_page
from hydro_agents.running.text import Table, setting


def _draw(results: Results) -> Page:
    return leakage_page(results.protocol.title, results.tables(), results.protocol.base)


def _shares(results: Results) -> Iterator[Table]:
    """Share of windows that each detector reports under the base condition, by size of the leak."""
    found, base = results.table("detection"), results.protocol.base
    found = found[(found["condition"] == base) & (found["level"] != DRAWN)]
    rates = 100.0 * found.pivot(index="detector", columns="level", values="flagged").loc[found["detector"].unique()]
    rates = rates.rename(columns=lambda level: f"{setting(level)} l/min" if level > 0.0 else "healthy")
    yield as_text(rates, f"Windows reported as a leak, %: {base}")


LEAKAGE_PAGE = PageOf("leakage.html", _draw, _shares)
