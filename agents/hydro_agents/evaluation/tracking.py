"""The part that runs controllers on paired cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.conditions import Cell
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.robustness_protocol import PairedProtocol
from hydro_agents.running.cases import Cases, ControllerError, Rollout, run_cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_env import ConfigurationError, TaskConfig


def tracking(protocol: PairedProtocol, chosen: Participants) -> Iterator[Cell]:
    """Every controller on the cases of every condition."""
    for condition in protocol.conditions:
        yield from paired_cells(protocol, chosen, condition, protocol.task_in(condition), *protocol.cases_in(condition))


def paired_cells(
    protocol: PairedProtocol,
    chosen: Participants,
    condition: str,
    task: TaskConfig,
    cases: Cases,
    table: pd.DataFrame,
    work: Callable[..., Columns] | None = None,
) -> Iterator[Cell]:
    """Every controller on some cases of a condition; ``work`` measures them (default: :func:`tracked`)."""
    for name in chosen.controllers:
        controller = chosen.of(name, condition, protocol)
        if isinstance(controller, str):
            yield Cell(name, condition, refused=controller)
        else:
            yield cell_of(protocol, name, condition, controller, task, cases, table, work or tracked)


def cell_of(
    protocol: PairedProtocol,
    name: str,
    condition: str,
    participant: Any,
    task: TaskConfig,
    cases: Cases,
    table: pd.DataFrame,
    work: Callable[..., Columns],
) -> Cell:
    """The cases of one participant in chunks, with their table."""
    controller, seed = split_name(name)
    digest, families = fingerprint(participant), table["family"].to_numpy().astype(str)
    jobs = []
    for first in range(0, len(cases), protocol.chunk):
        last = first + protocol.chunk
        arguments = (task, cases.part(first, last), families[first:last])
        jobs.append(Job(work, participant, arguments, digest))
    known = {
        **{str(column): table[column].to_numpy() for column in table},
        "condition": condition,
        "group": protocol.conditions[condition].group,
        "controller": controller,
        "training_seed": seed,
    }
    return Cell(name, condition, known, tuple(jobs))


def tracked(controller: Controller, config: TaskConfig, cases: Cases, families: NDArray[np.str_]) -> Columns:
    """The metrics of cases under a controller.

    Raises:
        ControllerError: the controller failed.
        ConfigurationError: an episode cannot begin.
    """
    return metrics_of(begun(run_cases, config, controller, cases), config, families)


def begun(run: Callable[..., Rollout], *arguments: Any) -> Rollout:
    """What a function runs; an error at its start names the condition."""
    try:
        return run(*arguments)
    except ControllerError:
        raise
    except ConfigurationError as error:
        raise ConfigurationError(f"the condition cannot begin: {error}") from None


def metrics_of(rollout: Rollout, config: TaskConfig, families: NDArray[np.str_]) -> Columns:
    """The metrics of cases that have run."""
    preview = max(config.references.preview_times, default=0.0)
    found = rollout_metrics(rollout, families, config.control_period, preview)
    return {name: values.astype(np.float64) for name, values in found.items()}


def replay(protocol: PairedProtocol, chosen: Participants, row: Mapping[Any, Any]) -> Rollout:
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
