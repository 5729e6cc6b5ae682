"""Estimates the unknowns of recorded windows: values, uncertainty, and whether the model explains the readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.estimation.first_guess import first_values
from hydro_agents.estimation.model import SHORT_STEP, Model
from hydro_agents.estimation.solver import Belief, fit, masked, misfit_of, prior_belief
from hydro_agents.estimation.unknowns import STARTS, Prior, priors_of
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.sensors import SENSORS
from hydro_env.units import Number

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SAMPLES_PER_BATCH = 25_600  # largest number of samples, over all windows, in one fit; more would only need more memory
SHORTEST_FIT = 10  # samples; shorter fits carry no information
RESTART = 0.7  # standard deviation of the random start of a further search, in standard deviations of the prior
UNLIKELY = 4.0  # standard deviations of the prior beyond which a value contradicts it
UNDETERMINED = 0.7  # an unknown is undetermined if its standard deviation remains above this share of the prior's


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


@dataclass(frozen=True)
class Estimate:
    """Estimates of B windows with P unknowns; values in the units of :mod:`hydro_agents.estimation.unknowns`.

    ``deviations`` and ``covariance`` are valid where ``holds`` is true. Elsewhere the model does not explain the
    readings, or the search ended in a local minimum; the values are then unreliable.
    """

    names: tuple[str, ...]
    values: Array  # (B, P), most probable values
    deviations: Array  # (B, P), standard deviations
    covariance: Array  # (B, P, P)
    remaining: Array  # (B, P), standard deviation over the prior's, both of the scaled unknown
    chi2_per_sample: Array  # (B,), about 1 if readings and model differ only by noise
    misfit: Array  # (B,), standard deviations by which chi2, of samples or of block means, exceeds its expectation
    holds: NDArray[np.bool_]  # (B,), whether the model explains the readings
    iterations: Indices  # (B,), of the last fit
    searches: Indices  # (B,), 1 if the first search gave the result
    scaled: Array  # (B, P), the values in standard deviations of the prior from its mean
    precision: Array  # (B, P, P), inverse covariance of the scaled unknowns

    def __len__(self) -> int:
        return len(self.values)

    def value(self, name: str) -> Array:
        """Values of one unknown, (B,)."""
        return self.values[:, self._place(name)]

    def deviation(self, name: str) -> Array:
        """Standard deviations of one unknown, (B,)."""
        return self.deviations[:, self._place(name)]

    def interval(self, name: str, coverage: float = 0.9) -> tuple[Array, Array]:
        """Lower and upper end, (B,) each, of the interval that covers the true value with probability ``coverage``."""
        reach = NormalDist().inv_cdf(0.5 + 0.5 * coverage) * self.deviation(name)
        return self.value(name) - reach, self.value(name) + reach

    def probability_above(self, name: str, limit: float) -> Array:
        """Probability, (B,), that an unknown is above a limit."""
        normal = NormalDist()
        return np.array([normal.cdf(x) for x in (self.value(name) - limit) / self.deviation(name)])

    def undetermined(self, window: int) -> tuple[str, ...]:
        """Unknowns that a window hardly determines: their standard deviation stays above 0.7 of the prior's."""
        return tuple(n for n, left in zip(self.names, self.remaining[window], strict=True) if left > UNDETERMINED)

    def unlikely(self, window: int) -> tuple[str, ...]:
        """Unknowns whose value lies more than 4 standard deviations from the prior's mean."""
        far = np.abs(self.scaled[window]) > UNLIKELY
        return tuple(name for name, is_far in zip(self.names, far, strict=True) if is_far)

    def replace(self, windows: Indices, by: Estimate, its: Indices) -> None:
        """Replace ``windows`` of this estimate by the windows ``its`` of another estimate."""
        for name in _PER_WINDOW:
            getattr(self, name)[windows] = getattr(by, name)[its]

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise ConfigurationError(f"estimate: '{name}' was not among the unknowns: {', '.join(self.names)}")
        return self.names.index(name)


def estimate(
    signals: Array,
    config: TaskConfig,
    unknowns: Sequence[str] | None = None,
    *,
    priors: Mapping[str, Prior] | None = None,
    durations: Array | None = None,
    physical: Array | None = None,
    first: Mapping[str, Array | float] | None = None,
    settings: EstimationSettings | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    boundary: Array | None = None,
) -> Estimate:
    """Estimate the unknowns of measured windows: maximum a posteriori, with the simulator as model.

    Args:
        signals: (B, 5, T) or (5, T), SI: position (m), pressures a and b (Pa), spool position, command. Column k holds
            the readings of sample k and the command that acts until one latency after sample k. NaN: no reading.
        config: the task: the rig, its ranges, its sensors.
        unknowns: names (:mod:`hydro_agents.estimation.unknowns`); ``None``: all that an episode draws, and the start.
        priors: priors that replace those of the task, by name.
        durations: from each sample to the next, (T − 1,) or (B, T − 1), s; ``None``: the control period.
        physical: known parameters of each window, (B, parameters); ``None``: those of the task's plant.
        first: initial values by name, each (B,) or a number; ``None``: guessed from the signals.
        settings: of the search.
        threads: worker threads; ``None`` takes one per core.
        progress: called with the number of finished windows.
        boundary: recorded supply and tank pressure, (B, 2, T), Pa; NaN, ``None``: those of the plant.

    Raises:
        ConfigurationError: a shape, a command, a duration or a name is wrong.

    Example:
        >>> import numpy as np
        >>> from hydro_agents.estimation.estimate import estimate
        >>> from hydro_agents.estimation.known_windows import known_windows
        >>> from hydro_agents.learning.opponents import shipped
        >>> from hydro_agents.running.cases import Cases
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig()
        >>> cases = Cases(np.array([1]), np.array([1.0]), np.array(["multi_sine"]))
        >>> windows = known_windows(task, shipped("pid", task), cases, begin=0.0, length=1.0)
        >>> found = estimate(windows.signals, task)
        >>> np.round(found.value("leakage_flow_lpm"), 1)  # l/min at 100 bar
        array([1.])
    """
    settings = settings or EstimationSettings()
    windows = checked_signals(signals)
    known = priors_of(config, unknowns, priors)
    own = None if physical is None else np.broadcast_to(physical, (len(windows), np.shape(physical)[-1]))
    begin = {name: np.broadcast_to(value, len(windows)) for name, value in (first or {}).items()}
    parts = []
    together = max(SAMPLES_PER_BATCH // windows.shape[2], 1)
    for low in range(0, len(windows), together):
        part = slice(low, low + together)
        edge = None if boundary is None else boundary[part]
        time = durations[part] if durations is not None and np.ndim(durations) == 2 else durations
        model = Model(
            config, known, windows[part, -1], time, own[part] if own is not None else None, None, threads, edge
        )
        guess = first_values(windows[part], model.commands.durations, config, known)
        for name, value in begin.items():
            if name not in known:
                raise ConfigurationError(f"first: '{name}' is not among the unknowns")
            guess[:, model.names.index(name)] = value[part]
        measured = usable_readings(windows[part], config, model)
        belief = prior_belief(model, model.count)
        parts.append(search(model, measured, model.scaled(guess), belief, settings))
        if progress is not None:
            progress(min(low + together, len(windows)))
    return join(parts)


def checked_signals(signals: Any) -> Array:
    """Signals as (B, 5, T).

    Raises:
        ConfigurationError: the shape is wrong, or a reading is infinite.
    """
    try:
        windows = np.asarray(signals, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigurationError("signals: must be an array of numbers (windows, 5, samples)") from None
    shape = windows.shape
    windows = windows[None] if windows.ndim == 2 else windows
    if windows.ndim != 3 or windows.shape[1] != len(SENSORS) + 1 or windows.shape[2] < 2 or not len(windows):
        raise ConfigurationError(f"signals: shape {shape}: must be (windows, {len(SENSORS) + 1}, samples)")
    if np.isinf(windows).any():
        window, channel, sample = np.argwhere(np.isinf(windows))[0]
        name = [*SENSORS, "command"][channel]
        raise ConfigurationError(
            f"signals: {name} of window {window}, sample {sample} is infinite: must be finite, or "
            "NaN if there is no reading"
        )
    return windows


def usable_readings(signals: Array, config: TaskConfig, model: Model) -> Array:
    """Readings over their noise (B, channels, T); NaN if a reading is missing or useless.

    Useless are readings within three standard deviations of the noise from an end of the sensor's range, where they
    saturate, and the first reading of each pressure, whose lag depends on the time before the window.
    """
    readings = signals[:, : len(SENSORS)].copy()
    if config.sensors.enabled:
        sensors = [getattr(config.sensors, channel) for channel in SENSORS]
        low = np.array([sensor.low + 3.0 * sensor.noise for sensor in sensors])[:, None]
        high = np.array([sensor.high - 3.0 * sensor.noise for sensor in sensors])[:, None]
        readings[~((readings > low) & (readings < high))] = np.nan
    readings[:, [SENSORS.index("pressure_a"), SENSORS.index("pressure_b")], 0] = np.nan
    return readings / model.noise[:, None]


def search(
    model: Model,
    measured: Array,
    first: Array,
    belief: Belief,
    settings: EstimationSettings,
    directions: Array | None = None,
) -> Estimate:
    """Search the most probable values from a first guess, (B, P) scaled; repeat the search for windows with a misfit.

    The second search approaches the whole window in more steps. Further searches begin at random values from the
    priors, with a fixed seed; their initial states begin at the first guess again. ``directions`` are the steps of the
    first differences (:meth:`~hydro_agents.estimation.model.Model.directions`).
    """
    best = _descend(model, measured, np.arange(model.count), first, belief, settings, directions)
    random = np.random.default_rng(0)
    varied = np.array([name not in STARTS for name in model.names])
    slowly = settings.model_copy(update={"horizons": _between(settings.horizons)})
    for attempt in range(settings.restarts):
        again = np.flatnonzero(~best.holds)
        if not len(again):
            break
        begin = first[again]
        if attempt > 0:
            begin = np.where(varied, RESTART * random.standard_normal(begin.shape), begin)
        part = Belief(belief.mean[again], belief.precision[again])
        found = _descend(model, measured, again, begin, part, slowly, None, attempt + 2)
        better = np.flatnonzero(found.misfit < best.misfit[again])
        best.replace(again[better], found, better)
    return best


def _between(horizons: Sequence[float]) -> tuple[float, ...]:
    """The same horizons, with another one between each two of them."""
    return tuple(sorted({*horizons, *((a * b) ** 0.5 for a, b in pairwise(horizons))}))


_PER_WINDOW = tuple(field.name for field in fields(Estimate) if field.name != "names")


def join(parts: Sequence[Estimate]) -> Estimate:
    """The windows of several estimates with the same unknowns, one after another."""
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _PER_WINDOW}
    return Estimate(names=parts[0].names, **joined)


def _descend(
    model: Model,
    measured: Array,
    window: Indices,
    first: Array,
    belief: Belief,
    settings: EstimationSettings,
    directions: Array | None,
    searches: int = 1,
) -> Estimate:
    """Fit short and then longer beginnings of some windows roughly, then the whole windows to the lowest cost."""
    scaled = first
    interval = float(np.median(model.commands.durations))
    lengths = [max(round(length / interval), SHORTEST_FIT) for length in settings.horizons]
    lengths = [samples for samples in lengths if samples < 0.8 * model.samples]
    for samples in [*lengths, model.samples] if settings.horizons else []:
        limit, tolerance = settings.horizon_iterations, settings.horizon_tolerance
        scaled = fit(model, measured, window, scaled, belief, samples, limit, tolerance, thorough=False).scaled
    limit, tolerance = settings.iterations, settings.tolerance
    found = fit(model, measured, window, scaled, belief, model.samples, limit, tolerance, directions, step=SHORT_STEP)
    return assess(model, measured, window, found.scaled, belief, settings, found.iterations, found.directions, searches)


def assess(
    model: Model,
    measured: Array,
    window: Indices,
    scaled: Array,
    belief: Belief,
    settings: EstimationSettings,
    iterations: Indices,
    directions: Array,
    searches: int = 1,
) -> Estimate:
    """Uncertainty and goodness of fit at some values, (B, P) scaled."""
    known = np.isfinite(measured[window])
    linear = model.linearise(scaled, window, directions)
    residual, jacobian = masked(linear, measured[window], known)
    precision = jacobian @ jacobian.transpose(0, 2, 1) + belief.precision
    covariance = np.linalg.inv(precision)
    count = known.sum(axis=(1, 2))
    chi2 = (residual**2).sum(axis=1)
    variance = np.einsum("bii->bi", covariance)
    # A search that ended far off may have a singular information matrix: such a window is unreliable.
    solvable = np.all(variance > 0.0, axis=1)
    misfit = np.where(solvable, misfit_of(residual, jacobian, covariance, known), np.inf)
    scale = model.derivative(scaled)
    deviation = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    return Estimate(
        names=model.names,
        values=model.values(scaled),
        deviations=deviation * scale,
        covariance=covariance * scale[:, :, None] * scale[:, None, :],
        remaining=deviation,
        chi2_per_sample=chi2 / np.maximum(count, 1),
        misfit=misfit,
        holds=misfit < settings.largest_misfit,
        iterations=iterations,
        searches=np.full(len(scaled), searches),
        scaled=scaled,
        precision=precision,
    )
