"""One job of a protocol: a controller on a few cases of one condition; its result is one file."""

from __future__ import annotations

import hashlib
import io
import json
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Controller
from agents.evaluation.limit_cycles import LIMIT_CYCLE, standstill_metrics
from agents.evaluation.metrics import METRICS, rollout_metrics
from agents.running.cases import Cases, ControllerError, Rollout, run_cases
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.compiling import SOURCES
from hydro_env.files import write_whole

FORMAT = "hydro_env robustness job 1"
_ROOMS = ("controllers", "running", "learning", "evaluation", "bound")

Kind = Literal["tracking", "standstill", "bound"]
"""Ordinary cases; the search for limit cycles, with the task of a standstill; cases of the best found."""

BestFound = Callable[[TaskConfig, Cases], Rollout]
"""Runs cases under the best commands that a search finds."""


@dataclass(frozen=True)
class Job:
    """A pure function of its fields: the same job gives the same numbers wherever and beside whatever it runs."""

    name: str
    condition: str
    controller: Controller | BestFound
    config: TaskConfig
    cases: Cases
    families: NDArray[np.str_]
    kind: Kind = "tracking"
    digest: str = ""  # of the controller; empty: its result is not used again

    def rollout(self) -> Rollout:
        """Run the cases.

        Raises:
            ControllerError: the controller failed.
            ConfigurationError: an episode cannot begin.
        """
        if self.kind == "bound":
            return cast(BestFound, self.controller)(self.config, self.cases)
        return run_cases(self.config, cast(Controller, self.controller), self.cases)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its metrics."""
        return tuple(LIMIT_CYCLE if self.kind == "standstill" else METRICS)

    @property
    def key(self) -> str:
        """A text that jobs share if they give the same numbers."""
        return self.file if self.digest else f"{self.name}|{self.condition}|{self.file}"

    @cached_property
    def file(self) -> str:
        """Name of the file of its result; another job, controller or version of the code has another name."""
        parts = (
            FORMAT,
            _code(),
            self.digest,
            self.config.model_dump_json(),
            json.dumps([self.cases.seeds.tolist(), self.families.tolist(), self.cases.parameters, self.kind]),
            str(self.cases.leakage_flow_lpm.tolist() if self.cases.leakage_flow_lpm is not None else None),
        )
        return f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"


@dataclass(frozen=True)
class JobResult:
    """Metrics of a job's cases, each (N,); or the reason why there are none."""

    metrics: dict[str, NDArray[np.float64]]
    error: str = ""


def run_job(job: Job) -> JobResult:
    """Run the cases of a job; an error of the controller or of the task becomes the result."""
    if "torch" in sys.modules:  # as many jobs as cores run side by side
        sys.modules["torch"].set_num_threads(1)
    preview = max(job.config.references.preview_times, default=0.0)
    try:
        rollout = job.rollout()
    except ControllerError as error:
        return JobResult({}, str(error))
    except ConfigurationError as error:
        return JobResult({}, f"the condition cannot begin: {error}")
    if job.kind == "standstill":
        return JobResult(standstill_metrics(rollout, job.config))
    found = rollout_metrics(rollout, job.families, job.config.control_period, preview)
    return JobResult({name: values.astype(np.float64) for name, values in found.items()})


def save_result(path: Path, result: JobResult) -> None:
    """Write a result, whole or not at all.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **result.metrics)
    write_whole(path, content.getvalue())


def load_result(path: Path, job: Job) -> JobResult | None:
    """Read the result of a job; ``None`` if there is none, or the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            metrics = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = set(metrics) == set(job.columns) and all(
        values.shape == (len(job.cases),) and values.dtype == np.float64 for values in metrics.values()
    )
    return JobResult({name: metrics[name] for name in job.columns}) if whole else None


@cache
def _code() -> str:
    """Digest of the code that a result depends on."""
    digest = hashlib.sha256(str(SOURCES).encode())
    for room in _ROOMS:
        for file in sorted((Path(__file__).resolve().parents[1] / room).glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()
