"""What windows tell of their unknowns at given values: the Fisher information, and the uncertainty that it leaves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.estimation.model import Model
from hydro_env.task.sensors import CHANNELS

Array = NDArray[np.float64]

ROUNDS = 2
"""Times that the steps of the differences are adapted to the uncertainty that they give."""


class Information(NamedTuple):
    """Information of B windows about P unknowns, at the values where it was computed."""

    fisher: Array  # (B, channels, P, P), of each channel, scaled unknowns; their sum is that of the window
    jacobian: Array  # (B, P, channels, T), readings over their noise per standard deviation of the prior
    covariance: Array  # (B, P, P), in the unknowns' units, priors included
    deviations: Array  # (B, P), in the unknowns' units: the Cramér–Rao bound with priors


def information(model: Model, values: Array, used: NDArray[np.bool_] | None = None) -> Information:
    """Fisher information and Cramér–Rao bound of the windows of a model at some values of the unknowns.

    Args:
        model: the commands, the unknowns with their priors, the task.
        values: values of the unknowns, (B, P), in their units.
        used: readings that exist, (channels,), (channels, T) or (B, channels, T); ``None``: all.
    """
    scaled = model.scaled(np.asarray(values, dtype=np.float64))
    unknowns = len(model.names)
    mask = np.ones(len(CHANNELS), dtype=np.bool_) if used is None else np.asarray(used, dtype=np.bool_)
    mask = mask[:, None] if mask.ndim == 1 else mask
    directions = None
    for _ in range(ROUNDS + 1):
        jacobian = np.where(
            mask[None, None] if mask.ndim == 2 else mask[:, None],
            model.linearise(scaled, None, directions).jacobian,
            0.0,
        )
        channelwise = jacobian.transpose(0, 2, 1, 3)
        fisher = channelwise @ channelwise.swapaxes(2, 3)
        precision = fisher.sum(axis=1) + np.eye(unknowns)
        directions = model.directions(precision)
    scale = model.derivative(scaled)
    covariance = np.linalg.inv(precision) * scale[:, :, None] * scale[:, None, :]
    return Information(fisher, jacobian, covariance, np.sqrt(np.einsum("bii->bi", covariance)))
