"""Errors of a policy on validation plants, for the training log, and of a controller on training plants."""

from __future__ import annotations

import math

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import LEARNING_CURVE, SCALES
from hydro_env import TaskConfig


def validation_cases(config: TaskConfig) -> Cases:
    """One plant for each family of references at three leaks: healthy, incipient, and the largest of the task."""
    leakage = config.leakage
    leaks = (math.sqrt(math.prod(leakage.healthy_range)), leakage.class_bounds[1], leakage.faulty_range[1])
    families = [name for name, weight in config.references.weights.items() if weight > 0.0]
    grid = [(leak, family) for leak in leaks for family in families]
    seeds = np.array(LEARNING_CURVE.take(len(grid)))
    return Cases(seeds, np.array([leak for leak, _ in grid]), np.array([family for _, family in grid]))


def validation_errors(config: TaskConfig, controller: Controller) -> tuple[float, float, int]:
    """Mean absolute tracking error over all cases (mm), that of the worst case (mm), and number of failed cases."""
    run = run_cases(config, controller, validation_cases(config))
    errors = 1e3 * np.abs(run.position - run.reference).mean(axis=1)
    return float(errors.mean()), float(errors.max()), int((run.failed_at >= 0).sum())


def family_errors(config: TaskConfig, controller: Controller, plants: int = 16) -> dict[str, float]:
    """Mean absolute tracking error (m) of a controller in each family of references, on training plants."""
    families = [name for name, weight in config.references.weights.items() if weight > 0.0]
    seeds = np.tile(np.array(SCALES.take(plants, SCALES.count - plants)), len(families))
    run = run_cases(config, controller, Cases(seeds, families=np.repeat(families, plants)))
    errors = np.abs(run.position - run.reference).mean(axis=1).reshape(len(families), plants).mean(axis=1)
    return dict(zip(families, errors.tolist(), strict=True))
