"""Estimates along a run: each window starts from the result of the previous one; offline or in real time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.estimation.estimate import checked_signals, usable_readings
from hydro_agents.estimation.first_guess import first_values
from hydro_agents.estimation.model import LONG_STEP, Model
from hydro_agents.estimation.result import Estimate, join
from hydro_agents.estimation.search import EstimationSettings, search
from hydro_agents.estimation.solver import Belief, prior_belief
from hydro_agents.estimation.unknowns import STARTS, Prior, priors_of
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.states import N_STATES, STATE_NAMES, STATES

Array = NDArray[np.float64]

Indices = NDArray[np.int64]

_SUPPLY, _CURRENT, _GAS = (STATE_NAMES.index(name) for name in ("supply_pressure", "coil_current", "gas_volume"))

MODEL_ERROR = 1e-3
"""Standard deviation, as a fraction of each state's typical size, that is added at the transition to the next window.

It covers the integrator's error and the curvature that the linear uncertainty omits.
"""


class _Before(NamedTuple):
    """Results that a window passes on to the next."""

    scaled: Array  # (N, P), first guess
    belief: Belief  # prior
    precision: Array  # (N, P, P), for the first differences
    current: Array  # (N,), A, coil current at the first sample


class Follower:
    """Follows N axes: after every ``hop`` samples it estimates from the last ``window`` samples.

    The search of each window starts from the parameters and the state of the previous window. Without ``memory`` the
    windows may overlap, and each is estimated alone: a moving window. With ``memory`` the windows do not overlap, and
    the estimate of one is the prior of the next: an iterated extended Kalman filter that processes one window at a
    time. Parameters may drift: earlier information about them fades within ``memory``.

    Args:
        config: the task.
        unknowns: names; ``None``: as in :func:`~hydro_agents.estimation.estimate.estimate`.
        window: samples of a window.
        hop: samples from one window to the next; ``None``: windows that touch.
        memory: s; ``None``: each window alone.
        priors: priors that replace those of the task, by name.
        settings: of the search.
        threads: worker threads; ``None`` takes one per core.

    Raises:
        ConfigurationError: the arguments contradict each other, or a name is unknown.
    """

    def __init__(
        self,
        config: TaskConfig,
        unknowns: Sequence[str] | None = None,
        window: int = 401,
        hop: int | None = None,
        memory: float | None = None,
        priors: Mapping[str, Prior] | None = None,
        settings: EstimationSettings | None = None,
        threads: int | None = None,
    ) -> None:
        self.config, self.window, self.threads = config, window, threads
        self.hop = window - 1 if hop is None else hop
        self.memory = memory
        self.priors = priors_of(config, unknowns, priors)
        self.settings = settings or EstimationSettings()
        if window < 2:
            raise ConfigurationError(f"window = {window}: must be at least 2 samples")
        if not 1 <= self.hop < window:
            raise ConfigurationError(f"hop = {self.hop}: must be 1 to {window - 1}, less than the window")
        if memory is not None and (not memory > 0.0 or self.hop != window - 1):
            raise ConfigurationError(
                f"memory = {memory:g} s, hop = {self.hop}: memory must be above 0, and needs touching windows (no hop)"
            )
        self._signals: list[Array] = []
        self._durations: list[float] = []
        self._before: _Before | None = None

    def update(self, signals: Array, duration: float | None = None) -> Estimate | None:
        """Add one sample of each axis; returns the estimate if a window is complete, else ``None``.

        Args:
            signals: (N, 5), SI: one column of the signals of :func:`~hydro_agents.estimation.estimate.estimate`.
            duration: since the previous sample, s; ``None``: the control period.
        """
        if self._signals:
            self._durations.append(self.config.control_period if duration is None else duration)
        self._signals.append(np.asarray(signals, dtype=np.float64))
        if len(self._signals) < self.window:
            return None
        windows = checked_signals(np.stack(self._signals, axis=-1))
        found = self._estimate(windows, np.array(self._durations))
        del self._signals[: self.hop], self._durations[: self.hop]
        return found

    def window_of(self, signals: Array) -> Estimate:
        """Estimate a whole window, (N, 5, window); the search starts afresh unless the window continues the last one.

        A window continues the last one if its first window − hop samples are the last ones of that window.
        """
        shared = len(self._signals)
        if shared and not np.array_equal(np.stack(self._signals, axis=-1), signals[:, :, :shared], equal_nan=True):
            self._signals, self._durations, self._before, shared = [], [], None, 0
        for sample in range(shared, self.window):
            found = self.update(signals[:, :, sample])
        assert found is not None
        return found

    def _estimate(self, windows: Array, durations: Array) -> Estimate:
        before = self._before
        start = np.zeros((len(windows), N_STATES))
        start[:, _SUPPLY] = self.config.plant.supply.pressure
        start[:, _GAS] = np.nan
        start[:, _CURRENT] = np.nan if before is None else before.current
        model = Model(self.config, self.priors, windows[:, -1], durations, start=start, threads=self.threads)
        if before is None:
            found = self._anew(model, windows)
        else:
            found = self._onwards(model, windows, before)
            misled = np.flatnonzero(~found.holds)
            if self.memory is None and len(misled):
                part = Model(
                    self.config, self.priors, windows[misled, -1], durations, start=start[misled], threads=self.threads
                )
                anew = self._anew(part, windows[misled])
                found.take(misled, anew, anew.misfit < found.misfit[misled])
        self._before = self._hand_on(model, found, durations)
        return found

    def _anew(self, model: Model, windows: Array) -> Estimate:
        """Estimate windows without earlier ones."""
        measured = usable_readings(windows, self.config, model)
        guess = first_values(windows, model.commands.durations, self.config, self.priors)
        return search(model, measured, model.scaled(guess), prior_belief(model, model.count), self.settings)

    def _onwards(self, model: Model, windows: Array, before: _Before) -> Estimate:
        """Estimate windows from the results of the previous windows."""
        measured = usable_readings(windows, self.config, model)
        belief = prior_belief(model, model.count)
        if self.memory is not None:
            measured[:, :, 0] = np.nan  # the previous window has used these readings
            belief = before.belief
        settings = self.settings.model_copy(update={"horizons": (), "restarts": 0})
        directions = model.directions(before.precision, LONG_STEP)
        return search(model, measured, before.scaled, belief, settings, directions)

    def _hand_on(self, model: Model, found: Estimate, durations: Array) -> _Before:
        """First guess and prior of the next window: the parameters, and the state at the start of the next window."""
        linear = model.linearise(found.scaled, None, model.directions(found.precision, LONG_STEP), self.hop + 1)
        scaled, turned = found.scaled.copy(), np.tile(np.eye(len(model.names)), (model.count, 1, 1))
        added = np.zeros((model.count, len(model.names)))  # variance
        deviations = np.array([prior.deviation for prior in self.priors.values()])
        values = model.values(found.scaled)
        covariance = np.linalg.inv(found.precision)
        for place, name in enumerate(model.names):
            if name in STARTS:
                state = STARTS.index(name)
                values[:, place] = linear.last_state[:, state]
                turned[:, place] = linear.last_jacobian[:, :, state] / deviations[place]
                added[:, place] = (MODEL_ERROR * STATES[STATE_NAMES[state]].typical / deviations[place]) ** 2
            elif self.memory is not None:
                known = covariance[:, place, place]
                added[:, place] = np.minimum(known * (durations.sum() / self.memory), np.maximum(1.0 - known, 0.0))
        scaled = model.scaled(values)
        covariance = turned @ covariance @ turned.transpose(0, 2, 1)
        covariance += added[:, :, None] * np.eye(len(model.names))
        precision = np.linalg.inv(covariance)
        return _Before(scaled, Belief(scaled, precision), precision, linear.last_state[:, _CURRENT])


def estimate_run(
    signals: Array,
    config: TaskConfig,
    *,
    durations: Array | None = None,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> tuple[Indices, Estimate]:
    """Estimates of the windows of one long run, and the last sample of each window, (W,).

    Args:
        signals: (5, T), like one window of :func:`~hydro_agents.estimation.estimate.estimate`.
        config: the task.
        durations: from each sample to the next, (T − 1,), s; ``None``: the control period.
        progress: called with the number of samples done.
        options: those of :class:`Follower`, such as ``window``, ``hop``, ``memory`` and ``unknowns``.

    Raises:
        ConfigurationError: the run is shorter than a window, or an argument is wrong.
    """
    follower, run = Follower(config, **options), checked_signals(signals)
    if len(run) != 1 or run.shape[2] < follower.window:
        raise ConfigurationError(
            f"signals: shape {np.shape(signals)}: must be one run (5, samples) of at least {follower.window} samples"
        )
    if durations is not None and np.shape(durations) != (run.shape[2] - 1,):
        raise ConfigurationError(f"durations: shape {np.shape(durations)}: must be ({run.shape[2] - 1},)")
    ends, found = [], []
    for sample in range(run.shape[2]):
        duration = float(durations[sample - 1]) if durations is not None and sample else None
        answer = follower.update(run[:, :, sample], duration)
        if answer is not None:
            ends.append(sample)
            found.append(answer)
            if progress is not None:
                progress(sample + 1)
    return np.array(ends), join(found)
