"""Writes the page of the leakage protocol: one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.report.content import Content
from hydro_agents.report.leakage import LEAKAGE, PAGE_FILE
from hydro_agents.report.page import Page
from hydro_agents.report.sections import render_page


def write_leak_report(folder: Path, tables: Mapping[str, pd.DataFrame], protocol: LeakProtocol) -> None:
    """Write the page :data:`PAGE_FILE`.

    Args:
        folder: of the results.
        tables: of the protocol, by the name of their CSV file.
        protocol: the protocol.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    render_leakage(Content(tables, protocol.task, {"base": protocol.base})).write(folder / PAGE_FILE)


def render_leakage(content: Content) -> Page:
    """The page."""
    return render_page(content.facts.get("title", "Leak detection"), LEAKAGE, content)
