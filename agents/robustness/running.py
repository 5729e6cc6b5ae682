"""Runs a protocol: every controller under every condition, as independent jobs side by side through joblib."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal
from threading import current_thread, main_thread
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed, effective_n_jobs
from numpy.typing import NDArray

from agents.evaluation.limit_cycles import standstill_task
from agents.robustness.conditions import Protocol
from agents.robustness.jobs import BestFound, Job, JobResult, Kind, load_result, run_job, save_result
from agents.robustness.participants import Participants, fingerprint, split_name
from agents.running.cases import Cases, ControllerError, Rollout, run_cases
from hydro_env import TaskConfig

JOBS_FOLDER = "jobs"
DONE, NOT_APPLICABLE, FAILED = "done", "not applicable", "failed"
BEST_FOUND = "best found"
_JOBS_PER_ROUND = 4

Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ProtocolRun:
    """What a protocol gave, as tables."""

    cases: pd.DataFrame  # one row per case with its metrics
    limit_cycles: pd.DataFrame  # one row per standstill; empty without a search
    bound: pd.DataFrame | None  # cases of the best found, if it was computed
    status: pd.DataFrame  # controller (with training seed), condition, status, message
    reused: int  # jobs whose results were there already

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
    """Run all jobs of a protocol; finished ones in the folder are read instead.

    Every job is a pure function of protocol, condition and controller: neither their order nor the place where they
    run changes a bit of the results. The backend is the one of ``joblib.parallel_config``, by default one process per
    job. Interrupted, it keeps the finished jobs.

    Args:
        protocol: the conditions.
        chosen: the controllers.
        folder: for the results of the jobs, one file each; ``None`` keeps none.
        jobs: number of jobs side by side; default: one per core, or as the active ``parallel_config`` says.
        progress: called with the name of the phase, the number of finished jobs, and their total.
        best_found: runs the cases of the bound; ``None`` leaves the bound out.

    Raises:
        ControllerError: every controller failed in every condition.
        ConfigurationError: a file cannot be written.
    """
    cells, status = _plan(protocol, chosen)
    if best_found is not None:
        cells += _bound_plan(protocol, best_found)
    # Conditions that differ in their references alone share the search for limit cycles.
    listed = {job.key: job for _, _, parts in cells for job in parts}
    results: dict[str, JobResult] = {}
    for key, job in listed.items() if folder is not None else ():
        found = load_result(folder / JOBS_FOLDER / job.file, job) if folder is not None and job.digest else None
        if found is not None:
            results[key] = found
    reused = len(results)

    def report() -> None:
        if progress is not None:
            progress("jobs", len(results), len(listed))

    report()
    for key, result in _answers({key: job for key, job in listed.items() if key not in results}, jobs):
        results[key] = result
        job = listed[key]
        if folder is not None and job.digest and not result.error:
            save_result(folder / JOBS_FOLDER / job.file, result)
        report()
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
    # A pair has one row: its failure if it failed in any part.
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
    """Jobs of each controller and condition with the table of their cases; and the pairs that cannot run."""
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


def _named(key: str, job: Job) -> tuple[str, JobResult]:
    return key, run_job(job)


def _in_worker(key: str, job: Job) -> tuple[str, JobResult]:
    """Run a job in a process of the pool: there Ctrl-C is left to the process that waits."""
    if parent_process() is not None and current_thread() is main_thread():
        signal(SIGINT, SIG_IGN)
    return _named(key, job)


def _answers(waiting: Mapping[str, Job], jobs: int | None) -> Iterator[tuple[str, JobResult]]:
    """Results of jobs as they are ready, each with its key."""
    if not waiting:
        return
    first, *others = waiting.items()
    yield _named(*first)  # here: what it compiles, the other processes read from the disk
    calls = [delayed(_in_worker)(key, job) for key, job in others]
    pool: Any
    try:
        pool = Parallel(n_jobs=jobs, batch_size=1, return_as="generator_unordered")
    except ValueError:  # a backend that returns results only all at once
        pool = Parallel(n_jobs=jobs, batch_size=1)
        size = _JOBS_PER_ROUND * effective_n_jobs(jobs)
        for start in range(0, len(calls), size):
            yield from pool(calls[start : start + size])
        return
    yield from pool(calls)


def default_jobs() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
