"""Writes the page of the robustness protocol: one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.experiments import run_experiments
from hydro_agents.report.content import Content
from hydro_agents.report.page import Page
from hydro_agents.report.robustness import PAGE_FILE, ROBUSTNESS
from hydro_agents.report.sections import render_page
from hydro_agents.report.traces import Replay, worst_traces
from hydro_agents.running.seeds import SEED_MARK
from hydro_env import TaskConfig
from hydro_env.files import write_whole


def write_robustness_report(
    folder: Path,
    tables: Mapping[str, pd.DataFrame],
    task: TaskConfig,
    controllers: Mapping[str, Controller],
    replay: Replay,
    experiments: bool = True,
    jobs: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Run the experiments, repeat the worst cases, and write ``tables/*.csv`` of the experiments and the page.

    Args:
        folder: of the results; the page is :data:`PAGE_FILE` in it.
        tables: of the protocol, by the name of their CSV file.
        task: of the protocol.
        controllers: by name; of several training seeds (``NAME#0``, …) the first one takes part in the experiments.
        replay: runs one case of the table ``cases`` again.
        experiments: whether to run the experiments; without them their sections are left out.
        jobs: experiments that run side by side.
        progress: called with the name of the phase, the number of finished jobs, and their total.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    chosen: dict[str, Controller] = {}
    for name, controller in controllers.items():
        chosen.setdefault(name.partition(SEED_MARK)[0], controller)
    found, errors = run_experiments(task, chosen, jobs=jobs, progress=progress) if experiments else ({}, {})
    for name, table in found.items():
        write_whole(folder / "tables" / f"{name}.csv", table.to_csv(index=False).encode())
    content = Content({**tables, **found}, task, {"errors": errors})
    if len(content.controllers) > 1:
        preview = max(task.references.preview_times, default=0.0)
        traces = worst_traces(replay, content.table("cases"), content.baseline, content.label, preview)
        content = replace(content, others={**content.others, "traces": traces})
    render_robustness(content).write(folder / PAGE_FILE)


def render_robustness(content: Content) -> Page:
    """The page."""
    title = content.facts.get("title", "Robustness of servo axis controllers")
    return render_page(title, ROBUSTNESS, content.with_full_names())
