"""Moved to :mod:`hydro_agents.running.text`."""

from hydro_agents.report.page import templates  # noqa: F401
from hydro_agents.running.text import *  # noqa: F403
