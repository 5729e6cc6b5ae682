"""Parts of a protocol on paired cases: controllers in motion and at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.conditions import Cell, beginning
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.limit_cycles import standstill_metrics, standstill_task
from hydro_env import TaskConfig


def tracking(protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """Every controller on the cases of every condition."""
    for condition in protocol.conditions:
        task, cases = protocol.task_in(condition), protocol.cases_in(condition)
        yield from _cells(protocol, chosen, condition, tracked, task, cases)


def standstill(protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """Every controller after a small step of the reference and back, under every condition."""
    for condition in protocol.conditions:
        task, cases = standstill_task(protocol.task_in(condition)), protocol.standstill_cases_in(condition)
        yield from _cells(protocol, chosen, condition, at_rest, task, cases)


def _cells(
    protocol: RobustnessProtocol,
    chosen: Participants,
    condition: str,
    work: Callable[..., Columns],
    task: TaskConfig,
    listed: pd.DataFrame,
) -> Iterator[Cell]:
    """The listed cases under a condition, a cell for each controller, in chunks that ``work`` measures."""
    cases = protocol.cases_of(condition, listed)
    known = {
        **{str(column): listed[column].to_numpy() for column in listed},
        "condition": condition,
        "group": protocol.conditions[condition].group,
    }
    for name in chosen.controllers:
        acting = chosen.of(name, condition, protocol)
        if isinstance(acting, str):
            yield Cell(name, condition, refused=acting)
            continue
        controller, seed = split_name(name)
        digest = fingerprint(acting)
        jobs = tuple(Job(work, acting, (task, part), digest) for part in cases.chunks(protocol.chunk))
        yield Cell(name, condition, {**known, "controller": controller, "training_seed": seed}, jobs)


def tracked(controller: Controller, config: TaskConfig, cases: Cases) -> Columns:
    """The metrics of cases under a controller.

    Raises:
        ControllerError: the controller failed.
        ConfigurationError: an episode cannot begin.
    """
    with beginning():
        rollout = run_cases(config, controller, cases)
    families = np.full(len(cases), "user") if cases.families is None else cases.families
    preview = max(config.references.preview_times, default=0.0)
    metrics = rollout_metrics(rollout, families, config.control_period, preview)
    return {name: values.astype(np.float64) for name, values in metrics.items()}


def at_rest(controller: Controller, config: TaskConfig, cases: Cases) -> Columns:
    """Limit cycles of cases whose task is a standstill."""
    with beginning():
        rollout = run_cases(config, controller, cases)
    return standstill_metrics(rollout, config)
