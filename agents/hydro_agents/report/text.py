"""Moved to :mod:`hydro_agents.running.text`."""

from hydro_agents.report.page import templates
from hydro_agents.running.text import Table, listed, number, setting, span

__all__ = ["Table", "listed", "number", "setting", "span", "templates"]
