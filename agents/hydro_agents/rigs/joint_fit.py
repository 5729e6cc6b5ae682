"""Fits several windows of one axis together: the windows share the parameters, each has its own initial state.

The windows are short: a small error of the model cannot grow, and gaps between windows do not matter. The method is
Levenberg–Marquardt, as for a single window (:mod:`hydro_agents.estimation.solver`). The initial states are eliminated
window by window (Schur complement), which leaves a small problem of the shared parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.estimation.goodness import misfit_of
from hydro_agents.estimation.model import LONG_STEP, Model
from hydro_agents.estimation.names import STARTS
from hydro_agents.estimation.solver import DAMPINGS, channel_weights, masked

Array = NDArray[np.float64]

ITERATIONS = 40
"""Largest number of iterations."""

TOLERANCE = 0.1
"""The fit ends after an iteration with little damping that lowers the cost by less."""

LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e6


class Joint(NamedTuple):
    """A common fit of B windows with P unknowns, of which p are shared; all unknowns are scaled by their priors."""

    scaled: Array  # (B, P), most probable values; the shared ones are the same in each row
    shared: NDArray[np.int64]  # (p,), indices of the shared unknowns
    information: Array  # (B, p, p), of each window about the shared unknowns, with an unknown start
    score: Array  # (B, p), derivative of each window's log-likelihood to the shared unknowns
    misfit: Array  # (B,), as in hydro_agents.estimation.estimate.Estimate

    @property
    def precision(self) -> Array:
        """Inverse covariance of the shared unknowns, (p, p), including the priors."""
        total: Array = self.information.sum(axis=0) + np.eye(len(self.shared))
        return total


class Reduced(NamedTuple):
    """The normal equations of all windows, and those of the shared unknowns alone."""

    curvature: Array  # (B, P, P), of the readings, and of the priors of the start states
    gradient: Array  # (B, P)
    information: Array  # (B, p, p)
    score: Array  # (B, p)


def fit_together(
    model: Model, measured: Array, first: Array, progress: Callable[[int, int], None] | None = None
) -> Joint:
    """The most probable shared parameters and start states of several windows.

    Args:
        model: of the B windows.
        measured: readings over their noise, (B, channels, T); NaN is left out.
        first: initial scaled unknowns, (B, P); the shared ones are the same in each row.
        progress: called with the number of iterations and its limit.
    """
    shared = np.array([place for place, name in enumerate(model.names) if name not in STARTS])
    own = np.array([place for place, name in enumerate(model.names) if name in STARTS])
    known = np.isfinite(measured)
    data = np.where(known, measured, 0.0)
    scaled, directions, level = first.copy(), None, 1e-2
    for iteration in range(ITERATIONS):
        if progress is not None:
            progress(iteration, ITERATIONS)
        linear = model.linearise(scaled, None, directions)
        residual, jacobian = masked(linear, measured, known)
        weight = channel_weights(residual, known)
        reduced = reduce(scaled, residual, jacobian, weight, own, shared)
        directions = model.directions(_joint_precision(reduced, own, shared), LONG_STEP)
        cost = (weight * residual**2).sum() + _prior_cost(scaled, own, shared)
        steps = np.stack([_step(reduced, scaled, level * damping, own, shared) for damping in DAMPINGS], axis=1)
        trials = scaled[:, None] + steps  # (B, dampings, P)
        window = np.repeat(np.arange(model.count), len(DAMPINGS))
        read, _ = model.readings(trials.reshape(-1, trials.shape[2]), window)
        missed = np.where(
            known[:, None], data[:, None] - read.reshape(model.count, len(DAMPINGS), *data.shape[1:]), 0.0
        )
        square = missed.reshape(model.count, len(DAMPINGS), -1) ** 2
        costs = (weight[:, None] * square).sum(axis=(0, 2))
        costs += np.array([_prior_cost(trials[:, place], own, shared) for place in range(len(DAMPINGS))])
        costs = np.where(np.isfinite(costs), costs, np.inf)
        best = int(costs.argmin())
        gain = cost - costs[best]
        if gain > 0.0:
            scaled = trials[:, best]
        level = float(np.clip(level * (DAMPINGS[best] if gain > 0.0 else 1e3), LEAST_DAMPING, MOST_DAMPING))
        if level >= MOST_DAMPING or (0.0 < gain < TOLERANCE and level <= 1e-2):
            break
    linear = model.linearise(scaled, None, directions)
    residual, jacobian = masked(linear, measured, known)
    reduced = reduce(scaled, residual, jacobian, channel_weights(residual, known), own, shared)
    covariance = np.linalg.inv(_joint_precision(reduced, own, shared))
    misfit = misfit_of(residual, jacobian, covariance, known)
    return Joint(scaled, shared, reduced.information, reduced.score, misfit)


def _prior_cost(scaled: Array, own: NDArray[np.int64], shared: NDArray[np.int64]) -> float:
    return float((scaled[0, shared] ** 2).sum() + (scaled[:, own] ** 2).sum())


def reduce(
    scaled: Array,
    residual: Array,
    jacobian: Array,
    weight: Array,
    own: NDArray[np.int64],
    shared: NDArray[np.int64],
) -> Reduced:
    """Normal equations of each window, and of the shared unknowns after its start states are eliminated."""
    curvature = jacobian @ (weight[:, None] * jacobian).transpose(0, 2, 1)
    gradient = (jacobian @ (weight * residual)[:, :, None])[:, :, 0]
    curvature[:, own, own] += 1.0
    gradient[:, own] -= scaled[:, own]
    across = curvature[:, shared[:, None], own]
    solved = np.linalg.solve(
        curvature[:, own[:, None], own],
        np.concatenate([across.transpose(0, 2, 1), gradient[:, own, None]], axis=2),
    )
    information = curvature[:, shared[:, None], shared] - across @ solved[:, :, :-1]
    score = gradient[:, shared] - (across @ solved[:, :, -1:])[:, :, 0]
    return Reduced(curvature, gradient, information, score)


def _joint_precision(reduced: Reduced, own: NDArray[np.int64], shared: NDArray[np.int64]) -> Array:
    """Precision of all unknowns of each window, (B, P, P), given the other windows' information."""
    precision = reduced.curvature.copy()
    others = reduced.information.sum(axis=0) - reduced.information
    precision[:, shared[:, None], shared] += others + np.eye(len(shared))
    return precision


def _step(reduced: Reduced, scaled: Array, damping: float, own: NDArray[np.int64], shared: NDArray[np.int64]) -> Array:
    """The damped step of all unknowns, (B, P)."""
    diagonal = np.einsum("bii->bi", reduced.curvature)
    starts = reduced.curvature[:, own[:, None], own] + damping * diagonal[:, own, None] * np.eye(len(own))
    across = reduced.curvature[:, shared[:, None], own]
    solved = np.linalg.solve(
        starts, np.concatenate([across.transpose(0, 2, 1), reduced.gradient[:, own, None]], axis=2)
    )
    left = (reduced.curvature[:, shared[:, None], shared] - across @ solved[:, :, :-1]).sum(axis=0)
    right = (reduced.gradient[:, shared] - (across @ solved[:, :, -1:])[:, :, 0]).sum(axis=0) - scaled[0, shared]
    left += np.eye(len(shared)) + damping * np.diag(1.0 + diagonal[:, shared].sum(axis=0))
    step = np.zeros_like(scaled)
    common = np.linalg.solve(left, right)
    step[:, shared] = common
    step[:, own] = solved[:, :, -1] - solved[:, :, :-1] @ common
    return step
