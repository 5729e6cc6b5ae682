"""Simulates the held-back part of a recording from its start and its commands, and compares it with the readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.estimation.estimate import estimate
from hydro_agents.estimation.model import Model, noise_of
from hydro_agents.estimation.unknowns import priors_of
from hydro_agents.recordings.columns import COMMAND
from hydro_agents.rigs.identification_fit import starts_of
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.parameters import to_vector
from hydro_env.task.sensors import SENSORS

Array = NDArray[np.float64]

START_FROM = 0.2
"""s; the initial state comes from this first part; afterwards the simulation uses only the commands."""

LEAST_MOTION = 20.0
"""Smallest standard deviation of a channel, as a multiple of its noise, for a meaningful share of variance."""


class HeldBack(NamedTuple):
    """The held-back part, measured and simulated."""

    begin: float  # s
    time: Array  # (T,), s, from its begin
    measured: Array  # (channels, T), SI
    simulated: Array  # (channels, T), SI, biases included
    share: Array  # (channels,), share of variance explained; NaN for an absent channel, or one without motion


def simulate_held_back(
    signals: Array, begin: float, config: TaskConfig, plant: PlantParameters, biases: Sequence[float]
) -> HeldBack:
    """Simulate a plant on the held-back part; only the initial state comes from its readings, in the first 0.2 s.

    Args:
        signals: (5, T), SI, in the order of SIGNALS.
        begin: of the part in the recording, s.
        config: the task.
        plant: the identified plant.
        biases: of each channel, SI.
    """
    bias = np.asarray(biases)[:, None]
    measured = signals[: len(SENSORS)]
    unbiased = np.concatenate([measured - bias, signals[None, COMMAND]])
    physical = to_vector(plant)[None]
    count = max(round(START_FROM / config.control_period), 10)
    names = starts_of(config)
    found = estimate(unbiased[None, :, : count + 1], config, names, physical=physical)
    model = Model(config, priors_of(config, names), signals[None, COMMAND], physical=physical)
    read, _ = model.readings(found.scaled, np.zeros(1, np.int64))
    simulated = read[0] * model.noise[:, None] + bias
    time = config.control_period * np.arange(signals.shape[1], dtype=np.float64)
    motion = np.array([np.nanstd(row) if np.isfinite(row).any() else 0.0 for row in measured])
    share = np.array([_share(*pair) for pair in zip(measured, simulated, strict=True)])
    share[motion < LEAST_MOTION * noise_of(config)] = np.nan
    return HeldBack(begin, time, measured, simulated, share)


def _share(measured: Array, simulated: Array) -> float:
    """Share of the variance that the simulation explains: 1 − mean square error over variance; −∞ after a failure."""
    known = np.isfinite(measured)
    if not known.any():
        return float("nan")
    error = measured[known] - simulated[known]
    share = 1.0 - float(np.mean(error**2)) / max(float(measured[known].var()), 1e-300)
    return share if np.isfinite(share) else float("-inf")
