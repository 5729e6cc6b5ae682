"""Finds commands over a horizon: Gauss–Newton steps within the command's limits, and random changes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEWTON_STEPS = 6
"""Steps of the projected Newton method; each decides which commands stay at a limit."""


def bounded_least_squares(
    jacobian: Array, error: Array, weight: Array, commands: Array, before: Array, effort: float
) -> Array:
    """Commands that minimise Σ weight · (error − jacobian · change)² + effort · Σ (change of command)² within ±1.

    The projected Newton method (Bertsekas 1982): commands at a limit whose gradient points outwards stay there; the
    others take the Newton step.

    Args:
        jacobian: (N, H, H), change of sample i per change of command j.
        error: the error with ``commands``, (N, H).
        weight: of each sample, (N, H).
        commands: to start from, (N, H).
        before: the command before the first, (N,).
        effort: cost of the squared change from one command to the next.

    Returns:
        Commands (N, H) within −1 to 1.
    """
    horizon = commands.shape[1]
    changes = np.eye(horizon) - np.eye(horizon, k=-1)  # of the commands from period to period
    weighted = jacobian.transpose(0, 2, 1) * weight[:, None, :]
    smooth = effort * changes.T @ changes
    hessian = weighted @ jacobian + smooth
    hessian += 1e-9 * np.trace(hessian, axis1=1, axis2=2)[:, None, None] / horizon * np.eye(horizon)
    # Gradient at commands u: hessian u − pull.
    pull = (weighted @ (error + (jacobian @ commands[:, :, None])[..., 0])[:, :, None])[..., 0]
    pull[:, 0] += effort * before
    best = commands.copy()
    for _ in range(NEWTON_STEPS):
        gradient = (hessian @ best[:, :, None])[..., 0] - pull
        held = ((best >= 1.0) & (gradient < 0.0)) | ((best <= -1.0) & (gradient > 0.0))
        free = ~held
        reduced = hessian * (free[:, :, None] & free[:, None, :]) + held[:, :, None] * np.eye(horizon)
        step = np.linalg.solve(reduced, np.where(free, -gradient, 0.0)[:, :, None])[..., 0]
        best = np.clip(best + step, -1.0, 1.0)
    return best


def random_changes(generator: np.random.Generator, count: int, horizon: int, sizes: Any) -> Array:
    """Changes of a sequence of commands, (count, horizon): each constant on a random stretch, of random size."""
    first = generator.integers(0, horizon, count)
    last = first + 1 + generator.integers(0, horizon, count)
    period = np.arange(horizon)
    inside = (period >= first[:, None]) & (period < last[:, None])
    size = np.resize(np.asarray(sizes, dtype=np.float64), count) * generator.uniform(-1.0, 1.0, count)
    changes: Array = inside * size[:, None]
    return changes


BENDING = 5
"""Periods for which the reference beyond the preview keeps its acceleration; then it keeps its speed."""


def continued(reference: Array, step: int, known: int, horizon: int, order: int) -> Array:
    """The reference at the next ``horizon`` samples (N, H), as known at a step and extrapolated beyond the preview.

    Args:
        reference: of the whole episode, (N, samples).
        step: present sample.
        known: samples after it that are known.
        horizon: samples wanted.
        order: beyond, the reference keeps its last value (0), its last speed (1), or for a while its last acceleration
            too (2). The last differences must agree on both: a jump is no speed, and a kink no acceleration.
    """
    samples = reference.shape[1] - 1
    times = step + 1 + np.arange(horizon)
    end = step + known
    ahead: Array = reference[:, np.minimum(np.minimum(times, end), samples)]
    if order == 0 or step + horizon <= end:
        return ahead
    last = np.clip(end - np.arange(4), 0, samples)
    speeds = -np.diff(reference[:, last], axis=1)
    new, old = speeds[:, 0], speeds[:, 1]
    steady = (new * old > 0.0) & (np.abs(new) < 2.0 * np.abs(old))
    beyond = np.maximum(times - end, 0)
    ahead += np.where(steady, new, _agreed(new, old))[:, None] * beyond
    if order == 2:
        bends = -np.diff(speeds, axis=1)
        ahead += _agreed(bends[:, 0], bends[:, 1])[:, None] * _bent(beyond)
    return ahead


def _agreed(a: Array, b: Array) -> Array:
    """The smaller of two numbers of the same sign, else 0."""
    return np.where(a * b > 0.0, np.where(np.abs(a) < np.abs(b), a, b), 0.0)


def _bent(beyond: NDArray[np.int64]) -> Array:
    """Displacement after ``beyond`` periods of a unit of acceleration that lasts BENDING periods."""
    acting = np.minimum(beyond, BENDING)
    return np.asarray(0.5 * acting * (acting + 1) + BENDING * (beyond - acting), dtype=np.float64)
