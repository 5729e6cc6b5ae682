"""Levenberg–Marquardt for many windows at once: the most probable values of the unknowns given readings and priors.

Windows of different axes are searched independently. Windows of one axis may share unknowns, such as the parameters of
the plant; each then keeps its own start state. The start states are eliminated window by window (Schur complement),
which leaves a small problem of the shared unknowns.

:func:`misfit_of` says whether the result explains the readings: whether the residuals look like the sensors' noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.types import Floats
from hydro_rig.estimation.errors import Errors, whitened
from hydro_rig.estimation.model import LONG_STEP, Linearised, Model

Indices = NDArray[np.int64]

DAMPINGS = np.array([0.1, 1.0, 10.0, 100.0])
"""Factors on the damping; the best of their steps is taken in each iteration."""

SMALL_DAMPING = 1e-2  # damping up to which a step is nearly a Gauss–Newton step
BLOCK = 20  # number of samples per block; the mean residual of each block is tested

NONE_SHARED: Indices = np.empty(0, np.int64)


class Belief(NamedTuple):
    """A normal distribution of the scaled unknowns of B windows."""

    mean: Floats  # (B, P)
    precision: Floats  # (B, P, P), the inverse of the covariance


class Fit(NamedTuple):
    """Result of the search in B windows."""

    scaled: Floats  # (B, P)
    iterations: Indices  # (B,)
    directions: Floats  # (B, S, S), steps along the axes of the uncertainty


class Equations(NamedTuple):
    """Normal equations of B windows with P unknowns, of which p are shared."""

    curvature: Floats  # (B, P, P), of the readings, and of the prior of the unknowns that are not shared
    gradient: Floats  # (B, P)
    information: Floats  # (B, p, p), of each window about the shared unknowns, with the others unknown
    score: Floats  # (B, p), derivative of each window's log-likelihood to the shared unknowns
    shared: Indices  # (p,), indices of the shared unknowns
    own: Indices  # (P − p,), indices of the others

    @property
    def precision(self) -> Floats:
        """Precision of all unknowns of each window, (B, P, P), given the other windows and the prior of the shared."""
        precision = self.curvature.copy()
        others = self.information.sum(axis=0) - self.information
        precision[:, self.shared[:, None], self.shared] += others + np.eye(len(self.shared))
        return precision


def prior_belief(model: Model, count: int) -> Belief:
    """The priors: scaled unknowns are independent, with mean 0 and standard deviation 1."""
    unknowns = len(model.names)
    return Belief(np.zeros((count, unknowns)), np.tile(np.eye(unknowns), (count, 1, 1)))


def without(precision: Floats, shared: Indices) -> Floats:
    """The precision of a prior, (B, P, P), with 0 for the shared unknowns: they have one prior, not one per window."""
    own = precision.copy()
    own[:, shared] = own[:, :, shared] = 0.0
    return own


def fit(
    model: Model,
    measured: Floats,
    window: Indices,
    first: Floats,
    belief: Belief,
    samples: int,
    iterations: int,
    tolerance: float,
    directions: Floats | None = None,
    thorough: bool = True,
    step: float = LONG_STEP,
    give_up: float = 1e4,
    shared: Indices = NONE_SHARED,
    progress: Callable[[int, int], None] | None = None,
    errors: Errors | None = None,
    central: bool = False,
) -> Fit:
    """Improve the unknowns of some windows until convergence.

    While a fit is bad, its residuals are weighted by their own mean square: the prior then keeps the unknowns in a
    plausible range until the model explains the readings.

    Args:
        model: the model of all windows.
        measured: readings over their noise, (windows of the model, channels, T); NaN is left out.
        window: index of the windows to fit, (B,).
        first: initial scaled unknowns, (B, P); the shared ones are the same in each row.
        belief: prior of each window; shared unknowns have the prior of :func:`prior_belief` instead, once for all.
        samples: number of first samples that are used.
        iterations: largest number of iterations.
        tolerance: stop a window when an iteration lowers its cost by less; of all windows together if they share.
        directions: steps of the first differences, (B, S, S).
        thorough: stop only after a step with little damping; a small gain with a damped step does not end the search.
        step: of the differences after the first, standard deviations.
        give_up: largest damping; a window that no step with more improves is finished.
        shared: indices of the unknowns that all windows have in common.
        progress: called with the number of iterations and its limit.
        errors: of the readings of each window, (B, channels); ``None``: white noise as in the data sheet.
        central: take differences to both sides (:meth:`~hydro_rig.estimation.model.Model.linearise`).
    """
    scaled = first.copy()
    used = measured[window, :, :samples]
    known = np.isfinite(used)
    prior = without(belief.precision, shared)
    steps_known = directions is not None
    directions = np.empty((len(first), *[len(model.simulated)] * 2)) if directions is None else directions.copy()
    level, done = np.full(len(first), 1e-2), np.zeros(len(first), dtype=np.int64)
    active = np.arange(len(first))
    for iteration in range(iterations):
        if progress is not None:
            progress(iteration, iterations)
        here, data, mask = scaled[active], used[active], known[active]
        linear = model.linearise(here, window[active], directions[active] if steps_known else None, samples, central)
        own = None if errors is None else errors.part(active)
        residual, jacobian = masked(linear, data, mask, own)
        weight = channel_weights(residual, mask)
        mean, precision = belief.mean[active], prior[active]
        equations = equations_of(residual, jacobian, weight, here - mean, precision, shared)
        directions[active], steps_known = model.directions(equations.precision, step), True
        cost = _cost(weight, residual**2, here, mean, precision, shared)

        trials = here[:, None] + _damped_steps(equations, here, level[active])  # (B, dampings, P)
        row, tried = np.arange(len(active)), len(DAMPINGS)
        read, _ = model.readings(trials.reshape(-1, trials.shape[2]), np.repeat(window[active], tried), samples)
        missed = np.where(mask[:, None], data[:, None] - read.reshape(len(active), tried, *data.shape[1:]), 0.0)
        missed = missed if own is None else whitened(missed, mask, own)
        square = missed.reshape(len(active), tried, -1) ** 2
        costs = _cost(weight[:, None], square, trials, mean[:, None], precision, shared)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        best = costs.argmin(axis=1)
        better = costs[row, best] < cost
        scaled[active] = np.where(better[:, None], trials[row, best], here)
        level[active] = np.clip(level[active] * np.where(better, DAMPINGS[best], 1e3), 1e-8, 1e8)
        done[active] += 1
        gain = np.where(better, cost - costs[row, best], 0.0)
        lost = ~better & (level[active] > give_up)
        damped = (level[active] > SMALL_DAMPING) & thorough
        active = active[~lost & ((gain > tolerance) | ~better | damped)]
        if not len(active):
            break
    return Fit(scaled, done, directions)


def equations_of(
    residual: Floats, jacobian: Floats, weight: Floats, away: Floats, precision: Floats, shared: Indices
) -> Equations:
    """Normal equations of each window, and those of the shared unknowns after its others are eliminated.

    Args:
        residual: over the noise, (B, readings).
        jacobian: derivatives of the readings, (B, P, readings).
        weight: of each reading, (B, readings).
        away: scaled unknowns minus the mean of their prior, (B, P).
        precision: of the prior, (B, P, P), from :func:`without`.
        shared: their indices, (p,).
    """
    curvature = jacobian @ (weight[:, None] * jacobian).transpose(0, 2, 1) + precision
    gradient = (jacobian @ (weight * residual)[:, :, None])[:, :, 0] - (precision @ away[:, :, None])[:, :, 0]
    own = np.delete(np.arange(len(curvature[0])), shared)
    if not len(shared):
        return Equations(curvature, gradient, np.zeros((len(curvature), 0, 0)), gradient[:, :0], shared, own)
    across = curvature[:, shared[:, None], own]
    inner = np.concatenate([across.transpose(0, 2, 1), gradient[:, own, None]], axis=2)
    solved = np.linalg.solve(curvature[:, own[:, None], own], inner)
    information = curvature[:, shared[:, None], shared] - across @ solved[:, :, :-1]
    score = gradient[:, shared] - (across @ solved[:, :, -1:])[:, :, 0]
    return Equations(curvature, gradient, information, score, shared, own)


def _damped_steps(equations: Equations, scaled: Floats, level: Floats) -> Floats:
    """Levenberg–Marquardt steps (B, dampings, P); each damping enlarges the diagonal."""
    curvature, gradient, _, _, shared, own = equations
    diagonal = np.einsum("bii->bi", curvature)
    factors = level[:, None] * DAMPINGS
    across = curvature[:, None, shared[:, None], own]
    inner = np.concatenate([across[:, 0].transpose(0, 2, 1), gradient[:, own, None]], axis=2)
    damped = curvature[:, None, own[:, None], own]
    damped = damped + factors[:, :, None, None] * (diagonal[:, None, own, None] * np.eye(len(own)))
    solved = np.linalg.solve(damped, np.broadcast_to(inner[:, None], (*damped.shape[:3], inner.shape[2])))
    left = (curvature[:, None, shared[:, None], shared] - across @ solved[..., :-1]).sum(axis=0)
    right = (gradient[:, None, shared] - (across @ solved[..., -1:])[..., 0]).sum(axis=0) - scaled[0, shared]
    left += np.eye(len(shared)) + factors[0, :, None, None] * np.diag(1.0 + diagonal[:, shared].sum(axis=0))
    common = np.linalg.solve(left, right[..., None])  # (dampings, p, 1)
    steps = np.empty((*damped.shape[:2], curvature.shape[1]))
    steps[..., shared] = common[..., 0]
    steps[..., own] = solved[..., -1] - (solved[..., :-1] @ common)[..., 0]
    return steps


def _cost(weight: Floats, square: Floats, scaled: Floats, mean: Floats, precision: Floats, shared: Indices) -> Floats:
    """Cost of each window and trial, (B, …): weighted squares and prior; the sum of all windows if they share."""
    away = scaled - mean
    pull = (precision @ away[:, :, None])[:, :, 0] if away.ndim == 2 else away @ precision
    costs: Floats = (weight * square).sum(axis=-1) + (away * pull).sum(axis=-1)
    if len(shared):
        costs = np.broadcast_to(costs.sum(axis=0) + (scaled[0][..., shared] ** 2).sum(axis=-1), costs.shape)
    return costs


def channel_weights(residual: Floats, known: NDArray[np.bool_]) -> Floats:
    """Weight of each reading, (B, readings): 1 over the mean square of its channel's residuals, at most 1."""
    shape = known.shape
    square = (residual.reshape(shape) ** 2).sum(axis=2) / np.maximum(known.sum(axis=2), 1)
    weight = 1.0 / np.maximum(square, 1.0)
    return np.repeat(np.nan_to_num(weight)[:, :, None], shape[2], axis=2).reshape(len(residual), -1)


def masked(
    linear: Linearised, data: Floats, known: NDArray[np.bool_], errors: Errors | None = None
) -> tuple[Floats, Floats]:
    """Residuals (B, readings) and their derivatives (B, P, readings); 0 where a reading is missing.

    With ``errors`` of the readings, both are whitened.
    """
    residual = np.where(known, data - linear.readings, 0.0)
    jacobian = np.where(known[:, None], linear.jacobian, 0.0)
    if errors is not None:
        residual, jacobian = whitened(residual, known, errors), whitened(jacobian, known, errors)
    return residual.reshape(len(data), -1), jacobian.reshape(len(data), jacobian.shape[1], -1)


def misfit_of(residual: Any, jacobian: Any, covariance: Any, known: NDArray[np.bool_]) -> Floats:
    """Excess of the residuals over their expectation from noise after a fit, in standard deviations, (B,).

    The excess is infinite if it is not a number. Two sums of squares are tested, and the larger excess counts: of all
    residuals, and of their means over blocks of samples. A small model error changes slowly; it is hidden in the noise
    of single samples, but not in that of block means.

    Args:
        residual: over the noise, (B, channels · T), 0 where a reading is missing.
        jacobian: derivatives of the same readings, (B, P, channels · T), 0 where a reading is missing.
        covariance: of the unknowns, (B, P, P).
        known: readings that exist, (B, channels, T).
    """
    windows, channels, samples = known.shape
    starts = np.arange(0, samples, BLOCK)
    number = np.add.reduceat(known, starts, axis=2, dtype=np.int64).reshape(windows, -1)
    root = np.sqrt(np.maximum(number, 1))

    def sums(values: Any) -> Any:
        blocks = np.add.reduceat(values.reshape(*values.shape[:-1], channels, samples), starts, axis=-1)
        return blocks.reshape(*values.shape[:-1], -1)

    return np.maximum(
        _excess(residual, jacobian, covariance, known.sum(axis=(1, 2))),
        _excess(sums(residual) / root, sums(jacobian) / root[:, None], covariance, (number > 0).sum(axis=1)),
    )


def _excess(residual: Any, jacobian: Any, covariance: Any, number: NDArray[np.int64]) -> Floats:
    """Excess of one sum of squares of ``number`` residuals.

    The sum has a chi-square distribution, whose cube root is nearly normal (Wilson and Hilferty 1931).
    """
    fitted = np.einsum("bij,bij->b", jacobian @ jacobian.transpose(0, 2, 1), covariance)
    freedom = np.maximum(number - fitted, 1.0)
    spread = 2.0 / (9.0 * freedom)
    excess = (np.cbrt((residual**2).sum(axis=1) / freedom) - 1.0 + spread) / np.sqrt(spread)
    return np.where(np.isfinite(excess), excess, np.inf)
