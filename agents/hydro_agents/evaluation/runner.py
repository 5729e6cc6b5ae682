"""Runs a protocol: the jobs of all its parts side by side, and the tables of their results.

A table is a function of the results, registered by its name in a module of a kind of protocols::

    @table("ranking")
    def ranking(results: Results) -> pd.DataFrame: ...  # or an iterator of rows

The rows of the jobs are tables too, named by ``parts`` of the protocol.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from hydro_agents.evaluation.conditions import Cell, Protocol
from hydro_agents.running.cases import ControllerError
from hydro_agents.running.jobs import Job, JobResult, Report, run_jobs
from hydro_env.files import write_whole

if TYPE_CHECKING:
    from hydro_agents.evaluation.comparison import Grid

Facts = Sequence[tuple[str, str]]  # of a run: key and value
DONE, NOT_APPLICABLE, FAILED = "done", "not applicable", "failed"


@dataclass
class Results:
    """Results of a protocol: the rows of each part, and every table that follows from them."""

    protocol: Any  # of its kind, whose tables know its keys
    participants: Any
    rows: Mapping[str, pd.DataFrame]  # by part; a part without results is absent
    status: pd.DataFrame  # participant (with training seed), condition, status, message
    facts: Facts = ()  # more rows of the table ``protocol``: key and value
    _made: dict[str, pd.DataFrame] = field(default_factory=dict)

    def part(self, name: str) -> pd.DataFrame:
        """Rows of a part, empty if there are none."""
        return self.rows.get(name, pd.DataFrame())

    @cached_property
    def grid(self) -> "Grid":
        """The cases of the controllers as arrays."""
        from hydro_agents.evaluation.comparison import Grid  # of controllers alone

        return Grid(self.part("cases"))

    @property
    def controllers(self) -> list[str]:
        """Names of the controllers that have results, in their order."""
        return self.grid.controllers

    def table(self, name: str) -> pd.DataFrame:
        """A table by the name of its CSV file; it is made once."""
        if name not in self._made:
            self._made[name] = pd.DataFrame(tables_of(self.protocol)[name](self))
        return self._made[name]

    def tables(self) -> dict[str, pd.DataFrame]:
        """Every table of this kind of protocol by the name of its CSV file; without those that are empty."""
        made = {name: self.table(name) for name in tables_of(self.protocol)}
        return {name: table for name, table in made.items() if not table.empty}

    def write(self, folder: Path) -> None:
        """Write the tables as CSV.

        Raises:
            ConfigurationError: a file cannot be written.
        """
        for name, table in self.tables().items():
            write_whole(folder / f"{name}.csv", table.to_csv(index=False).encode())

    @property
    def errors(self) -> list[str]:
        """One line per failure."""
        failed = self.status[self.status["status"] == FAILED].to_dict("records")
        return [f"{row[self.protocol.who]} under {row['condition']}: {row['message']}" for row in failed]


Rows = Iterator[dict[str, Any]]
TableFunction = Callable[[Results], pd.DataFrame | Rows]
_TABLES: dict[str, dict[str, TableFunction]] = {}
_MODULES = {"robustness": "tracking_tables", "leakage": "leak_tables"}  # modules with the tables of a kind of protocol


def table(name: str) -> Callable[[TableFunction], TableFunction]:
    """Register a function of the results as a table of the protocols to which its module belongs."""

    def register(function: TableFunction) -> TableFunction:
        _TABLES.setdefault(function.__module__, {})[name] = function
        return function

    return register


@table("protocol")
def facts(results: Results) -> pd.DataFrame:
    """Keys and values: what ran, when, and where."""
    protocol = results.protocol
    own = [("protocol", protocol.title), ("sha256", protocol.sha256), ("conditions", str(len(protocol.conditions)))]
    return pd.DataFrame([*own, *results.facts], columns=["key", "value"])


@table("conditions")
def conditions(results: Results) -> Rows:
    """One row per condition: its changes of the task, and how it is shown."""
    yield from results.protocol.rows()


@table("status")
def status(results: Results) -> pd.DataFrame:
    """What became of every participant under every condition."""
    return results.status


def tables_of(protocol: Protocol[Any]) -> dict[str, TableFunction]:
    """Tables of a protocol by name: the rows of its jobs, then those that are made of them."""
    module = import_module(f"{__package__}.{_MODULES[protocol.kind]}").__name__
    return {name: methodcaller("part", name) for name in protocol.parts} | _TABLES[__name__] | _TABLES[module]


def run(
    protocol: Protocol[Any], chosen: Any, folder: Path | None = None, progress: Report | None = None, facts: Facts = ()
) -> Results:
    """Run all jobs of a protocol where the active ``parallel_config`` says; finished ones in the folder are read.

    An interruption keeps the finished jobs (:mod:`hydro_agents.running.jobs`).

    Args:
        protocol: conditions and parts.
        chosen: the participants.
        folder: for the results of the jobs, one file each; ``None`` keeps none.
        progress: called with the name of the phase, the number of finished jobs, and their total.
        facts: more rows of the table ``protocol``: key and value.

    Raises:
        ControllerError: every participant failed in every condition.
        ConfigurationError: a file cannot be written.
    """
    cells = list(protocol.cells(chosen))
    listed: dict[str, Job] = {}
    keys = []
    for number, cell in enumerate(cells):
        # Equal jobs have one key and run once: conditions that differ only in their references share standstills.
        keys.append([job.file if job.digest else f"{number}|{place}" for place, job in enumerate(cell.jobs)])
        listed |= dict(zip(keys[-1], cell.jobs, strict=True))
    answers = run_jobs(listed, folder, progress)
    rows, statuses = collect(cells, [[answers[key] for key in own] for own in keys], protocol.who)
    if protocol.parts[0] not in rows:
        reasons = statuses[statuses["message"] != ""].drop_duplicates(protocol.who)
        lines = "; ".join(f"{row[protocol.who]}: {row['message']}" for row in reasons.to_dict("records"))
        raise ControllerError(f"no {protocol.who} ran under any condition; {lines}")
    return Results(protocol, chosen, rows, statuses, facts)


def collect(
    cells: Sequence[Cell], answers: Sequence[Sequence[JobResult]], who: str
) -> tuple[dict[str, pd.DataFrame], pd.DataFrame]:
    """The rows of each table that has some, and what became of every participant under every condition.

    A participant that failed in one table has no rows of this condition in the others.
    """
    told: dict[tuple[str, str], tuple[str, str]] = {}  # status and first error by participant and condition
    for cell, own in zip(cells, answers, strict=True):
        place = cell.participant, cell.condition
        error = cell.refused or next((answer.error for answer in own if answer.error), "")
        status = FAILED if error else DONE
        if told.get(place, (DONE, ""))[0] == DONE:
            told[place] = NOT_APPLICABLE if cell.refused else status, error
    frames: dict[str, list[pd.DataFrame]] = {}
    for cell, own in zip(cells, answers, strict=True):
        if own and told[cell.participant, cell.condition][0] == DONE:
            metrics = [answer.metrics for answer in own]
            own_columns = {name: np.concatenate([each[name] for each in metrics]) for name in metrics[0]}
            frames.setdefault(cell.table, []).append(pd.DataFrame(cell.known | own_columns))
    rows = {name: pd.concat(each, ignore_index=True) for name, each in frames.items()}
    columns = [who, "condition", "status", "message"]
    return rows, pd.DataFrame([(*place, *what) for place, what in told.items()], columns=columns)
