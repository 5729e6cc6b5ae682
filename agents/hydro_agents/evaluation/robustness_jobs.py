"""One job of a protocol: a controller on a few cases of one condition; its result is one file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.limit_cycles import LIMIT_CYCLE, standstill_metrics
from hydro_agents.evaluation.metrics import METRICS, rollout_metrics
from hydro_agents.running.cases import Cases, ControllerError, Rollout, run_cases
from hydro_agents.running.jobs import JobResult, digest_of_code
from hydro_env import ConfigurationError, TaskConfig

FORMAT = "hydro_env robustness job 1"
_ROOMS = ("controllers", "running", "learning", "evaluation")

Kind = Literal["tracking", "standstill", "bound"]
"""Ordinary cases; the search for limit cycles, with the task of a standstill; cases of the best found."""

BestFound = Callable[[TaskConfig, Cases], Rollout]
"""Runs cases under the best commands that a search finds."""


@dataclass(frozen=True)
class Job:
    """A pure function of its fields: the same job gives the same numbers on every machine and beside any other job."""

    name: str
    condition: str
    controller: Controller | BestFound
    config: TaskConfig
    cases: Cases
    families: NDArray[np.str_]
    kind: Kind = "tracking"
    digest: str = ""  # of the controller; empty: its result is not reused

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
    def count(self) -> int:
        """Number of cases."""
        return len(self.cases)

    @property
    def key(self) -> str:
        """A text that is equal for jobs with the same numbers."""
        return self.file if self.digest else f"{self.name}|{self.condition}|{self.file}"

    @cached_property
    def file(self) -> str:
        """Name of the result file; it differs for every job, controller and version of the code."""
        parts = (
            FORMAT,
            digest_of_code(*_ROOMS),
            self.digest,
            self.config.model_dump_json(),
            json.dumps([self.cases.seeds.tolist(), self.families.tolist(), self.cases.parameters, self.kind]),
            str(self.cases.leakage_flow_lpm.tolist() if self.cases.leakage_flow_lpm is not None else None),
        )
        return f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"

    def run(self) -> JobResult:
        """Run the cases; an error of the controller or of the task becomes the result."""
        preview = max(self.config.references.preview_times, default=0.0)
        try:
            rollout = self.rollout()
        except ControllerError as error:
            return JobResult({}, str(error))
        except ConfigurationError as error:
            return JobResult({}, f"the condition cannot begin: {error}")
        if self.kind == "standstill":
            return JobResult(standstill_metrics(rollout, self.config))
        found = rollout_metrics(rollout, self.families, self.config.control_period, preview)
        return JobResult({name: values.astype(np.float64) for name, values in found.items()})
