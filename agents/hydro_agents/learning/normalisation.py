"""Normalises the inputs of a network by their typical sizes: 10 µm and 10 mm are both visible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.running.seeds import SCALES
from hydro_env import ServoHydraulicVectorEnv, TaskConfig

AXES = 240
"""Training plants on which the inputs are observed."""

MIDDLE = 0.6
"""Share of the samples that stay within one unit."""

RARE = 0.3
"""Unit of an input that is constant most of the time, as a fraction of its standard deviation."""

LEAST = 0.02
"""An input is constant most of the time if its unit (from MIDDLE) is below this fraction of its standard deviation."""


class Normalisation(NamedTuple):
    """``arcsinh((input − centre) / unit)``: linear up to about one unit, logarithmic beyond; (inputs,) each."""

    centre: NDArray[np.float32]
    unit: NDArray[np.float32]

    def __call__(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """The normalised inputs, (N, inputs)."""
        normalised: NDArray[np.float32] = np.arcsinh((inputs - self.centre) / self.unit)
        return normalised


def observed(
    config: TaskConfig, inputs_and_commands: Callable[[NDArray[Any], Any, int], tuple[NDArray[Any], NDArray[Any], Any]]
) -> Normalisation:
    """Centre and unit of each input over one episode of training plants.

    Args:
        config: the task.
        inputs_and_commands: takes observations (N, n), its own memory (``None`` at first) and the step; returns inputs
            (N, inputs), commands (N, 1) and its memory.
    """
    env = ServoHydraulicVectorEnv(AXES, config, autoreset_mode="SameStep", info=False)
    observation, _ = env.reset(seed=list(SCALES.take(AXES)))
    memory, rows = None, []
    for step in range(config.steps):
        inputs, commands, memory = inputs_and_commands(observation, memory, step)
        rows.append(inputs)
        observation, *_ = env.step(commands)
    env.close()
    values = np.concatenate(rows).astype(np.float64)
    centre = np.median(values, axis=0)
    middle = np.quantile(np.abs(values - centre), MIDDLE, axis=0)
    spread = values.std(axis=0)
    unit = np.where(middle > LEAST * spread, middle, RARE * spread)
    return Normalisation(centre.astype(np.float32), np.where(unit > 1e-9, unit, 1.0).astype(np.float32))
