"""The search for the most probable values of the unknowns, and for the errors of the readings where these differ."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_env import TaskConfig
from hydro_env.files import Group
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_env.units import Number
from hydro_rig.estimation.errors import Errors, errors_of, spikes_of
from hydro_rig.estimation.model import SHORT_STEP, Model
from hydro_rig.estimation.result import Estimate
from hydro_rig.estimation.solver import Belief, fit, masked, misfit_of
from hydro_rig.estimation.unknowns import LATENCY, LEAKAGE, RISE_TIME, STARTS, Prior, prior_of

Indices = NDArray[np.int64]

SHORTEST_FIT = 10  # samples; shorter fits carry no information
RESTART = 0.7  # standard deviation of the random start of a further search, in standard deviations of the prior
NEW_MINIMUM = 0.97  # a search with a larger chi2, over the lowest, ended in the same minimum or in a worse one
SURE = 3.0  # standard deviations
UNKNOWN_COMMANDS = 2  # readings at an end of the window that are left out if its commands are a row late or early
ROUNDS = 3  # of a fit and an estimate of the errors of its readings, one after the other
WIDENING = 1.5
"""Factor on the standard deviations of a window with a slow error: it is an error of the model, and not only of the
readings. Chosen on validation plants with LuGre friction, a moving supply and drifting sensors."""
LARGEST_SLOW_ERROR = 0.05  # of a channel's standard deviation in the window; with a larger one the model does not hold
SMALL_SLOW_ERROR = 3.0  # the same in standard deviations of the data sheet's noise, which is always allowed


class EstimationSettings(Group):
    """Settings of the search for an estimate."""

    horizons: tuple[Number, ...] = Field(
        (0.1, 0.2, 0.4, 0.7, 1.2, 2.4, 4.8),
        description="s; lengths of the first, rough fits; each starts from the result of the previous one",
    )
    horizon_iterations: int = Field(6, ge=1, le=1000, description="largest number of iterations of each rough fit")
    horizon_tolerance: Number = Field(5.0, gt=0.0, le=1e6, description="the same as tolerance, for each rough fit")
    iterations: int = Field(100, ge=1, le=1000, description="largest number of iterations of the last fit")
    tolerance: Number = Field(
        0.05, gt=0.0, le=10.0, description="the search ends after an iteration that lowers the cost by less"
    )
    restarts: int = Field(3, ge=0, le=100, description="further searches for windows that the model does not explain")
    largest_misfit: Number = Field(
        4.0, gt=0.0, description="standard deviations of chi2; above this the model is not valid"
    )
    errors: bool = Field(True, description="whether windows with a misfit are fitted again with errors of their own")


def search(
    model: Model,
    measured: Floats,
    first: Floats,
    belief: Belief,
    settings: EstimationSettings,
    directions: Floats | None = None,
) -> Estimate:
    """Search the most probable values from a first guess, (B, P) scaled.

    Windows with a misfit are fitted again with errors of the readings and a timing of their own (:func:`_fit_errors`).
    The search is repeated for those that even this does not explain. The second search approaches the whole window in
    more steps. Further searches begin at random values from the priors, with a fixed seed; their initial states begin
    at the first guess again. ``directions`` are the steps of the first differences
    (:meth:`~hydro_rig.estimation.model.Model.directions`).
    """
    best = _descend(model, measured, np.arange(model.count), first, belief, settings, directions)
    lowest = best.chi2_per_sample.copy()
    _fit_errors(model, measured, np.arange(model.count), first, best, belief, settings)
    random = np.random.default_rng(0)
    varied = np.array([name not in STARTS for name in model.names])
    slowly = settings.model_copy(update={"horizons": _between(settings.horizons)})
    for attempt in range(settings.restarts):
        again = np.flatnonzero(~best.holds | (best.uneven if attempt == 0 else np.zeros(len(best), np.bool_)))
        if not len(again):
            break
        begin = first[again]
        if attempt > 0:
            begin = np.where(varied, RESTART * random.standard_normal(begin.shape), begin)
        part = Belief(belief.mean[again], belief.precision[again])
        found = _descend(model, measured, again, begin, part, slowly, None, attempt + 2)
        lower = np.flatnonzero(found.chi2_per_sample < NEW_MINIMUM * lowest[again])
        again, found = again[lower], found.part(lower)
        lowest[again] = found.chi2_per_sample
        _fit_errors(model, measured, again, begin[lower], found, belief, settings)
        best.take(again, found, found.unlikelihood < best.unlikelihood[again])
    return best


def _fit_errors(
    model: Model,
    measured: Floats,
    window: Indices,
    first: Floats,
    found: Estimate,
    belief: Belief,
    settings: EstimationSettings,
) -> None:
    """Fit windows with a misfit again, and write the results into ``found``, (B,) of the windows ``window``.

    Latency and rise time are further unknowns. White noise, slow error and spikes of each channel follow from the
    residuals; they weigh the readings of the next fit.
    """
    odd = np.flatnonzero(~found.holds & np.isfinite(found.scaled).all(axis=1))
    if not (settings.errors and len(odd)):
        return
    window, count, own = window[odd], len(odd), len(model.names)
    more = {name: prior for name, prior in timing_priors(model.config).items() if name not in model.names}
    wide, row = model.with_more(more, window), np.arange(count)
    scaled = np.concatenate([first[odd], np.zeros((count, len(more)))], axis=1)
    mean, precision = np.zeros_like(scaled), np.tile(np.eye(own + len(more)), (count, 1, 1))
    mean[:, :own], precision[:, :own, :own] = belief.mean[window], belief.precision[window]
    wider, data = Belief(mean, precision), measured[window]
    if LATENCY in more:
        scaled[:, own], shift = _row_of_the_command(wide, data, scaled)
        data[shift > 0, :, :UNKNOWN_COMMANDS] = np.nan  # moved by rows of the command that the window does not hold
        data[shift < 0, :, -UNKNOWN_COMMANDS:] = np.nan
    scaled = _approach(wide, data, row, scaled, wider, settings)
    errors, spikes = Errors.of_data_sheet(*data.shape[:2]), np.zeros(data.shape, np.bool_)
    for attempt in range(ROUNDS):
        limit, tolerance = settings.iterations, settings.tolerance
        kept = np.where(spikes, np.nan, data)
        last = fit(wide, kept, row, scaled, wider, wide.samples, limit, tolerance, step=SHORT_STEP, errors=errors)
        scaled = last.scaled
        if attempt == 0:
            before = scaled
        elif attempt == 1:  # the first round did not know the spikes
            before = np.where(np.any(spikes, axis=(1, 2), keepdims=True)[:, :, 0], scaled, before)
        residual = data - wide.readings(scaled, row)[0]
        spikes = spikes_of(residual, np.isfinite(residual))
        known = np.isfinite(residual) & ~spikes
        errors, unlikelihood = errors_of(np.where(known, residual, 0.0), known)
    kept = np.where(spikes, np.nan, data)
    again = assess(
        wide, kept, row, scaled, wider, settings, last.iterations, last.directions, found.searches[odd], errors
    )
    again.widen(scaled - before, wide.derivative(scaled))
    signal = np.nanstd(np.where(np.isfinite(kept).any(axis=2, keepdims=True), kept, 0.0), axis=2)  # 0: absent
    small = errors.slow <= np.maximum(LARGEST_SLOW_ERROR * np.nan_to_num(signal), SMALL_SLOW_ERROR)
    again.holds[:] &= small.all(axis=1)
    if LEAKAGE in model.names:  # a leak that is surely negative stands for an error of the model
        again.holds[:] &= again.value(LEAKAGE) + SURE * again.deviation(LEAKAGE) >= 0.0
    again.spikes[:] = spikes.sum(axis=2) / np.maximum(known.sum(axis=2) + spikes.sum(axis=2), 1)
    again.unlikelihood[:] = unlikelihood
    found.take(odd, again)


def _row_of_the_command(model: Model, measured: Floats, scaled: Floats) -> tuple[Floats, Indices]:
    """Scaled latency, (B,), and by how many rows the command is late, (B,): by the spool, which follows it."""
    place, spool = model.names.index(LATENCY), SENSORS.index("spool_position")
    rows = np.array([0, -1, 1])
    shifts = rows * model.config.control_period / timing_priors(model.config)[LATENCY].deviation
    missed = []
    for shift in shifts:
        tried = scaled.copy()
        tried[:, place] += shift
        away = (measured - model.readings(tried, np.arange(len(tried)))[0])[:, spool]
        missed.append((np.where(np.isfinite(away), away, 0.0) ** 2).sum(axis=1))
    best = np.argmin(missed, axis=0)
    return scaled[:, place] + shifts[best], rows[best]


def timing_priors(config: TaskConfig) -> dict[str, Prior]:
    """Priors of the timing of a recording whose data sheet does not hold: from about one row early to two rows late."""
    latency = {LATENCY: Prior(config.command_latency, config.control_period)}
    return latency | ({RISE_TIME: prior_of(config, RISE_TIME)} if config.sensors.enabled else {})


def _between(horizons: Sequence[float]) -> tuple[float, ...]:
    """The same horizons, with another one between each two of them."""
    return tuple(sorted({*horizons, *((a * b) ** 0.5 for a, b in pairwise(horizons))}))


def _descend(
    model: Model,
    measured: Floats,
    window: Indices,
    first: Floats,
    belief: Belief,
    settings: EstimationSettings,
    directions: Floats | None,
    searches: int = 1,
) -> Estimate:
    """Fit short and then longer beginnings of some windows roughly, then the whole windows to the lowest cost."""
    scaled = _approach(model, measured, window, first, belief, settings)
    limit, tolerance = settings.iterations, settings.tolerance
    found = fit(model, measured, window, scaled, belief, model.samples, limit, tolerance, directions, step=SHORT_STEP)
    return assess(model, measured, window, found.scaled, belief, settings, found.iterations, found.directions, searches)


def _approach(
    model: Model, measured: Floats, window: Indices, first: Floats, belief: Belief, settings: EstimationSettings
) -> Floats:
    """Fit short and then longer beginnings of some windows roughly; returns the scaled unknowns, (B, P)."""
    scaled = first
    interval = float(np.median(model.commands.durations))
    lengths = [max(round(length / interval), SHORTEST_FIT) for length in settings.horizons]
    lengths = [samples for samples in lengths if samples < 0.8 * model.samples]
    for samples in [*lengths, model.samples] if settings.horizons else []:
        limit, tolerance = settings.horizon_iterations, settings.horizon_tolerance
        scaled = fit(model, measured, window, scaled, belief, samples, limit, tolerance, thorough=False).scaled
    return scaled


def assess(
    model: Model,
    measured: Floats,
    window: Indices,
    scaled: Floats,
    belief: Belief,
    settings: EstimationSettings,
    iterations: Indices,
    directions: Floats,
    searches: int | Indices = 1,
    errors: Errors | None = None,
) -> Estimate:
    """Uncertainty and goodness of fit at some values, (B, P) scaled.

    ``errors`` are those of the readings; ``None``: white noise as in the data sheet. A slow error widens the
    deviations.
    """
    known = np.isfinite(measured[window])
    linear = model.linearise(scaled, window, directions)
    residual, jacobian = masked(linear, measured[window], known, errors)
    errors = errors or Errors.of_data_sheet(len(scaled), known.shape[1])
    precision = jacobian @ jacobian.transpose(0, 2, 1) + belief.precision
    covariance = np.linalg.inv(precision)
    values = model.values(scaled)
    usual = {LATENCY: model.config.command_latency, RISE_TIME: model.config.sensors.pressure_rise_time}
    timing = {
        name: values[:, model.names.index(name)] if name in model.names else np.full(len(scaled), value)
        for name, value in usual.items()
    }
    count = known.sum(axis=(1, 2))
    chi2 = (residual**2).sum(axis=1)
    variance = np.einsum("bii->bi", covariance)
    # A search that ended far off may have a singular information matrix: such a window is unreliable.
    solvable = np.all(variance > 0.0, axis=1)
    misfit = np.where(solvable, misfit_of(residual, jacobian, covariance, known), np.inf)
    scale = model.derivative(scaled)
    widening = np.where((errors.slow > 0.0).any(axis=1), WIDENING, 1.0)
    precision, covariance = precision / widening[:, None, None] ** 2, covariance * widening[:, None, None] ** 2
    deviation = widening[:, None] * np.sqrt(np.where(variance > 0.0, variance, 1.0))
    return Estimate(
        names=model.names,
        values=values,
        deviations=deviation * scale,
        covariance=covariance * scale[:, :, None] * scale[:, None, :],
        remaining=deviation,
        chi2_per_sample=chi2 / np.maximum(count, 1),
        misfit=misfit,
        holds=misfit < settings.largest_misfit,
        iterations=iterations,
        searches=np.array(np.broadcast_to(searches, len(scaled))),
        scaled=scaled,
        precision=precision,
        white=errors.white,
        slow=errors.slow,
        memory=errors.memory,
        spikes=np.zeros_like(errors.white),
        latency=timing[LATENCY],
        rise_time=timing[RISE_TIME],
        unlikelihood=chi2,
    )
