"""Writes the pages of protocols and studies: one HTML file each, without external parts, and its figures beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from hydro_agents.report.content import Content
from hydro_agents.report.page import Page
from hydro_agents.report.sections import render_page
from hydro_agents.report.traces import Example, Replay, worst_traces
from hydro_env.files import write_whole

if TYPE_CHECKING:
    from hydro_agents.evaluation.evaluate import Evaluation


def with_traces(content: Content, replay: Replay) -> Content:
    """The content with the worst cases of every controller, run again (see :func:`worst_traces`)."""
    if len(content.controllers) < 2:
        return content
    preview = max(content.task.references.preview_times, default=0.0)
    traces = worst_traces(replay, content.table("cases"), content.baseline, content.label, preview)
    return Content(content.tables, content.task, {**content.others, "traces": traces})


# Studies ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StudyRecord:
    """Facts of a study for its report."""

    title: str
    configuration: str  # YAML text of the study configuration
    command: str  # command line of the study
    versions: dict[str, str]  # package → version; commit
    machine: str
    seed: int
    timings: dict[str, float]  # phase → seconds
    training_curve: pd.DataFrame  # see hydro_agents.report.training_plots; may be empty
    examples: list[Example]  # the same episodes at every leak
    corrects: Mapping[str, str] = field(default_factory=dict)  # controller → controller that it corrects
    date: str = ""  # UTC
    leak_price: pd.DataFrame = field(
        default_factory=pd.DataFrame
    )  # see hydro_agents.evaluation.leak_price; may be empty
    validation_error_mm: float = float("nan")  # of the first controller, on the plants of the training curve


def write_report(path: Path, evaluation: Evaluation, record: StudyRecord) -> None:
    """Write the page of a study.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    render_report(evaluation, record).write(path)


def render_report(evaluation: Evaluation, record: StudyRecord) -> Page:
    """The page of a study. A controller that corrects another is named like 'PPO on PID'."""
    from hydro_agents.report.study import STUDY  # the page of a protocol needs no section of a study

    return render_page(record.title, STUDY, content_of(evaluation, record))


def content_of(evaluation: Evaluation, record: StudyRecord | None = None) -> Content:
    """The content of the page: the tables of the evaluation, and the facts of the study."""
    tables, others = tables_of(evaluation), {"bounds": evaluation.bounds, "errors": evaluation.errors}
    if record is None:
        return Content(tables, others=others)
    facts = {"command": record.command, "date": record.date, "seed": record.seed, "machine": record.machine}
    tables |= {
        "leak_price": record.leak_price,
        "training_curve": record.training_curve,
        "protocol": pd.DataFrame({**facts, **record.versions}.items(), columns=["key", "value"]),
    }
    names = ("examples", "timings", "configuration", "corrects", "validation_error_mm")
    return Content(tables, others={**others, **{name: getattr(record, name) for name in names}})


def tables_of(evaluation: Evaluation) -> dict[str, pd.DataFrame]:
    """Every table of an evaluation by the name of its CSV file."""
    values = {part.name: getattr(evaluation, part.name) for part in fields(evaluation)}
    return {name: table for name, table in values.items() if isinstance(table, pd.DataFrame)}


def write_tables(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write every table that is not empty as CSV; returns the files.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    written = []
    for name, table in tables_of(evaluation).items():
        if not table.empty:
            written.append(Path(folder) / f"{name}.csv")
            write_whole(written[-1], table.to_csv(index=False).encode())
    return written
