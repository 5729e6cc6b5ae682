"""Jobs of the protocol that compute the Cramér–Rao bound of some of its windows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydro_agents.detection.operations import ACTING
from hydro_agents.estimation.information import information, sigma
from hydro_agents.estimation.known_windows import known_windows
from hydro_agents.estimation.unknowns import priors_of
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import JobResult, digest_of_code
from hydro_env import ConfigurationError, TaskConfig

FORMAT = "hydro_env bound job 1"
_ROOMS = ("controllers", "running", "detection", "estimation", "evaluation")


@dataclass(frozen=True)
class BoundJob:
    """The bound of windows of one condition and level; a pure function of its fields."""

    condition: str
    level: float
    config: TaskConfig  # of the runs
    known: TaskConfig  # for the priors
    acting: str
    begin: float  # s
    duration: float  # s
    cases: Cases
    digest: str = "bound"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of its result."""
        return ("seed", "sigma_lpm")

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.cases)

    @property
    def key(self) -> str:
        """A text that is unique in the protocol."""
        return f"bound|{self.condition}|{self.level:g}"

    @cached_property
    def file(self) -> str:
        """Name of the result file; it differs for every job and version of the code."""
        cases = self.cases
        assert cases.leakage_flow_lpm is not None
        numbers = [cases.seeds.tolist(), cases.leakage_flow_lpm.tolist(), cases.parameters, self.acting]
        parts = (
            FORMAT,
            digest_of_code(*_ROOMS),
            self.config.model_dump_json(),
            self.known.model_dump_json(),
            json.dumps([*numbers, self.begin, self.duration]),
        )
        return f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"

    def run(self) -> JobResult:
        """Smallest standard deviation of the leak, l/min at 100 bar; all quantities that the task draws are unknown."""
        controller = ACTING[self.acting].make(self.config, self.count, int(self.cases.seeds[0]))
        try:
            windows = known_windows(self.config, controller, self.cases, self.begin, self.duration)
            known = information(self.config, windows, priors_of(self.known), threads=1)
        except ConfigurationError as error:
            return JobResult({}, f"the bound cannot be computed: {error}")
        found = np.full(self.count, np.nan)
        found[windows.case] = sigma(known)[:, -1]
        return JobResult({"seed": self.cases.seeds.astype(np.float64), "sigma_lpm": found})


def bound_plan(protocol: LeakProtocol) -> Iterator[BoundJob]:
    """The jobs of a protocol."""
    for name in protocol.bound_conditions:
        condition, config = protocol.conditions[name], protocol.task_in(name)
        begin = 0.0 if condition.begins == "at rest" else condition.duration
        for level in protocol.levels_in(name):
            if level >= 0.0:
                cases = protocol.cases_in(name, level, protocol.bound_windows)
                yield BoundJob(
                    name,
                    level,
                    config,
                    protocol.known_task(name),
                    condition.acting,
                    begin,
                    condition.duration - config.control_period,
                    cases,
                )
