"""Fits the unknowns of a rig file: most probable values, intervals, and whether the recording determines them.

The windows of a recording share the parameters of the rig, and each has its own initial state. They are short: a small
error of the model cannot grow, and gaps between windows do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.estimation.estimate import estimate, usable_readings
from hydro_agents.estimation.model import Model
from hydro_agents.estimation.result import Estimate
from hydro_agents.estimation.search import EstimationSettings
from hydro_agents.estimation.solver import channel_weights, equations_of, fit, masked, misfit_of, prior_belief, without
from hydro_agents.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LEAKAGE,
    STARTS,
    Prior,
    priors_of,
    starts_of,
)
from hydro_env import TaskConfig
from hydro_env.task.randomisation import Distribution
from hydro_env.task.sensors import SENSORS

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

WIDENING = 1.25
"""Factor on all standard deviations, chosen on validation seeds; it covers the linearisation and errors of the
replay."""

COVERAGE = 1.96  # half width of the 95 % interval of a normal distribution, in standard deviations
DETERMINED = 0.5
"""A parameter is determined if its standard deviation is at most this share of the standard deviation of its range."""

WELL_FITTED = 4.0  # largest misfit of an explained window, as in hydro_agents.estimation.estimate.EstimationSettings
OUTLIER = 3.0
"""Unexplained windows whose misfit is larger than this factor times the median are left out: the search ended in a
local minimum, or there was a disturbance."""

ROUGHLY = EstimationSettings(restarts=1, iterations=20, tolerance=0.2)
"""Search settings of the single windows; the common fit continues from their results."""

MOST_ATTEMPTS = 2  # number of common fits; before a further one, unexplained windows are fitted again
ITERATIONS = 40  # of a common fit, at the most

TOLERANCE = 0.1  # a common fit ends when a step with little damping lowers its cost by less
MOST_DAMPING = 5e5
"""A common fit ends when no step with more damping lowers its cost; single windows end earlier, and begin again."""


class Fit(NamedTuple):
    """Result for the windows of a recording. p unknowns: parameters, leaks and biases of sensors."""

    names: tuple[str, ...]  # (p,)
    priors: dict[str, Prior]  # of these
    values: Array  # (p,), most probable
    low: Array  # (p,), ends of the 95 % interval, in the unknown's unit
    high: Array  # (p,)
    remaining: Array  # (p,), standard deviation as a share of that of the range
    widening: float  # factor on the standard deviations of a fit to white noise
    information: Array  # (p, p), of the readings, for unknowns scaled by their ranges
    misfit: Array  # (B,), of each window; infinite for a window that was left out
    joint: Joint | None = None  # the common fit of the other windows

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Whether the recording determines each unknown, (p,)."""
        return np.asarray(self.remaining <= DETERMINED)

    @property
    def explained(self) -> NDArray[np.bool_]:
        """Whether the model explains the readings of each window within the sensors' noise, (B,)."""
        return np.asarray(self.misfit < WELL_FITTED)

    def value(self, name: str) -> float:
        """Most probable value of one unknown."""
        return float(self.values[self.names.index(name)])

    def own(self) -> dict[str, float]:
        """All values by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))


def unknowns_of(config: TaskConfig, ranges: Mapping[str, Distribution], measured: NDArray[np.bool_]) -> list[str]:
    """Names of the unknowns: parameters with a range, leak, biases of ``measured`` channels, (channels,), and start."""
    plant = [EXTERNAL_LEAKAGE if path == EXTERNAL_RESISTANCE else path for path in ranges]
    biases = [name for name, seen in zip(BIASES, measured, strict=True) if seen and config.sensors.enabled]
    return [LEAKAGE, *plant, *biases, *starts_of(config)]


def fit_windows(
    signals: Array,
    config: TaskConfig,
    ranges: Mapping[str, Distribution],
    progress: Progress | None = None,
    boundary: Array | None = None,
) -> Fit:
    """Fit the unknowns to windows of one recording.

    Each window is fitted alone first. The common fit starts from the values of the window that fits all others best.

    Args:
        signals: (B, 5, T), SI, in the order of SIGNALS.
        config: the task, on the rig.
        ranges: ranges that the rig file gives.
        progress: called with phase, done, total.
        boundary: recorded supply and tank pressure, (B, 2, T), Pa; NaN, ``None``: those of the plant.
    """

    def report(phase: str, done: int, total: int) -> None:
        if progress is not None:
            progress(phase, done, total)

    measured = np.asarray(np.isfinite(signals[:, : len(SENSORS)]).any(axis=(0, 2)))
    priors = priors_of(config, unknowns_of(config, ranges, measured))
    report("windows", 0, len(signals))
    alone = estimate(signals, config, list(priors), settings=ROUGHLY, boundary=boundary)
    report("windows", len(signals), len(signals))
    fits: list[tuple[Model, Joint, Array]] = []
    for attempt in range(MOST_ATTEMPTS):
        model, joint, misfit = _common_fit(
            signals, boundary, config, priors, alone, lambda *at: report("common fit", *at)
        )
        fits.append((model, joint, misfit))
        if (misfit < WELL_FITTED).all() or attempt + 1 == MOST_ATTEMPTS:
            break
        # A window may have ended in another minimum; the common values are a better start.
        values = model.values(joint.scaled)[0]
        first = {model.names[place]: float(values[place]) for place in joint.shared}
        once = ROUGHLY.model_copy(update={"restarts": 0})
        again = estimate(signals, config, list(priors), first=first, settings=once, boundary=boundary)
        better = np.flatnonzero(again.misfit < alone.misfit)
        alone.replace(better, again, better)
    report("common fit", 1, 1)
    model, joint, misfit = min(fits, key=lambda one: float(np.median(one[2])))
    return _summary(model, joint, priors, misfit)


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
        give_up=MOST_DAMPING,
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


def _common_fit(
    signals: Array,
    boundary: Array | None,
    config: TaskConfig,
    priors: Mapping[str, Prior],
    alone: Estimate,
    progress: Callable[[int, int], None],
) -> tuple[Model, Joint, Array]:
    """Model and common fit of the consistent windows, and the misfit of all, (B,); infinite if left out."""
    kept = _without_outliers(alone.misfit)
    for again in (False, True):  # the second time without the outliers of the first
        edge = None if boundary is None else boundary[kept]
        model = Model(config, priors, signals[kept, -1], boundary=edge)
        readings = usable_readings(signals[kept], config, model)
        joint = fit_together(model, readings, _first_values(model, readings, alone, kept), progress)
        still = _without_outliers(joint.misfit)
        if again or len(still) == len(kept):
            break
        kept = kept[still]
    misfit = np.full(len(signals), np.inf)
    misfit[kept] = joint.misfit
    return model, joint, misfit


def _without_outliers(misfit: Array) -> NDArray[np.int64]:
    """Indices of the windows that are explained, or whose misfit is not much larger than that of most others."""
    finite = np.where(np.isfinite(misfit), misfit, 1e9)
    return np.flatnonzero(finite <= max(WELL_FITTED, OUTLIER * float(np.median(finite))))


def _first_values(model: Model, readings: Array, alone: Estimate, kept: NDArray[np.int64]) -> Array:
    """Start of the common fit, (B, P) scaled: shared values of one window, or their median; each window's own start."""
    shared = np.array([place for place, name in enumerate(model.names) if name not in STARTS])
    scaled = alone.scaled[kept]
    candidates = np.concatenate([scaled[:, shared], np.median(scaled[:, shared], axis=0, keepdims=True)])
    known = np.isfinite(readings)
    costs = []
    for candidate in candidates:
        tried = scaled.copy()
        tried[:, shared] = candidate
        read, _ = model.readings(tried, np.arange(len(tried)))
        square = np.where(known, readings - read, 0.0) ** 2
        costs.append(float(np.nan_to_num(square.sum(axis=(1, 2)), nan=1e12, posinf=1e12).clip(max=1e12).sum()))
    result = scaled.copy()
    result[:, shared] = candidates[int(np.argmin(costs))]
    return result


def _summary(model: Model, joint: Joint, priors: Mapping[str, Prior], misfit: Array) -> Fit:
    """Values and intervals of the shared unknowns."""
    names = tuple(model.names[place] for place in joint.shared)
    scaled = joint.scaled[0]
    widening = WIDENING * math.sqrt(max(_scatter(joint), 1.0))
    deviation = widening * np.sqrt(np.diag(np.linalg.inv(joint.precision)))
    reach = np.zeros((2, len(scaled)))
    reach[:, joint.shared] = COVERAGE * np.minimum(deviation, 1.0) * np.array([[-1.0], [1.0]])
    low, high = (model.values(scaled + side)[joint.shared] for side in reach)
    return Fit(
        names=names,
        priors={name: priors[name] for name in names},
        values=model.values(scaled)[joint.shared],
        low=low,
        high=high,
        remaining=np.minimum(deviation, 1.0),
        widening=widening,
        information=joint.information.sum(axis=0),
        misfit=misfit,
        joint=joint,
    )


def _scatter(joint: Joint) -> float:
    """Squared scatter of the windows around the common values, relative to its expectation from noise (Birge's ratio).

    Each window would change the shared values by its information's inverse times its score. With a wrong model the
    windows disagree by more than their own uncertainty.
    """
    own = np.eye(len(joint.shared))
    square = freedom = 0.0
    for information, score in zip(joint.information, joint.score, strict=True):
        square += float(score @ np.linalg.solve(information + own, score))
        freedom += float(np.trace(np.linalg.solve(information + own, information)))
    return square / max(freedom - len(joint.shared), 1.0)


class Combination(NamedTuple):
    """A combination of unknowns, and the information of the recording about it."""

    singular_value: float  # of the readings' derivatives, scaled by ranges and noise; below 1 the range dominates
    parts: tuple[tuple[str, float], ...]  # names and weights of the largest parts


def combinations(fit: Fit) -> list[Combination]:
    """The singular values of the scaled derivatives with their combinations, the least determined first."""
    values, vectors = np.linalg.eigh(fit.information)
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        order = [place for place in np.argsort(-np.abs(vector)) if abs(vector[place]) > 0.3]
        sign = math.copysign(1.0, vector[order[0]]) if order else 1.0
        parts = tuple((fit.names[place], float(sign * vector[place])) for place in order)
        found.append(Combination(math.sqrt(max(float(value), 0.0)), parts))
    return found
