"""Estimates the unknowns of recorded windows: values, uncertainty, and whether the model explains the readings."""

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.sensors import COMMAND, POSITION, PRESSURE_A, PRESSURE_B, SENSORS, SPOOL
from hydro_env.types import Floats
from hydro_rig.estimation.model import LONG_STEP, Model
from hydro_rig.estimation.result import Errors, Estimate, errors_of, join, spikes_of
from hydro_rig.estimation.solver import Effort, Problem, fit, misfit_of
from hydro_rig.estimation.unknowns import LATENCY, LEAKAGE, RISE_TIME, STARTS, Prior, Priors, prior_of, priors_of

SHORTEST_FIT = 10  # samples; shorter fits carry no information
RESTART = 0.7  # standard deviation of the random start of a further search, in standard deviations of the prior
NEW_MINIMUM = 0.97  # a search with a larger chi2, over the lowest, ended in the same minimum or in a worse one
UNEVEN = 2.0  # white noise of a channel, over the median of all, beyond which a search perhaps ended too early
ROUNDS = 3  # of a fit and an estimate of the errors of its readings, one after the other
LARGEST_SLOW_ERROR = 0.05  # of a channel's standard deviation in the window; with a larger one the model does not hold
SURE = 3.0  # standard deviations of an estimate, beyond which a value is surely another
SMALL_SLOW_ERROR = 3.0  # the same in standard deviations of the data sheet's noise, which is always allowed
SPIKE_COST = 15.0  # twice the negative log-likelihood of a spike: one reading of a hundred, within a hundred deviations
OF_A_BEGINNING = Effort(6, 5.0, LONG_STEP, thorough=False)  # of each fit of a beginning
OF_THE_WHOLE = Effort(100, 0.05)
LARGEST_MISFIT = 4.0  # standard deviations of chi2; above this the model is not valid
SAMPLES_PER_BATCH = 25_600  # largest number of samples, over all windows, in one fit; more would only need more memory
_FIRST_SAMPLES = 6  # number of samples for the straight line that gives each start value


class EstimationSettings(NamedTuple):
    """Settings of the search for an estimate."""

    horizons: tuple[float, ...] = (0.1, 0.2, 0.4, 0.7, 1.2, 2.4, 4.8)  # s, of the first, rough fits
    effort: Effort = OF_THE_WHOLE  # of the last fit
    restarts: int = 3  # further searches for windows that the model does not explain
    errors: bool = True  # whether windows with a misfit are fitted again with errors of their own
    threads: int | None = None  # worker threads; None takes one per core


def estimate(
    signals: Floats,
    config: TaskConfig,
    unknowns: Iterable[str] | None = None,
    *,
    priors: Priors | None = None,
    physical: Floats | None = None,
    first: Mapping[str, Floats | float] | None = None,
    settings: EstimationSettings | None = None,
    boundary: Floats | None = None,
) -> Estimate:
    """Estimate the unknowns of measured windows: maximum a posteriori, with the simulator as model.

    ``signals``: (B, 5, T) or (5, T), SI: position (m), pressures a and b (Pa), spool position, command. Column k holds
    the readings of sample k and the command that acts until one latency after it; NaN: no reading. ``unknowns``: names
    (:mod:`hydro_rig.estimation.unknowns`); default: all that an episode draws, and the start. ``priors`` replace those
    of the task. ``physical`` and ``boundary``: as of :class:`~hydro_rig.estimation.model.Model`. ``first``: initial
    values by name, each (B,) or a number; default: guessed from the signals.

    Raises:
        ConfigurationError: a shape, a command or a name is wrong.

    Example:
        >>> import numpy as np
        >>> from hydro_rig.estimation.estimate import estimate
        >>> from hydro_rig.estimation.known_windows import known_windows
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_agents.running.cases import Cases
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig()
        >>> cases = Cases(np.array([1]), np.array([1.0]), np.array(["multi_sine"]))
        >>> windows = known_windows(task, shipped("pid", task), cases, begin=0.0, length=1.0)
        >>> found = estimate(windows.signals, task)
        >>> np.round(found.value("leakage_flow_lpm"), 1)  # l/min at 100 bar
        array([1.])
    """
    windows = checked_signals(signals)
    known = priors_of(config, unknowns, priors)
    settings = settings or EstimationSettings()
    model = Model(config, known, windows[:, -1], physical, None, settings.threads, boundary)
    guess = first_values(windows, config, known)
    for name, values in (first or {}).items():
        if name not in known:
            raise ConfigurationError(f"first: '{name}' is not among the unknowns")
        guess[:, model.names.index(name)] = values
    problem, scaled = Problem(model, usable_readings(windows, config, model)), model.prior.scaled(guess)
    together = max(SAMPLES_PER_BATCH // windows.shape[2], 1)
    batches = np.split(np.arange(len(windows)), range(together, len(windows), together))
    return join([search(problem.part(rows), scaled[rows], settings) for rows in batches])


def checked_signals(signals: Any) -> Floats:
    """Signals as (B, 5, T); ConfigurationError: the shape is wrong."""
    windows = np.asarray(signals, float)
    shape = windows.shape
    windows = windows[None] if windows.ndim == 2 else windows
    if windows.ndim != 3 or windows.shape[1] != len(SENSORS) + 1 or windows.shape[2] < 2 or not len(windows):
        raise ConfigurationError(f"signals: shape {shape}: must be (windows, {len(SENSORS) + 1}, samples)")
    return windows


def usable_readings(signals: Floats, config: TaskConfig, model: Model) -> Floats:
    """Readings over their noise (B, channels, T); NaN if a reading is missing or useless.

    Useless are readings within three standard deviations of the noise from an end of the sensor's range, where they
    saturate, and the first reading of each pressure, whose lag depends on the time before the window.
    """
    readings = signals[:, :COMMAND].copy()
    if config.sensors.enabled:
        sensors = config.sensors.in_order
        low = np.array([sensor.low + 3.0 * sensor.noise for sensor in sensors])[:, None]
        high = np.array([sensor.high - 3.0 * sensor.noise for sensor in sensors])[:, None]
        readings[~((readings > low) & (readings < high))] = np.nan
    readings[:, [PRESSURE_A, PRESSURE_B], 0] = np.nan
    return readings / model.noise[:, None]


def first_values(signals: Floats, config: TaskConfig, priors: Priors) -> Floats:
    """First values (B, P) of the unknowns of B windows; the prior's mean where the signals give no information.

    ``signals``: (B, channels + 1, T), NaN where a reading is missing.
    """
    if config.sensors.differential_pressure:
        signals = two_pressures(signals, config)
    value, slope = _starts(signals[:, :COMMAND, :_FIRST_SAMPLES], config.control_period)
    seen = {f"start.{channel}": value[:, row] for row, channel in enumerate(SENSORS)}
    seen["start.velocity"] = slope[:, POSITION]
    seen["start.tip_position"], seen["start.tip_velocity"] = seen["start.position"], seen["start.velocity"]
    spool = value[:, SPOOL]  # without a spool sensor, the spool equals its command
    seen["start.spool_position"] = np.where(np.isnan(spool), signals[:, -1, 0], spool)
    first = np.tile([prior.mean for prior in priors.values()], (len(signals), 1))
    for column, name in zip(first.T, priors, strict=True):
        if name in seen:
            column[:] = np.where(np.isfinite(seen[name]), seen[name], column)
    return first


def two_pressures(signals: Floats, config: TaskConfig) -> Floats:
    """The signals with both pressures in place of their difference: with equal edges their sum is the supply's."""
    total, difference = config.plant.supply.pressure + config.plant.supply.tank_pressure, signals[:, PRESSURE_A]
    pair = np.stack([0.5 * (total + difference), 0.5 * (total - difference)], axis=1)
    return np.concatenate([signals[:, :PRESSURE_A], pair, signals[:, PRESSURE_B + 1 :]], axis=1)


def _starts(near: Floats, period: float) -> tuple[Floats, Floats]:
    """Value and slope of each channel at the first sample, (B, channels) each, from a line through a few samples."""
    time = period * np.arange(near.shape[2])
    weight = np.isfinite(near)
    reading = np.nan_to_num(near)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = weight.sum(axis=2)
        middle = (weight * time).sum(axis=2) / total
        mean = (weight * reading).sum(axis=2) / total
        away = time - middle[:, :, None]
        slope = (weight * away * reading).sum(axis=2) / (weight * away**2).sum(axis=2)
        return np.where(total >= 2, mean - slope * middle, mean), slope


def search(problem: Problem, first: Floats, settings: EstimationSettings) -> Estimate:
    """Search the most probable values from a first guess, (B, P) scaled.

    Windows with a misfit are fitted again with errors of the readings and a timing of their own (:func:`_fit_errors`).
    The search is repeated for those that even this does not explain. The second search approaches the whole window in
    more steps. Further searches begin at random values from the priors, with a fixed seed; their initial states begin
    at the first guess again.
    """
    best = _descend(problem, first, settings)
    lowest = best.chi2_per_sample.copy()
    _fit_errors(problem, first, best, settings)
    random = np.random.default_rng(0)
    varied = np.array([name not in STARTS for name in problem.model.names])
    between = {(a * b) ** 0.5 for a, b in pairwise(settings.horizons)}
    slowly = settings._replace(horizons=tuple(sorted({*settings.horizons, *between})))
    for attempt in range(settings.restarts):
        uneven = best.white.max(axis=1) > UNEVEN * np.median(best.white, axis=1)
        again = np.flatnonzero(~best.holds | (uneven & (attempt == 0)))
        if not len(again):
            break
        begin = first[again]
        if attempt > 0:
            begin = np.where(varied, RESTART * random.standard_normal(begin.shape), begin)
        found = _descend(problem.part(again), begin, slowly)
        lower = np.flatnonzero(found.chi2_per_sample < NEW_MINIMUM * lowest[again])
        again, found = again[lower], found.part(lower)
        lowest[again] = found.chi2_per_sample
        _fit_errors(problem.part(again), begin[lower], found, settings)
        best.take(again, found, found.unlikelihood < best.unlikelihood[again])
    return best


def _fit_errors(problem: Problem, first: Floats, found: Estimate, settings: EstimationSettings) -> None:
    """Fit windows with a misfit again, and write the results into ``found``, the estimate of the problem.

    Latency and rise time are further unknowns. White noise, slow error and spikes of each channel follow from the
    residuals; they weigh the readings of the next fit.
    """
    odd = np.flatnonzero(~found.holds & np.isfinite(found.scaled).all(axis=1))
    if not (settings.errors and len(odd)):
        return
    names = problem.model.names
    more = {name: prior for name, prior in timing_priors(problem.model.config).items() if name not in names}
    wide = problem.part(odd).with_more(more)
    scaled, data = _approach(wide, np.pad(first[odd], ((0, 0), (0, len(more)))), settings), wide.measured
    kept, spikes = wide._replace(errors=Errors.of_data_sheet(*data.shape[:2])), np.zeros(data.shape, bool)
    for attempt in range(ROUNDS):
        scaled, directions = fit(kept, scaled, settings.effort)
        if attempt == 0:
            before = scaled
        elif attempt == 1:  # the first round did not know the spikes
            before = np.where(np.any(spikes, axis=(1, 2), keepdims=True)[:, :, 0], scaled, before)
        residual = wide.residual(scaled[:, None])[:, 0]
        readable = np.isfinite(data) & np.isfinite(residual)
        spikes = spikes_of(residual, readable)
        known = readable & ~spikes
        errors, unlikelihood = errors_of(np.where(known, residual, 0.0), known)
        kept = wide._replace(measured=np.where(spikes, np.nan, data), errors=errors)
    again = assess(kept, scaled, directions)
    again.deviations[:] = np.hypot(again.deviations, (scaled - before) * wide.model.prior.slope(scaled))
    signal = np.where(np.isfinite(kept.measured).any(axis=2, keepdims=True), kept.measured, 0.0)  # 0: absent
    small = errors.slow <= np.maximum(LARGEST_SLOW_ERROR * np.nan_to_num(np.nanstd(signal, axis=2)), SMALL_SLOW_ERROR)
    again.holds[:] &= small.all(axis=1)
    if LEAKAGE in names:  # a leak that is surely negative stands for an error of the model
        again.holds[:] &= again.value(LEAKAGE) + SURE * again.deviation(LEAKAGE) >= 0.0
    again.spikes[:] = spikes.sum(axis=2) / np.maximum(readable.sum(axis=2), 1)
    again.unlikelihood[:] = unlikelihood + SPIKE_COST * spikes.sum(axis=(1, 2))
    found.take(odd, again, np.ones(len(odd), bool))


def timing_priors(config: TaskConfig) -> dict[str, Prior]:
    """Priors of the timing of a recording whose data sheet does not hold: from about one row early to two rows late."""
    latency = {LATENCY: Prior(config.command_latency, config.control_period)}
    return latency | ({RISE_TIME: prior_of(config, RISE_TIME)} if config.sensors.enabled else {})


def _descend(problem: Problem, first: Floats, settings: EstimationSettings) -> Estimate:
    """Fit short and then longer beginnings of the windows roughly, then the whole windows to the lowest cost."""
    return assess(problem, *fit(problem, _approach(problem, first, settings), settings.effort))


def _approach(problem: Problem, first: Floats, settings: EstimationSettings) -> Floats:
    """Fit short and then longer beginnings of the windows roughly; returns the scaled unknowns, (B, P)."""
    scaled, whole = first, problem.model.samples
    interval = problem.model.config.control_period
    lengths = [max(round(length / interval), SHORTEST_FIT) for length in settings.horizons]
    lengths = [samples for samples in lengths if samples < 0.8 * whole]
    for samples in [*lengths, whole] if settings.horizons else []:
        scaled, _ = fit(problem, scaled, OF_A_BEGINNING, samples)
    return scaled


def assess(problem: Problem, scaled: Floats, directions: Floats) -> Estimate:
    """Uncertainty and goodness of fit at some values, (B, P) scaled.

    A slow error may be one of the model, of which an unknown has taken up a part that no residual shows. That part is
    taken to be as large as the one that they show, and to point where it moves the unknown most. A channel that differs
    alone hardly counts then (:meth:`Errors.as_white`). Where several do, the end of a 90 % interval is as far as the
    norm of all their slow errors moves an unknown by the data sheet (Cauchy and Schwarz).
    """
    model, linear = problem.model, problem.linearised(scaled, directions)
    known = linear.known
    errors = problem.errors or Errors.of_data_sheet(*known.shape[:2])
    covariance = doubtful = linear.covariance()
    if problem.errors:
        count, samples = known.sum(axis=2), known.shape[2]
        as_white = problem._replace(errors=errors.as_white(count, samples)).linearised(scaled, directions)
        by_data_sheet = problem._replace(errors=None).linearised(scaled, directions).covariance()
        square = errors.of_model(samples) * (count * errors.slow**2).sum(axis=1)
        doubtful = as_white.covariance() + (square / HALF_WIDTH**2)[:, None, None] * by_data_sheet
    values = model.prior.value(scaled)
    timing = {LATENCY: model.config.command_latency, RISE_TIME: model.config.sensors.pressure_rise_time}
    timing |= {name: values[:, model.names.index(name)] for name in timing if name in model.names}
    chi2 = (linear.residual**2).sum(axis=1)
    variance = np.einsum("bii->bi", doubtful)
    # A search that ended far off may have a singular information matrix: such a window is unreliable.
    misfit = np.where(np.all(variance > 0.0, axis=1), misfit_of(linear, covariance), np.inf)
    deviation = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    return Estimate(
        names=model.names,
        values=values,
        deviations=deviation * model.prior.slope(scaled),
        chi2_per_sample=chi2 / np.maximum(known.sum(axis=(1, 2)), 1),
        misfit=misfit,
        holds=misfit < LARGEST_MISFIT,
        scaled=scaled,
        white=errors.white,
        slow=errors.slow,
        memory=errors.memory,
        spikes=np.zeros_like(errors.white),
        latency=np.full(len(scaled), timing[LATENCY]),
        rise_time=np.full(len(scaled), timing[RISE_TIME]),
        of_model=errors.of_model(known.shape[2]),
        parts=np.fromiter([()] * len(scaled), np.object_),
        unlikelihood=chi2,
    )
