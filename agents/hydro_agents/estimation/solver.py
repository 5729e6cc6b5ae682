"""Levenberg–Marquardt for many windows at once: the most probable values of the unknowns given readings and priors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.estimation.model import LONG_STEP, Linearised, Model

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

DAMPINGS = (0.1, 1.0, 10.0, 100.0)
"""Factors on the damping; the best of their steps is taken in each iteration."""


SMALL_DAMPING = 1e-2
"""Damping up to which a step is nearly a Gauss–Newton step."""


class Belief(NamedTuple):
    """A normal distribution of the scaled unknowns of B windows."""

    mean: Array  # (B, P)
    precision: Array  # (B, P, P), the inverse of the covariance


class Fit(NamedTuple):
    """Result of the search in B windows."""

    scaled: Array  # (B, P)
    chi2: Array  # (B,), sum of the squared residuals over the noise
    iterations: Indices  # (B,)
    directions: Array  # (B, S, S), steps along the axes of the uncertainty


def prior_belief(model: Model, count: int) -> Belief:
    """The priors: scaled unknowns are independent, with mean 0 and standard deviation 1."""
    unknowns = len(model.names)
    return Belief(np.zeros((count, unknowns)), np.tile(np.eye(unknowns), (count, 1, 1)))


def fit(
    model: Model,
    measured: Array,
    window: Indices,
    first: Array,
    belief: Belief,
    samples: int,
    iterations: int,
    tolerance: float,
    directions: Array | None = None,
    thorough: bool = True,
    step: float = LONG_STEP,
) -> Fit:
    """Improve the unknowns of some windows until convergence.

    While a fit is bad, its residuals are weighted by their own mean square: the prior then keeps the unknowns in a
    plausible range until the model explains the readings.

    Args:
        model: the model of all windows.
        measured: readings over their noise, (windows of the model, channels, T); NaN is left out.
        window: index of the windows to fit, (B,).
        first: initial scaled unknowns, (B, P).
        belief: prior of each window.
        samples: number of first samples that are used.
        iterations: largest number of iterations.
        tolerance: stop a window when an iteration lowers its cost by less.
        directions: steps of the first differences, (B, S, S).
        thorough: stop only after a step with little damping; a small gain with a damped step does not end the search.
        step: of the differences after the first, standard deviations.
    """
    count, unknowns = first.shape
    scaled = first.copy()
    used = measured[window, :, :samples]
    known = np.isfinite(used)
    level = np.full(count, 1e-2)
    chi2, done = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    active = np.arange(count)
    for _ in range(iterations):
        here, data, mask = scaled[active], used[active], known[active]
        linear = model.linearise(here, window[active], None if directions is None else directions[active], samples)
        residual, jacobian = masked(linear, data, mask)
        weight = channel_weights(residual, mask)
        fisher = jacobian @ (weight[:, None] * jacobian).transpose(0, 2, 1)
        mean, precision = belief.mean[active], belief.precision[active]
        away = here - mean
        pull = (precision @ away[:, :, None])[:, :, 0]
        gradient = (jacobian @ (weight * residual)[:, :, None])[:, :, 0] - pull
        curvature = fisher + precision
        if directions is None:
            directions = np.empty((count, len(model.simulated), len(model.simulated)))
        directions[active] = model.directions(curvature, step)
        cost = (weight * residual**2).sum(axis=1) + (away * pull).sum(axis=1)

        trials = here[:, None] + _damped_steps(curvature, gradient, level[active])
        read, _ = model.readings(trials.reshape(-1, unknowns), np.repeat(window[active], len(DAMPINGS)), samples)
        missed = np.where(mask[:, None], data[:, None] - read.reshape(len(active), len(DAMPINGS), *data.shape[1:]), 0.0)
        square = missed.reshape(len(active), len(DAMPINGS), -1) ** 2
        further = trials - mean[:, None]
        costs = (weight[:, None] * square).sum(axis=2) + (further * (further @ precision)).sum(axis=2)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        best = costs.argmin(axis=1)
        row = np.arange(len(active))
        better = costs[row, best] < cost
        scaled[active] = np.where(better[:, None], trials[row, best], here)
        chi2[active] = np.where(better, square[row, best].sum(axis=1), (residual**2).sum(axis=1))
        factor = np.where(better, np.array(DAMPINGS)[best], 1e3)
        level[active] = np.clip(level[active] * factor, 1e-8, 1e8)
        done[active] += 1
        gain = np.where(better, cost - costs[row, best], 0.0)
        lost = ~better & (level[active] > 1e4)
        damped = (level[active] > SMALL_DAMPING) & thorough
        moving = ~lost & ((gain > tolerance) | ~better | damped)
        active = active[moving]
        if not len(active):
            break
    assert directions is not None
    return Fit(scaled, chi2, done, directions)


def channel_weights(residual: Array, known: NDArray[np.bool_]) -> Array:
    """Weight of each reading, (B, readings): 1 over the mean square of its channel's residuals, at most 1."""
    shape = known.shape
    square = (residual.reshape(shape) ** 2).sum(axis=2) / np.maximum(known.sum(axis=2), 1)
    weight = 1.0 / np.maximum(square, 1.0)
    return np.repeat(np.nan_to_num(weight)[:, :, None], shape[2], axis=2).reshape(len(residual), -1)


def masked(linear: Linearised, data: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Residuals (B, readings) and their derivatives (B, P, readings); 0 where a reading is missing."""
    residual = np.where(known, data - linear.readings, 0.0).reshape(len(data), -1)
    jacobian = np.where(known[:, None], linear.jacobian, 0.0)
    return residual, jacobian.reshape(len(data), jacobian.shape[1], -1)


def _damped_steps(curvature: Array, gradient: Array, level: Array) -> Array:
    """Levenberg–Marquardt steps (B, dampings, P); each damping enlarges the diagonal."""
    diagonal = np.einsum("bii->bi", curvature)
    factors = level[:, None] * np.array(DAMPINGS)
    damped = curvature[:, None] + factors[:, :, None, None] * (diagonal[:, None, :, None] * np.eye(curvature.shape[1]))
    steps: Array = np.linalg.solve(damped, np.broadcast_to(gradient[:, None, :, None], (*damped.shape[:3], 1)))[..., 0]
    return steps
