"""Runs a protocol: every controller under every condition, as independent jobs side by side through joblib."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.evaluation.limit_cycles import standstill_task
from hydro_agents.evaluation.participants import Participants, fingerprint, split_name
from hydro_agents.evaluation.robustness_jobs import BestFound, Job, Kind
from hydro_agents.evaluation.robustness_protocol import Protocol
from hydro_agents.running.cases import Cases, ControllerError, Rollout, run_cases
from hydro_agents.running.jobs import Report, run_jobs
from hydro_env import TaskConfig

DONE, NOT_APPLICABLE, FAILED = "done", "not applicable", "failed"
BEST_FOUND = "best found"


@dataclass(frozen=True)
class ProtocolRun:
    """Results of a protocol, as tables."""

    cases: pd.DataFrame  # one row per case with its metrics
    limit_cycles: pd.DataFrame  # one row per standstill; empty without a search
    bound: pd.DataFrame | None  # cases of the best found, if it was computed
    status: pd.DataFrame  # controller (with training seed), condition, status, message
    reused: int  # jobs with results from an earlier run

    @property
    def working(self) -> set[str]:
        """Names, with training seeds, of the controllers that ran under every condition that applies to them."""
        failed = set(self.status.loc[self.status["status"] == FAILED, "controller"])
        return set(self.status["controller"]) - failed

    @property
    def errors(self) -> list[str]:
        """One line per controller that failed, with its first failure."""
        failed = self.status[self.status["status"] == FAILED]
        return [f"{row['controller']} under {row['condition']}: {row['message']}" for _, row in failed.iterrows()]


def run_protocol(
    protocol: Protocol,
    chosen: Participants,
    folder: Path | None = None,
    jobs: int | None = None,
    progress: Report | None = None,
    best_found: BestFound | None = None,
) -> ProtocolRun:
    """Run all jobs of a protocol; finished ones in the folder are read, not run.

    An interruption keeps the finished jobs (:mod:`hydro_agents.running.jobs`).

    Args:
        protocol: the conditions.
        chosen: the controllers.
        folder: for the results of the jobs, one file each; ``None`` keeps none.
        jobs: number of jobs side by side; default: one per core, or that of the active ``parallel_config``.
        progress: called with the name of the phase, the number of finished jobs, and their total.
        best_found: runs the cases of the bound; ``None`` leaves the bound out.

    Raises:
        ControllerError: every controller failed in every condition.
        ConfigurationError: a file cannot be written.
    """
    cells, status = _plan(protocol, chosen)
    if best_found is not None:
        cells += _bound_plan(protocol, best_found)
    # Conditions that differ only in their references share the search for limit cycles.
    listed = {job.key: job for _, _, parts in cells for job in parts}
    results, reused = run_jobs(listed, folder, jobs, progress)
    frames: dict[Kind, list[pd.DataFrame]] = {"tracking": [], "standstill": [], "bound": []}
    for name, table, parts in cells:
        answers = [results[job.key] for job in parts]
        error = next((answer.error for answer in answers if answer.error), "")
        status.append((name, parts[0].condition, FAILED if error else DONE, error))
        if not error:
            metrics = {key: np.concatenate([answer.metrics[key] for answer in answers]) for key in parts[0].columns}
            controller, seed = split_name(name)
            frames[parts[0].kind].append(table.assign(controller=controller, training_seed=seed, **metrics))
    statuses = pd.DataFrame(status, columns=["controller", "condition", "status", "message"])
    # A pair has one row: a failure if any part failed.
    statuses = statuses.sort_values("message", ascending=False, kind="stable").drop_duplicates(
        ["controller", "condition"]
    )
    statuses = statuses.sort_index(ignore_index=True)
    if not frames["tracking"]:
        reasons = statuses.loc[statuses["message"] != "", "message"]
        raise ControllerError(f"no controller ran under any condition; the first reason: {reasons.iloc[0]}")
    tables = {kind: pd.concat(parts, ignore_index=True) for kind, parts in frames.items() if parts}
    return ProtocolRun(
        tables["tracking"], tables.get("standstill", pd.DataFrame()), tables.get("bound"), statuses, reused
    )


_Cell = tuple[str, pd.DataFrame, list[Job]]


def _plan(protocol: Protocol, chosen: Participants) -> tuple[list[_Cell], list[tuple[str, str, str, str]]]:
    """Jobs of each controller and condition with the table of their cases, and the pairs that cannot run."""
    cells, status = [], []
    digests: dict[int, str] = {}
    for condition in protocol.conditions:
        config = protocol.task_in(condition)
        kinds: list[tuple[Kind, TaskConfig, Cases, pd.DataFrame]] = [
            ("tracking", config, *protocol.cases_in(condition))
        ]
        if protocol.standstill_plants:
            kinds.append(("standstill", standstill_task(config), *protocol.standstill_cases_in(condition)))
        for name in chosen.controllers:
            controller = chosen.of(name, condition, protocol)
            if isinstance(controller, str):
                status.append((name, condition, NOT_APPLICABLE, controller))
                continue
            digest = digests.setdefault(id(controller), fingerprint(controller))
            for kind, task, cases, table in kinds:
                job = Job(name, condition, controller, task, cases, _families(table), kind, digest)
                cells.append(_cell(protocol, job, table))
    return cells, status


def _bound_plan(protocol: Protocol, best_found: BestFound) -> list[_Cell]:
    cells = []
    for condition in protocol.bound_conditions:
        cases, table = protocol.bound_cases_in(condition)
        task, digest = protocol.task_in(condition), fingerprint(best_found)
        job = Job(BEST_FOUND, condition, best_found, task, cases, _families(table), "bound", digest)
        cells.append(_cell(protocol, job, table))
    return cells


def _families(table: pd.DataFrame) -> NDArray[np.str_]:
    families: NDArray[np.str_] = table["family"].to_numpy().astype(str)
    return families


def _cell(protocol: Protocol, whole: Job, table: pd.DataFrame) -> _Cell:
    """A job in chunks, with the table of its cases."""
    group, size = protocol.conditions[whole.condition].group, protocol.chunk
    parts = [
        replace(whole, cases=whole.cases.part(first, first + size), families=whole.families[first : first + size])
        for first in range(0, len(whole.cases), size)
    ]
    return whole.name, table.assign(condition=whole.condition, group=group), parts


def replay(protocol: Protocol, chosen: Participants, row: Mapping[Any, Any]) -> Rollout:
    """Run one case again with its traces.

    Args:
        protocol: the protocol.
        chosen: the controllers.
        row: ``controller``, ``training_seed``, ``condition``, ``family``, ``leakage_flow_lpm``, ``seed``, as in
            the tables.

    Raises:
        ControllerError: the controller cannot run under this condition.
    """
    condition = str(row["condition"])
    name = next(
        name for name in chosen.controllers if split_name(name) == (row["controller"], int(row["training_seed"]))
    )
    controller = chosen.of(name, condition, protocol)
    if isinstance(controller, str):
        raise ControllerError(f"{name} under {condition}: {controller}")
    family = str(row["family"])
    cases = Cases(
        np.array([row["seed"]], dtype=np.int64),
        np.array([row["leakage_flow_lpm"]], dtype=np.float64),
        None if family == "user" else np.array([family]),
        protocol.parameters_in(condition),
    )
    return run_cases(protocol.task_in(condition), controller, cases)
