"""Writes the page of the robustness protocol: one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pandas as pd

from hydro_agents.report.content import Content
from hydro_agents.report.page import Page
from hydro_agents.report.robustness import PAGE_FILE, ROBUSTNESS
from hydro_agents.report.sections import render_page
from hydro_agents.report.traces import Replay, worst_traces
from hydro_env import TaskConfig


def write_robustness_report(
    folder: Path,
    tables: Mapping[str, pd.DataFrame],
    task: TaskConfig,
    replay: Replay,
) -> None:
    """Repeat the worst cases, and write the page.

    Args:
        folder: of the results; the page is :data:`PAGE_FILE` in it.
        tables: of the protocol, by the name of their CSV file.
        task: of the protocol.
        replay: runs one case of the table ``cases`` again.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    content = Content(tables, task)
    if len(content.controllers) > 1:
        preview = max(task.references.preview_times, default=0.0)
        traces = worst_traces(replay, content.table("cases"), content.baseline, content.label, preview)
        content = replace(content, others={**content.others, "traces": traces})
    render_robustness(content).write(folder / PAGE_FILE)


def render_robustness(content: Content) -> Page:
    """The page."""
    title = content.facts.get("title", "Robustness of servo axis controllers")
    return render_page(title, ROBUSTNESS, content.with_full_names())
