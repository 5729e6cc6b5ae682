"""Results of an evaluation: tables, report, example episodes, and the main figures on the console."""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.evaluate import Evaluation, evaluate
from hydro_agents.evaluation.participants import split_name
from hydro_agents.report.kit import as_text
from hydro_agents.report.study_page import Example, detection_table, overview, study_page, tables_of
from hydro_agents.running.cases import Cases, run_cases, validation_errors
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.limit_cycles import rest_warning
from hydro_agents.running.machine import Origin, date_now, machine_description, package_versions
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.study.settings import StudySettings
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import read_json, write_whole

REPORT_FILE = "report.html"
REPORT_FILES = (REPORT_FILE, "tables/*.csv")
MOST_COLUMNS = 4
"""Largest number of controllers side by side on the console; more stand below each other."""

EXAMPLE_FAMILIES = {"step": "steps", "start_stop": "start–stop moves"}


STATE_FILE = "state.json"
STATE_FORMAT = "hydro_env study, state 1"
Result = TypeVar("Result")


class Phases:
    """Finished phases of a study and their durations, stored in ``state.json``.

    Args:
        folder: folder of the study; the state of an earlier session is read from it.

    Raises:
        ConfigurationError: the state is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.file = folder / STATE_FILE
        self.seconds: dict[str, float] = {}
        self.done: list[str] = []
        if self.file.exists():
            try:
                state = read_json(self.file)
                if state["format"] != STATE_FORMAT:
                    raise ValueError
                self.seconds = {str(name): float(value) for name, value in state["seconds"].items()}
                self.done = [str(name) for name in state["done"]]
            except (AttributeError, KeyError, TypeError, ValueError):
                raise ConfigurationError(f"{self.file}: is not the state of a study; --overwrite begins anew") from None

    def run(self, name: str, work: Callable[[], Result]) -> Result:
        """Run a phase, and add its duration to the time of earlier sessions."""
        began = time.monotonic()
        try:
            result = work()
            self.done = [*(phase for phase in self.done if phase != name), name]
            return result
        finally:
            self.seconds[name] = round(self.seconds.get(name, 0.0) + time.monotonic() - began, 1)
            state = {"format": STATE_FORMAT, "done": self.done, "seconds": self.seconds}
            write_whole(self.file, json.dumps(state, indent=1).encode())


def evaluate_study(
    study: StudySettings,
    controllers: Mapping[str, Controller],
    head: LeakageHead | None,
    folder: Path,
    display: ProgressDisplay,
    *,
    configuration: str,
    command: str,
    seed: int = 0,
    phases: Phases | None = None,
    training_curve: pd.DataFrame | None = None,
) -> Evaluation:
    """Evaluate controllers; write tables and report into the folder.

    If a controller fails, a message on standard error names it; the results of the others are written.
    """

    def work() -> Evaluation:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # the errors are printed below
            kept = folder if phases else None
            return evaluate(study.task, controllers, head, study.evaluation, display.update, kept)

    evaluation = phases.run("evaluate", work) if phases is not None else work()
    display.update("report", 0, 1)
    working: dict[str, Controller] = {}  # of several training seeds the first
    for name in (name for name in controllers if name not in evaluation.errors):
        working.setdefault(split_name(name)[0], controllers[name])
    levels = sorted(study.evaluation.leak_levels)
    curve = training_curve if training_curve is not None else pd.DataFrame()
    corrects = {name: entry.corrects for name, entry in study.controllers.items() if entry.corrects}
    corrected = Grid(evaluation.cases).corrected(corrects)
    write_tables(folder / "tables", {**tables_of(evaluation), "corrected": corrected})
    facts = {
        "command": command,
        "date": date_now(),
        "seed": str(seed),
        "machine": machine_description(),
        **package_versions(),
    }
    page = study_page(
        study.title,
        evaluation,
        facts,
        corrected=corrected,
        training_curve=curve,
        examples=example_traces(study.task, working, levels),
        timings=dict(phases.seconds) if phases is not None else {},
        configuration=configuration,
        validation_error_mm=validation_errors(study.task, next(iter(working.values())))[0] if len(curve) else np.nan,
    )
    page.write(folder / REPORT_FILE, Origin.of(facts))
    display.update("report", 1, 1)
    for error in evaluation.errors.values():
        print(f"hydro: {error}; the others were evaluated without it", file=sys.stderr)
    return evaluation


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> list[Path]:
    """Write every table, by name, that is not empty as CSV; returns the files.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    written = {folder / f"{name}.csv": table for name, table in tables.items() if not table.empty}
    for file, table in written.items():
        write_whole(file, table.to_csv(index=False).encode())
    return list(written)


def example_traces(config: TaskConfig, controllers: Mapping[str, Controller], levels: Sequence[float]) -> list[Example]:
    """Time traces of two test episodes under every controller, each at every leak level (l/min at 100 bar)."""
    kinds = [(family, level) for family in EXAMPLE_FAMILIES for level in levels]
    cases = Cases(
        np.full(len(kinds), EXPERIMENT_AXES.first, dtype=np.int64),
        np.array([level for _, level in kinds]),
        np.array([family for family, _ in kinds]),
    )
    runs = {name: run_cases(config, controller, cases) for name, controller in controllers.items()}
    first = next(iter(runs.values()))
    return [
        Example(
            title=EXAMPLE_FAMILIES[family],
            time=first.time,
            reference=first.reference[case],
            position={name: run.position[case] for name, run in runs.items()},
            command={name: run.command[case] for name, run in runs.items()},
            leak=level,
        )
        for case, (family, level) in enumerate(kinds)
    ]


def print_summary(evaluation: Evaluation, display: ProgressDisplay) -> None:
    """Print the page's main tables on the console, and one line for each controller that does not come to rest."""
    errors = overview(evaluation)
    if len(errors) <= MOST_COLUMNS:
        errors = errors.T
    display.console.lines(console_table(as_text(errors, "Errors and costs, mean over all runs")))
    if len(evaluation.detection_summary):
        display.console.lines(
            console_table(as_text(detection_table(evaluation.detection_summary), "Detection, summary"))
        )
    for row in evaluation.limit_cycle_summary.to_dict("records"):
        if warning := rest_warning(row["controller"], row, baseline=row["controller"] == evaluation.controllers[0]):
            display.say(warning)
