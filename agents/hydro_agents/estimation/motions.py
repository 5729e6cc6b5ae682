"""Motions for the tables of the bound: the task's own, slow motion, and rest."""

from __future__ import annotations

from collections.abc import Callable

from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

SLOWER = 16.0
"""Factor by which slow motion is slower."""

SMALLEST_STEP = 1e-6
"""m; steps of this size count as rest."""


def slow(config: TaskConfig) -> TaskConfig:
    """The task with smooth references that are 16 times slower."""
    references = config.references
    weights = {name: weight for name, weight in references.weights.items() if name not in ("step", "user")}
    if not sum(weights.values()) > 0.0:
        weights = {"point_to_point": 1.0}
    return task_config(
        config,
        references={
            "weights": weights,
            "speed_share": references.speed_share / SLOWER,
            "acceleration_limit": max(references.acceleration_limit / SLOWER**2, 0.01),
            "frequency_range": tuple(one / SLOWER for one in references.frequency_range),
        },
    )


def at_rest(config: TaskConfig) -> TaskConfig:
    """The task with constant references at the start of each episode."""
    return task_config(config, references={"weights": {"step": 1.0}, "step_range": (SMALLEST_STEP, SMALLEST_STEP)})


MOTIONS: dict[str, Callable[[TaskConfig], TaskConfig]] = {
    "ordinary motion": lambda config: config,
    "slow motion": slow,
    "at rest": at_rest,
}
"""The task of each motion."""
