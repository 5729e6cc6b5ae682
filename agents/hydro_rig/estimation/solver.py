"""Levenberg–Marquardt for many windows at once: the most probable values of the unknowns given readings and priors.

Windows of different axes are searched independently. Windows of one axis may share unknowns, such as the parameters of
the plant; each then keeps its own start state. The start states are eliminated window by window (Schur complement),
which leaves a small problem of the shared unknowns.

:func:`misfit_of` says whether the result explains the readings: whether the residuals look like the sensors' noise.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.jobs import Report
from hydro_env.types import Floats, Indices, Mask
from hydro_rig.estimation.model import SHORT_STEP, Model
from hydro_rig.estimation.result import Errors, whitened
from hydro_rig.estimation.unknowns import Priors

DAMPINGS = np.array([0.1, 1.0, 10.0, 100.0])  # factors on the damping; the best of their steps is taken
SMALL_DAMPING = 1e-2  # damping up to which a step is nearly a Gauss–Newton step
BLOCK = 20  # number of samples per block; the mean residual of each block is tested

NONE_SHARED = np.empty(0, np.int64)
_display: ContextVar[Report | None] = ContextVar("display", default=None)


class Problem(NamedTuple):
    """B windows whose readings a model shall explain; its scaled unknowns have independent priors around 0, of 1."""

    model: Model
    measured: Floats  # readings over their noise, (B, channels, T); NaN is left out
    errors: Errors | None = None  # of the readings; None: white noise as in the data sheet

    def part(self, windows: Indices) -> "Problem":
        """Some of the windows."""
        return Problem(self.model.part(windows), self.measured[windows], self.errors and self.errors.part(windows))

    def with_more(self, priors: Priors) -> "Problem":
        """The same windows with more unknowns behind the others."""
        return self._replace(model=self.model.with_more(priors))

    def residual(self, scaled: Floats, samples: int | None = None) -> Floats:
        """Readings minus model, (B, R, channels, T), whitened, for scaled unknowns (B, R, P); 0: no reading."""
        measured = self.measured[:, None, :, :samples]
        read = self.model.readings(scaled.reshape(-1, scaled.shape[2]), samples)
        missed = np.where(np.isfinite(measured), measured - read.reshape(*scaled.shape[:2], *measured.shape[2:]), 0.0)
        return whitened(missed, np.isfinite(measured[:, 0]), self.errors) if self.errors else missed

    def linearised(
        self, scaled: Floats, directions: Floats | None = None, samples: int | None = None, central: bool = False
    ) -> "Linearised":
        """Residuals and derivatives at scaled unknowns (B, P); arguments as of :meth:`Model.linearise`."""
        measured = self.measured[:, :, :samples]
        known = np.isfinite(measured)
        read, slopes = self.model.linearise(scaled, directions, samples, central)
        residual, jacobian = np.where(known, measured - read, 0.0), np.where(known[:, None], slopes, 0.0)
        if self.errors:
            residual, jacobian = (whitened(values, known, self.errors) for values in (residual, jacobian))
        square = (residual**2).sum(axis=2) / np.maximum(known.sum(axis=2), 1)
        weight = np.repeat(np.nan_to_num(1.0 / np.maximum(square, 1.0))[:, :, None], known.shape[2], axis=2)
        flat = *residual.shape[:1], -1
        return Linearised(residual.reshape(flat), jacobian.reshape(*scaled.shape, -1), weight.reshape(flat), known)


class Linearised(NamedTuple):
    """Readings of B windows and their derivatives, whitened; 0 where a reading is missing."""

    residual: Floats  # (B, readings)
    jacobian: Floats  # (B, P, readings), per standard deviation of each unknown's prior
    weight: Floats  # (B, readings), 1 over the mean square of its channel's residuals, at most 1
    known: Mask  # (B, channels, T), readings that exist

    def covariance(self) -> Floats:
        """Covariance of the unknowns, (B, P, P), given these readings and the priors."""
        information = self.jacobian @ self.jacobian.transpose(0, 2, 1) + np.eye(self.jacobian.shape[1])
        return np.asarray(np.linalg.inv(information), float)

    def equations(self, scaled: Floats, shared: Indices) -> "Equations":
        """Normal equations of each window at unknowns (B, P), and those of the ``shared`` ones with the others unknown.

        The shared unknowns, (p,), have their prior once for all windows.
        """
        weighted, jacobian = self.weight[:, None] * self.jacobian, self.jacobian
        own = np.delete(np.arange(jacobian.shape[1]), shared)
        curvature = jacobian @ weighted.transpose(0, 2, 1)
        gradient = (jacobian @ (self.weight * self.residual)[:, :, None])[:, :, 0]
        curvature[:, own, own] += 1.0
        gradient[:, own] -= scaled[:, own]
        _, information, score = _eliminated(curvature[:, own[:, None], own], curvature, gradient, shared, own)
        return Equations(curvature, gradient, information, score, shared, own)


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


class Effort(NamedTuple):
    """How a search is carried out, and how long it goes on."""

    iterations: int  # at the most
    tolerance: float  # an iteration that lowers the cost of a window, or of all that share, by less ends its search
    step: float = SHORT_STEP  # of the differences after the first, standard deviations
    thorough: bool = True  # end only after a step with little damping: a small gain with a damped step ends nothing
    give_up: float = 1e4  # largest damping; a window that no step with more improves is finished
    phase: str = ""  # under which its iterations are told


def fit(
    problem: Problem, first: Floats, effort: Effort, samples: int | None = None, shared: Indices = NONE_SHARED
) -> tuple[Floats, Floats]:
    """Improve the unknowns of windows until convergence: scaled unknowns, (B, P), and directions, (B, S, S).

    It begins at ``first``, (B, P) scaled, and uses the first ``samples``; the ``shared`` unknowns are those that all
    windows have in common. While a fit is bad, its residuals are weighted by their own mean square: the prior then
    keeps the unknowns in a plausible range until the model explains the readings.
    """
    scaled, level, active = first.copy(), np.full(len(first), 1e-2), np.arange(len(first))
    directions = np.empty((len(first), *[len(problem.model.simulated)] * 2))
    for iteration in range(effort.iterations):
        if effort.phase:
            tell(effort.phase, iteration, effort.iterations)
        here, part = scaled[active], problem.part(active)
        linear = part.linearised(here, directions[active] if iteration else None, samples)
        equations = linear.equations(here, shared)
        directions[active] = part.model.directions(equations.precision, effort.step)
        cost = _cost(linear.weight, linear.residual**2, here, shared)

        trials = here[:, None] + _damped_steps(equations, here, level[active])  # (B, dampings, P)
        square = part.residual(trials, samples).reshape(*trials.shape[:2], -1) ** 2
        costs = _cost(linear.weight[:, None], square, trials, shared)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        row, best = np.arange(len(active)), costs.argmin(axis=1)
        better = costs[row, best] < cost
        scaled[active] = np.where(better[:, None], trials[row, best], here)
        level[active] = np.clip(level[active] * np.where(better, DAMPINGS[best], 1e3), 1e-8, 1e8)
        gain = np.where(better, cost - costs[row, best], 0.0)
        lost = ~better & (level[active] > effort.give_up)
        damped = (level[active] > SMALL_DAMPING) & effort.thorough
        active = active[~lost & ((gain > effort.tolerance) | ~better | damped)]
        if not len(active):
            break
    return scaled, directions


def _eliminated(
    inner: Floats, curvature: Floats, gradient: Floats, shared: Indices, own: Indices
) -> tuple[Floats, Floats, Floats]:
    """Solve windows for their own unknowns: solution (…, o, p + 1), information (…, p, p), score (…, p) of the shared.

    ``inner``: curvature of the own unknowns, damped or not, (…, o, o).
    """
    across = curvature[..., shared[:, None], own]
    right = np.concatenate([across.swapaxes(-1, -2), gradient[..., own, None]], axis=-1)
    solved = np.linalg.solve(inner, np.broadcast_to(right, (*inner.shape[:-1], right.shape[-1])))
    information = curvature[..., shared[:, None], shared] - across @ solved[..., :-1]
    score = gradient[..., shared] - (across @ solved[..., -1:])[..., 0]
    return solved, information, score


def _damped_steps(equations: Equations, scaled: Floats, level: Floats) -> Floats:
    """Levenberg–Marquardt steps (B, dampings, P); each damping enlarges the diagonal."""
    curvature, gradient, _, _, shared, own = equations
    diagonal = np.einsum("bii->bi", curvature)
    factors = level[:, None] * DAMPINGS
    damped = curvature[:, None, own[:, None], own]
    damped = damped + factors[:, :, None, None] * (diagonal[:, None, own, None] * np.eye(len(own)))
    solved, information, score = _eliminated(damped, curvature[:, None], gradient[:, None], shared, own)
    left, right = information.sum(axis=0), score.sum(axis=0) - scaled[0, shared]
    left += np.eye(len(shared)) + factors[0, :, None, None] * np.diag(1.0 + diagonal[:, shared].sum(axis=0))
    common = np.linalg.solve(left, right[..., None])  # (dampings, p, 1)
    steps = np.empty((*damped.shape[:2], curvature.shape[1]))
    steps[..., shared] = common[..., 0]
    steps[..., own] = solved[..., -1] - (solved[..., :-1] @ common)[..., 0]
    return steps


def _cost(weight: Floats, square: Floats, scaled: Floats, shared: Indices) -> Floats:
    """Cost of each window and trial, (B, …): weighted squares and prior; the sum of all windows if they share."""
    prior = scaled**2
    costs = (weight * square).sum(axis=-1) + prior.sum(axis=-1)
    if len(shared):
        of_shared = prior[..., shared].sum(axis=-1)
        costs = np.broadcast_to((costs - of_shared).sum(axis=0) + of_shared[0], costs.shape)
    return costs


def misfit_of(linear: Linearised, covariance: Any) -> Floats:
    """Excess of the residuals over their expectation from noise after a fit, in standard deviations, (B,).

    Two sums of squares are tested, and the larger excess counts: of all residuals, and of their means over blocks of
    samples. A small model error changes slowly; it is hidden in the noise of single samples, but not in that of block
    means. ``covariance``: of the unknowns, (B, P, P). Infinite: no number.
    """
    residual, jacobian, _, known = linear
    windows, channels, samples = known.shape
    starts = np.arange(0, samples, BLOCK)
    number = np.add.reduceat(known, starts, axis=2, dtype=np.int64).reshape(windows, -1)
    root = np.sqrt(np.maximum(number, 1))

    def sums(values: Floats) -> Floats:
        blocks = np.add.reduceat(values.reshape(*values.shape[:-1], channels, samples), starts, axis=-1)
        return blocks.reshape(*values.shape[:-1], -1)

    return np.maximum(
        _excess(residual, jacobian, covariance, known.sum(axis=(1, 2))),
        _excess(sums(residual) / root, sums(jacobian) / root[:, None], covariance, (number > 0).sum(axis=1)),
    )


def _excess(residual: Floats, jacobian: Floats, covariance: Any, number: Indices) -> Floats:
    """Excess of one sum of squares of ``number`` residuals.

    The sum has a chi-square distribution, whose cube root is nearly normal (Wilson and Hilferty 1931).
    """
    fitted = np.einsum("bij,bij->b", jacobian @ jacobian.transpose(0, 2, 1), covariance)
    freedom = np.maximum(number - fitted, 1.0)
    spread = 2.0 / (9.0 * freedom)
    excess = (np.cbrt((residual**2).sum(axis=1) / freedom) - 1.0 + spread) / np.sqrt(spread)
    return np.where(np.isfinite(excess), excess, np.inf)


@contextmanager
def told_to(display: Report | None) -> Iterator[None]:
    """What is told inside the block goes to a display; ``None``: to nobody."""
    token = _display.set(display)
    try:
        yield
    finally:
        _display.reset(token)


@contextmanager
def shown(quiet: bool = False) -> Iterator[None]:
    """What is told inside the block is shown on the console, unless ``quiet``."""
    with nullcontext() if quiet else ProgressDisplay() as display, told_to(display.update if display else None):
        yield


def tell(phase: str, done: int, total: int) -> None:
    """How far a phase is."""
    display = _display.get()
    if display:
        display(phase, done, total)
