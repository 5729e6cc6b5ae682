"""The common fit of the windows of a recording: shared parameters, leaks and biases, and a start state for each window.

A cost with friction and edges has local minima. The search therefore begins at several values: those that the windows
found by themselves. Windows that the common values do not explain are fitted again from them.
"""

from typing import NamedTuple, Self

import numpy as np

from hydro_agents.detection.detector import Windows
from hydro_env import TaskConfig
from hydro_env.types import Floats, Indices
from hydro_rig.estimation.estimate import LARGEST_MISFIT, EstimationSettings, estimate, timing_priors, usable_readings
from hydro_rig.estimation.model import LONG_STEP, SHORT_STEP, Model
from hydro_rig.estimation.result import NOISY, Errors, Estimate, errors_of
from hydro_rig.estimation.solver import Effort, Problem, fit, misfit_of, tell
from hydro_rig.estimation.unknowns import LATENCY, STARTS, Prior, Priors

WELL_FITTED = LARGEST_MISFIT  # of an explained window
OUTLIER, FAR_OUTLIER = 3.0, 30.0
"""Unexplained windows whose misfit is larger than this factor times the median are left out: the search ended in a
local minimum, or there was a disturbance. Where most windows are unexplained the second factor holds: there a large
misfit is what a window of fast motion has."""

ROUGHLY = EstimationSettings(restarts=1, effort=Effort(20, 0.2), errors=False)
"""Search settings of the single windows; the common fit continues from their results."""

LOOSENED = 4.0  # factor on the variance of the common values, as the prior of a window that they do not explain
MOST_DAMPING = 5e5  # a common fit ends when no step with more lowers its cost; single windows end earlier
PHASE = "common fit"
ROUGH = Effort(40, 1.0, LONG_STEP, give_up=MOST_DAMPING, phase=PHASE)
FINE = Effort(25, 0.02, SHORT_STEP, give_up=MOST_DAMPING, phase=PHASE)
"""A common fit begins with long differences, which bridge the roughness of friction, and ends with short ones, which
alone follow a curved valley to its lowest point."""

UNKNOWN_COMMANDS = 2  # readings at each end of a window that are left out if its commands may be a row late or early

LINEARISATIONS = 3
"""Of the result, each with differences as long as the uncertainty that the one before has shown. Short ones are rough,
and roughness looks like information: an unknown without influence would seem to be known."""

STARTING_VALUES = 2  # common fits from different values; the best is taken


class Joint(NamedTuple):
    """A common fit of B windows with P unknowns, of which p are shared; all unknowns are scaled by their priors."""

    scaled: Floats  # (B, P), most probable values; the shared ones are the same in each row
    shared: Indices  # (p,), indices of the shared unknowns
    information: Floats  # (B, p, p), of each window about the shared unknowns, with an unknown start
    score: Floats  # (B, p), derivative of each window's log-likelihood to the shared unknowns
    misfit: Floats  # (B,), as in hydro_rig.estimation.result.Estimate

    @property
    def covariance(self) -> Floats:
        """Of the shared unknowns, (p, p), including the priors."""
        return np.linalg.inv(self.information.sum(axis=0) + np.eye(len(self.shared)))

    @property
    def common(self) -> Floats:
        """The shared values, (p,), scaled."""
        return self.scaled[0, self.shared]


class Common(NamedTuple):
    """The best common fit of the windows of a recording."""

    problem: Problem  # of the windows that were used
    joint: Joint
    misfit: Floats  # (B,), of all windows; infinite for one that was left out

    @classmethod
    def of(cls, count: int, kept: Indices, problem: Problem, joint: Joint) -> Self:
        """The fit of the windows ``kept`` of ``count`` ones."""
        misfit = np.full(count, np.inf)
        misfit[kept] = joint.misfit
        return cls(problem, joint, misfit)

    def continued(self, problem: Problem, first: Floats) -> Self:
        """The fit of the same windows with another problem, from its first values on."""
        kept = np.flatnonzero(np.isfinite(self.misfit))
        return self.of(len(self.misfit), kept, problem, fit_together(problem, first))

    @property
    def model(self) -> Model:
        """Of the windows that were used."""
        return self.problem.model

    @property
    def noise(self) -> Floats:
        """White noise of each channel over that of the data sheet, (channels,), where the fit assumes another."""
        errors = self.problem.errors
        return errors.white[0] if errors else np.ones(self.problem.measured.shape[1])

    @property
    def explained(self) -> int:
        """Number of explained windows."""
        return (self.misfit < WELL_FITTED).sum()


def fit_together(problem: Problem, first: Floats) -> Joint:
    """The most probable shared parameters and start states of B windows; it begins at ``first``, (B, P) scaled."""
    shared, _ = shared_and_own(problem.model)
    scaled, directions = descend(problem, first, FINE)
    for _ in range(LINEARISATIONS):
        linear = problem.linearised(scaled, directions, central=True)
        equations = linear.equations(scaled, shared)
        directions = problem.model.directions(equations.precision, LONG_STEP)
    misfit = misfit_of(linear, np.linalg.inv(equations.precision))
    return Joint(scaled, shared, equations.information, equations.score, misfit)


def shared_and_own(model: Model) -> tuple[Indices, Indices]:
    """Indices of the unknowns that all windows share, and of those that each has for itself."""
    start = np.array([name in STARTS for name in model.names])
    return np.flatnonzero(~start), np.flatnonzero(start)


def descend(problem: Problem, first: Floats, effort: Effort = ROUGH) -> tuple[Floats, Floats]:
    """Unknowns at the end of a search, (B, P) scaled, and the directions of its differences."""
    return fit(problem, first, effort, shared=shared_and_own(problem.model)[0])


def common_fit(windows: Windows, config: TaskConfig, priors: Priors) -> Common:
    """Fit windows of one recording, or of several of one axis, together."""
    tell("windows", 0, len(windows))
    alone = estimate(windows.signals, config, priors, settings=ROUGHLY, boundary=windows.boundary)
    tell("windows", len(windows), len(windows))
    best = _common_fit(windows, config, priors, alone)
    if best.explained < len(windows):
        again = np.flatnonzero(~(best.misfit < WELL_FITTED))
        other = _nearby(windows.part(again), config, best)
        if len(alone.take(again, other, other.misfit < alone.misfit[again])):
            second = _common_fit(windows, config, priors, alone)
            best = max(best, second, key=lambda found: (found.explained, -np.median(found.misfit)))
    for remedy in (_with_timing, _with_noise, lambda found: _with_noise(_with_timing(found))):
        if 2 * best.explained < len(windows) and config.sensors.enabled:
            mended = remedy(best)
            if mended.explained > best.explained:  # otherwise it would only take up another error of the model
                best = mended
    tell(PHASE, 1, 1)
    return best


def _with_noise(found: Common) -> Common:
    """A fit continued with the noise of the channels whose residuals are white and larger than the data sheet's."""
    problem, joint = found.problem, found.joint
    known = np.isfinite(problem.measured)
    seen, _ = errors_of(problem.residual(joint.scaled[:, None])[:, 0], known)
    white, slow = np.median(seen.white, axis=0), np.median(seen.slow, axis=0)
    noisy = (white > NOISY) & (slow == 0.0)
    if not noisy.any():
        return found
    errors = Errors.of_data_sheet(*known.shape[:2])
    errors.white[:, noisy] = white[noisy]
    return found.continued(problem._replace(errors=errors), joint.scaled)


def _with_timing(found: Common) -> Common:
    """A fit continued with an unknown timing.

    The command may stand a row early or late: the row at which the readings differ least begins.
    """
    readings = found.problem.measured.copy()
    readings[:, :, :UNKNOWN_COMMANDS] = readings[:, :, -UNKNOWN_COMMANDS:] = np.nan
    more = {name: prior for name, prior in timing_priors(found.model.config).items() if name not in found.model.names}
    problem = found.problem.with_more(more)._replace(measured=readings)
    names, period = problem.model.names, problem.model.config.control_period
    trials = [np.pad(found.joint.scaled, ((0, 0), (0, len(more))))]
    if LATENCY in more:
        for rows in (-1.0, 1.0):
            moved = trials[0].copy()
            moved[:, names.index(LATENCY)] = rows * period / more[LATENCY].deviation
            trials.append(moved)
    rough = [descend(problem, trial)[0] for trial in trials]
    return found.continued(problem, rough[np.argmin(costs_of(problem, rough))])


def replayed(windows: Windows, config: TaskConfig, priors: Priors) -> Problem:
    """Some windows, and the model of them."""
    model = Model(config, priors, windows.signals[:, -1], boundary=windows.boundary)
    return Problem(model, usable_readings(windows.signals, config, model))


def _nearby(windows: Windows, config: TaskConfig, found: Common) -> Estimate:
    """Windows that common values do not explain, each fitted near these values."""
    joint, model = found.joint, found.model
    priors = dict(model.priors)
    spread = np.minimum(np.sqrt(LOOSENED * np.diag(joint.covariance)), 1.0)
    for place, value, share in zip(joint.shared, joint.common, spread, strict=True):
        own = priors[model.names[place]]
        priors[model.names[place]] = Prior(float(own.value(value)), share * own.deviation, own.logarithmic)
    near = estimate(windows.signals, config, priors, priors=priors, settings=ROUGHLY, boundary=windows.boundary)
    near.scaled[:] = model.prior.scaled(near.values)
    return near


def _common_fit(windows: Windows, config: TaskConfig, priors: Priors, alone: Estimate) -> Common:
    """The best common fit of the consistent windows from several starting values."""
    kept = without_outliers(alone.misfit)
    for again in (False, True):  # the second time without the outliers of the first
        problem = replayed(windows.part(kept), config, priors)
        rough = [descend(problem, first)[0] for first in _first_values(problem, alone, kept)]
        joint = fit_together(problem, rough[np.argmin(costs_of(problem, rough))])
        still = without_outliers(joint.misfit)
        if again or len(still) == len(kept):
            break
        kept = kept[still]
    return Common.of(len(windows), kept, problem, joint)


def costs_of(problem: Problem, trials: list[Floats]) -> list[float]:
    """Twice the negative logarithm of the posterior at each trial, (B, P) scaled.

    A channel of a window that scatters more than its noise counts as if it had that noise, as in the search.
    """
    number = np.isfinite(problem.measured).sum(axis=2)
    shared, own = shared_and_own(problem.model)
    costs = []
    for scaled in trials:
        total = (problem.residual(scaled[:, None])[:, 0] ** 2).sum(axis=2)
        square = np.nan_to_num(total / np.maximum(number, 1), nan=1e12, posinf=1e12)
        likelihood = number * np.where(square > 1.0, 1.0 + np.log(np.maximum(square, 1.0)), square)
        costs.append(likelihood.sum() + (scaled[:, own] ** 2).sum() + (scaled[0, shared] ** 2).sum())
    return costs


def without_outliers(misfit: Floats) -> Indices:
    """Indices of the windows that are explained, or whose misfit is not much larger than that of most others."""
    finite = np.where(np.isfinite(misfit), misfit, 1e9)
    median = np.median(finite)
    factor = OUTLIER if median < WELL_FITTED else FAR_OUTLIER
    return np.flatnonzero(finite <= max(WELL_FITTED, factor * median))


def _first_values(problem: Problem, alone: Estimate, kept: Indices) -> list[Floats]:
    """Starts of the common fit, each (B, P) scaled: shared values of one window, or their median; own start states."""
    shared, scaled = shared_and_own(problem.model)[0], alone.scaled[kept]
    trials = []
    for common in (*scaled[:, shared], np.median(scaled[:, shared], axis=0)):
        trials.append(scaled.copy())
        trials[-1][:, shared] = common
    return [trials[place] for place in np.argsort(costs_of(problem, trials))[:STARTING_VALUES]]
