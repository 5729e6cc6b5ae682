"""Optimises the gains of the PID on training plants with all leak levels and reference families."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from agents.controllers.base import Controller
from agents.controllers.pid import PID, PIDGains
from agents.running.seeds import TRAINING_SEEDS
from hydro_env import REFERENCE_FAMILIES, ServoHydraulicVectorEnv, TaskConfig

SEARCH: dict[str, tuple[float, float, bool]] = {
    "proportional": (2.0, 2000.0, True),
    "integral": (1.0, 1e5, True),
    "derivative": (0.0, 3.0, False),
    "derivative_filter_time": (1e-3, 0.05, True),
    "feedforward_extending": (0.0, 20.0, False),
    "feedforward_retracting": (0.0, 20.0, False),
    "feedforward_lead": (0.0, 0.03, False),
    "reference_lead": (0.0, 0.03, False),
    "anti_windup_time": (0.005, 1.0, True),
}
"""Lower bound, upper bound, and whether the search runs over the logarithm."""

LEAK_LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)


def gains_from_vector(vector: NDArray[np.float64]) -> PIDGains:
    """Gains from a point of the search space (9,), or arrays of gains from many (9, N)."""
    values = {
        name: np.exp(value) if logarithmic else value
        for (name, (_, _, logarithmic)), value in zip(SEARCH.items(), vector, strict=True)
    }
    if vector.ndim == 1:
        return PIDGains(**{name: float(value) for name, value in values.items()})
    return PIDGains.model_construct(**values)


def mean_costs(
    env: ServoHydraulicVectorEnv, controller: Controller, seeds: Sequence[int], options: dict[str, Any]
) -> NDArray[np.float64]:
    """Mean cost per control period of one episode on every axis, (N,).

    An axis that fails pays the worst tracking cost for the rest of its episode.

    Args:
        env: N axes with automatic resets.
        controller: the controller.
        seeds: seeds of the axes.
        options: options of the reset.
    """
    task, memory = env.config, None
    worst = task.reward.tracking * task.reward.error_limit
    observation, _ = env.reset(seed=seeds, options=options)
    total, alive = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=np.bool_)
    for _ in range(task.steps):
        action, memory = controller.predict(observation, memory)
        observation, reward, terminated, _, _ = env.step(action)
        total += np.where(alive, -reward, worst)
        alive &= ~terminated
    return total / task.steps


def tune_pid(
    config: TaskConfig,
    plants: int = 126,
    generations: int = 80,
    population: int = 6,
    seed: int = 0,
    progress: Callable[[int, float, PIDGains], None] | None = None,
) -> tuple[PIDGains, float]:
    """Optimise the gains by differential evolution on the mean absolute error, the measure of the evaluation.

    The cost keeps the reward's small penalty on changes of the command, which prevents chatter. Every candidate drives
    the same training plants, references and noise; leak levels and families are spread evenly over them.

    Args:
        config: the task.
        plants: axes per candidate; a multiple of levels × families gives each combination the same number.
        generations: number of generations of the search.
        population: candidates per gain.
        seed: seed of the search and of the training plants.
        progress: called with the generation, the lowest mean cost so far and its gains.

    Returns:
        The gains, and their mean cost per step on the training plants.
    """
    families = [name for name in REFERENCE_FAMILIES if config.references.weights.get(name, 0.0) > 0.0]
    leak = np.array([LEAK_LEVELS[index % len(LEAK_LEVELS)] for index in range(plants)])
    names = [families[(index // len(LEAK_LEVELS)) % len(families)] for index in range(plants)]
    environments: dict[int, ServoHydraulicVectorEnv] = {}

    def costs(points: NDArray[np.float64]) -> NDArray[np.float64]:
        points = points.reshape(len(SEARCH), -1)
        candidates = points.shape[1]
        if candidates not in environments:
            environments[candidates] = ServoHydraulicVectorEnv(
                candidates * plants, config, autoreset_mode="SameStep", info=False
            )
        first = TRAINING_SEEDS.start + (seed * plants) % (len(TRAINING_SEEDS) - plants)
        cost = mean_costs(
            environments[candidates],
            PID(gains_from_vector(np.repeat(points, plants, axis=1)), config),
            list(range(first, first + plants)) * candidates,
            {"leakage_flow_lpm": np.tile(leak, candidates), "reference": names * candidates},
        )
        return np.asarray(cost.reshape(candidates, plants).mean(axis=1))

    bounds = [(np.log(low), np.log(high)) if log else (low, high) for low, high, log in SEARCH.values()]
    generation = 0

    def report(intermediate_result: Any) -> None:
        nonlocal generation
        generation += 1
        if progress is not None:
            best = gains_from_vector(np.asarray(intermediate_result.x))
            progress(generation, float(intermediate_result.fun), best)

    result = differential_evolution(
        costs,
        bounds,
        maxiter=generations,
        popsize=population,
        rng=seed,
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=1e-4,
        callback=report,
    )
    for env in environments.values():
        env.close()
    return gains_from_vector(result.x), float(result.fun)
