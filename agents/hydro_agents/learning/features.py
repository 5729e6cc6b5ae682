"""Inputs of the policy network: observation, command of the controller that it corrects, short history of signals.

Leakage, stiffness of the oil, mass and friction are hidden, but they affect the recent past of pressures, spool and
error. Training and inference use the same class. The inputs can be normalised by their typical sizes, so that a network
sees 10 µm and 10 mm.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from hydro_agents.controllers.base import ClassicalController, Controller, Observation, ObservationLayout
from hydro_agents.controllers.preview import Preview
from hydro_agents.controllers.registry import kind_of
from hydro_agents.running.seeds import SCALES
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.paces import periods_per_step
from hydro_env.types import Array, Floats, Indices, Mask, Singles

MIDDLE = 0.6  # share of the samples that stay within one unit
RARE = 0.3  # unit of an input that is constant most of the time, as a fraction of its standard deviation
LEAST = 0.02  # an input is constant most of the time if its unit (from MIDDLE) is below this part of its spread

HISTORY_SIGNALS = (
    "position",
    "velocity_estimate",
    "pressure_a",
    "pressure_b",
    "spool_position",
    "previous_command",
    "tracking_error",
)
HISTORY_LAGS = (1, 2, 3, 5, 8, 12, 18, 26, 36)  # ages of the samples in the history, in steps of the rig
NEWEST = (1, 2, 3)  # control periods; on a slow rig, a training without these samples learns less
AVERAGING_TIMES = (20.0, 100.0, 500.0)  # of the slow averages that a policy on its own may see, steps of the rig
AVERAGED = ("tracking_error", "spool_position", "spool_position", "velocity_estimate", "velocity_estimate")
"""The error; opening, and then speed, each while the valve opens outwards and inwards."""
LASTING_TIME = 0.2  # s; time constant of the slow average of the correction. Integral action handles slower errors.
PREVIEW_SCALE = 0.01  # m; scale of the rebuilt samples of the preview, the same as in the observation
FEATURE_LIMIT = 50.0  # inputs of the policy are limited to ± this value


class Normalisation(NamedTuple):
    """``arcsinh((input − centre) / unit)``: linear up to about one unit, logarithmic beyond; (inputs,) each."""

    centre: Singles
    unit: Singles

    def __call__(self, inputs: Singles) -> Singles:
        """The normalised inputs, (N, inputs)."""
        normalised: Singles = np.arcsinh((inputs - self.centre) / self.unit)
        return normalised

    @classmethod
    def of(cls, inputs: Array) -> Normalisation:
        """Centre and unit of each input over all rows (rows, inputs)."""
        values = inputs.astype(np.float64)
        centre = np.median(values, axis=0)
        middle = np.quantile(np.abs(values - centre), MIDDLE, axis=0)
        spread = values.std(axis=0)
        unit = np.where(middle > LEAST * spread, middle, RARE * spread)
        return cls(centre.astype(np.float32), np.where(unit > 1e-9, unit, 1.0).astype(np.float32))


class Standardisation(NamedTuple):
    """``(input − centre) / unit``, within ± the limit: what ``VecNormalize`` of stable-baselines3 makes of inputs."""

    centre: Singles
    unit: Singles
    limit: Singles  # ()

    def __call__(self, inputs: Singles) -> Singles:
        """The standardised inputs, (N, inputs)."""
        standardised: Singles = np.clip((inputs - self.centre) / self.unit, -self.limit, self.limit)
        return standardised


def history_lags(config: TaskConfig) -> tuple[int, ...]:
    """:data:`HISTORY_LAGS` in control periods, each at least one, equal ones once; and the newest three samples."""
    periods = periods_per_step(config)
    return tuple(sorted({*NEWEST, *(max(round(lag * periods), 1) for lag in HISTORY_LAGS)}))


class FeatureState(NamedTuple):
    """Memory of N axes; no call changes its argument."""

    base: Any  # memory of the controller that the policy corrects; ``None`` without one
    ring: Singles  # recent signals (N, length, signals), the oldest first
    base_command: Singles  # command of the corrected controller at the last call, (N, 1)
    lasting: Singles  # slow averages (first order), of the correction, (N, 1), or of signals, (N, averages)
    reference: Floats  # the reference from one period ago to the farthest preview, m, (N, samples)
    hidden: Singles | None = None  # memory of a recurrent policy, (N, 2 cells)


class PolicyFeatures:
    """Turns observations into the inputs of the policy, and its outputs into commands.

    Args:
        config: the task.
        base: the controller that the policy corrects (residual form), or ``None`` (the policy acts on its own).
        residual_scale: command per 1 of the policy's output in the residual form.
        full_preview: whether the policy sees every sample of the preview; those between the shown ones come from
            memory.
        see_estimates: whether the policy sees the estimates of the corrected controller. On its own it remembers slow
            averages instead, from which leak, flow gain and offset of the valve can be told: of the tracking error, and
            of opening and speed by direction.
        lags: ages of the samples in the history, in control periods; default: :func:`history_lags` of the task. Without
            any, the inputs of a policy that acts on its own are the observation.

    Raises:
        ConfigurationError: the corrected controller has no estimates.
    """

    for_any_axis = False  # whether the inputs mean the same on every rig
    see_correction = False  # whether the policy sees its last correction and the slow average of its corrections

    correction = 1.0

    normalising_seeds = SCALES.take(240)  # plants on which the inputs are observed for their typical sizes

    def __init__(
        self,
        config: TaskConfig,
        base: ClassicalController | None = None,
        residual_scale: float = 0.2,
        full_preview: bool = False,
        see_estimates: bool = False,
        lags: tuple[int, ...] | None = None,
    ) -> None:
        self.config, self.base = config, base
        self.normalisation: Normalisation | Standardisation | None = None  # leaves the inputs as they are
        self.layout, self.full_preview = ObservationLayout.of(config), full_preview
        self.residual_scale, self.see_estimates = 1.0, see_estimates
        if base is not None:
            self.residual_scale = residual_scale
            if see_estimates and not base.estimate_names:
                raise ConfigurationError(f"see_estimates: {type(base).__name__} has no estimates")
        self.history = tuple(name for name in HISTORY_SIGNALS if name in self.layout.names)  # a rig may lack sensors
        self.lags = lags if lags is not None else history_lags(config)
        self._columns = self._columns_of(HISTORY_SIGNALS if self.for_any_axis else self.history)
        self._oldest = max(self.lags, default=0)
        self._past = self._oldest - np.array(self.lags, np.int64)  # places in the ring
        self._command_column = self.layout.index("previous_command")
        self._averages = base is None and see_estimates
        self._blend: Any = np.float32(config.control_period / (config.control_period + LASTING_TIME))
        if self._averages:
            rates = 1.0 / (1.0 + periods_per_step(config) * np.array(AVERAGING_TIMES))
            self._blend = np.repeat(rates, len(AVERAGED)).astype(np.float32)
            self._averaged_columns = self._columns_of(AVERAGED)
        self._preview = Preview(config)
        self._rebuilt = np.setdiff1d(np.arange(self._preview.horizon + 2), [1, *(1 + n for n in self._preview.counts)])

    @cached_property
    def moving(self) -> int:
        """Number of inputs that are normalised."""
        plain = copy(self)
        plain.normalisation = None
        inputs, _ = plain(np.zeros((1, len(self.layout.names)), np.float32), None, None)
        return len(inputs[0])

    @property
    def size(self) -> int:
        """Number of inputs."""
        return self.moving

    def __call__(
        self,
        observation: Observation,
        state: FeatureState | None,
        episode_start: Mask | None,
        answer: tuple[Singles, Any] | None = None,
    ) -> tuple[Singles, FeatureState]:
        """Inputs (N, size) for a batch of observations (N, n), and the new memory.

        ``answer`` is what the corrected controller's ``predict`` gave for the observations, if it was called. The
        history consists of the changes since each past sample. Before the start of an episode, it repeats the first
        observation.
        """
        inputs = observation[:, : len(self.layout.names)].astype(np.float32, copy=False)
        signals = inputs[:, self._columns]
        zero = np.zeros((len(signals), 1), dtype=np.float32)
        begins = state is None
        if state is None:
            reference = self._preview.start(observation)
            ring = np.repeat(signals[:, None], self._oldest + 1, axis=1)
            state = FeatureState(None, ring, zero, zero, reference)
            correction = zero
        else:
            correction = inputs[:, self._command_column, None] - state.base_command
            reference = self._preview.advanced(state.reference, observation)
        ring = np.concatenate([state.ring[:, 1:], signals[:, None]], axis=1)
        restarts = None if episode_start is None or not np.any(episode_start) else episode_start[:, None]
        if restarts is not None:
            started = np.flatnonzero(restarts)
            ring[started] = signals[started, None]
            correction = np.where(restarts, zero, correction)
            reference[started] = self._preview.start(observation[started])
        averaged = self._averaged(inputs) if self._averages else correction
        lasting = averaged if begins else state.lasting + self._blend * (averaged - state.lasting)
        if restarts is not None:
            lasting = np.where(restarts, averaged, lasting)
        past = ring[:, self._past].reshape(len(signals), -1)
        changes = np.tile(signals, len(self.lags)) - past
        state = state._replace(ring=ring, reference=reference)
        seen = self._seen(inputs, signals, reference)
        if self.base is None:
            if self._averages:
                seen, state = [*seen, lasting], state._replace(lasting=lasting)
            return self._normalised([*seen, changes]), state
        command, memory = answer or self.base.predict(observation, state.base, episode_start)
        own = [command]
        if self.see_correction:
            own += [correction, lasting]
        if self.see_estimates:
            own.append(self.base.estimates(memory))
        state = state._replace(base=memory, base_command=command, lasting=lasting)
        return self._normalised([*seen, *own, changes]), state

    def _averaged(self, inputs: Singles) -> Singles:
        """What the slow averages of a policy on its own are of, (N, averages)."""
        error, opening, _, speed, _ = (inputs[:, column, None] for column in self._averaged_columns)
        out = opening > 0.0
        openings = [np.maximum(opening, 0.0), np.minimum(opening, 0.0)]
        speeds = [np.where(out, speed, 0.0), np.where(out, 0.0, speed)]
        both = np.concatenate([error, *openings, *speeds], axis=1, dtype=np.float32)
        return np.tile(both, len(AVERAGING_TIMES))

    def _columns_of(self, names: tuple[str, ...]) -> Indices:
        """Columns of signals in the observation; the last command stands for the spool where it has no sensor."""
        return np.array(
            [self.layout.index(name if name in self.layout.names else "previous_command") for name in names]
        )

    def _seen(self, inputs: Singles, signals: Singles, reference: Floats) -> list[Singles]:
        """What the policy sees of the present observation and of the reference."""
        del signals
        if not self.full_preview:
            return [inputs]
        ahead = (reference[:, self._rebuilt] - reference[:, 1:2]) / PREVIEW_SCALE
        return [inputs, ahead.astype(np.float32)]

    def _normalised(self, parts: list[Singles]) -> Singles:
        inputs = np.concatenate(parts, axis=1, dtype=np.float32)
        return inputs if self.normalisation is None else self.normalisation(inputs)

    def applied(self, share: float) -> Self:
        """The same features, with a smaller correction."""
        less = copy(self)
        less.residual_scale *= share
        less.correction *= share
        return less

    def normalised(self, leader: Controller | None = None) -> Self:
        """The same features, normalised by their values on training plants under the corrected controller.

        Without one, a leader commands; without a leader, the commands are random.
        """
        spread = 0.0 if self.base is not None else 0.2
        generator, seeds = np.random.default_rng(0), self.normalising_seeds
        plain, state, memory, seen = copy(self), None, None, []
        plain.normalisation = None
        env = ServoHydraulicVectorEnv(len(seeds), self.config, autoreset_mode="SameStep", info=False)
        observation, _ = env.reset(seed=list(seeds))
        for step in range(self.config.steps):
            inputs, state = plain(observation, state, np.full(len(observation), step == 0))
            seen.append(inputs)
            command = plain.command(spread * generator.standard_normal((len(observation), 1)), state)
            if leader is not None:
                command, memory = leader.predict(observation, memory)
            observation, *_ = env.step(command)
        env.close()
        normalised = copy(self)
        normalised.normalisation = Normalisation.of(np.concatenate(seen))
        return normalised

    def command(self, output: Observation, state: FeatureState) -> Singles:
        """Command in [−1, 1] for the outputs of the policy (N, 1)."""
        bounded = np.clip(output.astype(np.float32, copy=False), -1.0, 1.0)
        if self.base is None:
            return bounded
        corrected = np.clip(state.base_command + np.float32(self.residual_scale) * bounded, -1.0, 1.0)
        return corrected.astype(np.float32)

    def describe(self) -> dict[str, Any]:
        """All data to build this object again (JSON); :mod:`~hydro_agents.learning.policy` reads them."""
        base = None
        if self.base is not None:
            base = {"kind": kind_of(self.base), "settings": self.base.gains.model_dump(mode="json")}
        return {
            "task": self.config.model_dump(mode="json"),
            "base": base,
            "residual_scale": self.residual_scale,
            "full_preview": self.full_preview,
            "see_estimates": self.see_estimates,
            "normalised": self.normalisation is not None,
            "history_signals": list(self.history),
            "history_lags": list(self.lags),
        }
