"""All experiments on a list of controllers, as tables by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any

import pandas as pd
from joblib import Parallel, delayed

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.frequency import frequency_response
from hydro_agents.evaluation.leak_price import leak_price
from hydro_agents.evaluation.standstill import standstill
from hydro_agents.evaluation.stiffness import force_sine, force_step
from hydro_agents.running.cases import ControllerError
from hydro_agents.running.jobs import side_by_side
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_env import TaskConfig

EXPERIMENTS: dict[str, Callable[..., pd.DataFrame]] = {
    "frequency": frequency_response,
    "force_step": force_step,
    "force_sine": force_sine,
    "standstill": standstill,
}
"""Experiments with a controller in the loop: (config, controllers, plants=, first_seed=) to a table."""


def run_experiments(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    plants: int | None = None,
    first_seed: int = EXPERIMENT_AXES.first,
    jobs: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[dict[str, pd.DataFrame], dict[str, str]]:
    """Run every experiment on every controller.

    Each pair of controller and experiment is independent: the rows of a controller do not depend on the others.

    Args:
        config: the task.
        controllers: by name.
        plants: number of plants; default: that of each experiment.
        first_seed: seed of the first plant.
        jobs: number of pairs that run side by side through joblib; does not change results.
        progress: called with the name of the phase, the number of finished pairs, and their total.

    Returns:
        Tables by name (those of :data:`EXPERIMENTS`, and ``leak_price``), and the message of each controller that
        raised an exception or returned commands that are not finite; only its rows are missing.
    """
    size: dict[str, Any] = {"first_seed": first_seed} | ({} if plants is None else {"plants": plants})
    pairs = [(experiment, name) for experiment in EXPERIMENTS for name in controllers]
    calls = [delayed(_run)(experiment, config, name, controllers[name], size) for experiment, name in pairs]
    parts: dict[str, list[pd.DataFrame]] = {name: [] for name in EXPERIMENTS}
    errors: dict[str, str] = {}
    if progress is not None:
        progress("experiments", 0, len(pairs))
    with closing(side_by_side(Parallel(n_jobs=jobs, return_as="generator"), calls)) as answers:
        for done, ((experiment, name), (table, error)) in enumerate(zip(pairs, answers, strict=True), 1):
            if error:
                errors.setdefault(name, f"{name}: {experiment}: {error}")
            else:
                parts[experiment].append(table)
            if progress is not None:
                progress("experiments", done, len(pairs))
    tables = {name: pd.concat(frames, ignore_index=True) for name, frames in parts.items() if frames}
    return {**tables, "leak_price": leak_price(config)}, errors


def _run(
    experiment: str, config: TaskConfig, name: str, controller: Controller, size: Mapping[str, Any]
) -> tuple[pd.DataFrame, str]:
    """The rows of one controller, or the message of its failure."""
    try:
        return EXPERIMENTS[experiment](config, {name: controller}, **size), ""
    except ControllerError as error:
        return pd.DataFrame(), str(error)
