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
from hydro_agents.estimation.model import Model
from hydro_agents.estimation.names import STARTS
from hydro_agents.estimation.solver import channel_weights, equations_of, fit, masked, prior_belief, without

Array = NDArray[np.float64]

ITERATIONS = 40
"""Largest number of iterations."""

TOLERANCE = 0.1
"""The fit ends after an iteration with little damping that lowers the cost by less."""


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
    shared = np.array([place for place, name in enumerate(model.names) if name not in STARTS], np.int64)
    window, belief = np.arange(model.count), prior_belief(model, model.count)
    scaled, _, directions = fit(
        model,
        measured,
        window,
        first,
        belief,
        model.samples,
        ITERATIONS,
        TOLERANCE,
        give_up=5e5,
        shared=shared,
        progress=progress,
    )
    known = np.isfinite(measured)
    linear = model.linearise(scaled, None, directions)
    residual, jacobian = masked(linear, np.where(known, measured, 0.0), known)
    weight, prior = channel_weights(residual, known), without(belief.precision, shared)
    equations = equations_of(residual, jacobian, weight, scaled, prior, shared)
    misfit = misfit_of(residual, jacobian, np.linalg.inv(equations.precision), known)
    return Joint(scaled, shared, equations.information, equations.score, misfit)
