"""The simulator as a model of recorded windows: from unknowns to sensor readings and their derivatives."""

from copy import copy
from typing import Any, Self

import numpy as np

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.parameters import PARAMETER_PATHS, to_vector
from hydro_env.plant.parts.leakage import ROD_SEAL, leak_past_piston
from hydro_env.plant.states import ALL_STATES, N_ALL_STATES, N_STATES, Structure
from hydro_env.task.sensors import PRESSURE_A, PRESSURE_B, SENSORS
from hydro_env.task.settings import settings_of
from hydro_env.types import Floats, Indices
from hydro_rig.estimation.replay import RISE, Commands, Rows, replay, with_all_states
from hydro_rig.estimation.unknowns import (
    BIASES,
    COURSE,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    GAINS,
    KNOTS,
    LATENCY,
    LEAKAGE,
    NULL_DRIFT,
    RECORDED_BIASES,
    RISE_TIME,
    STARTS,
    Prior,
    Priors,
)

LONG_STEP, SHORT_STEP = 2.0, 0.05
"""Steps of the finite differences, in standard deviations along each axis of the uncertainty. Long ones work where
sticking friction makes the readings rough; short ones follow a narrow, curved valley, as at rest, to its end."""

FIRST_STEP, FIRST_START_STEP = 3e-3, 3e-4
"""Steps of the first finite differences, in standard deviations of the prior, for parameters and for start states."""

MOST_LATE = 3.0  # largest latency, and largest lead, of an unknown latency, control periods
LARGEST_CHANGE = 1e6
"""Largest change of a reading by a step, over its noise; beyond it the integration of the moved plant has diverged."""

_STATES = list(ALL_STATES)
_UNFOLLOWED = [_STATES.index("coil_current"), _STATES.index("gas_volume"), *range(N_STATES, N_ALL_STATES)]
_SUPPLY, _SETTING = _STATES.index("supply_pressure"), PARAMETER_PATHS.index("supply.pressure")
_NULL = PARAMETER_PATHS.index("valve.null_shift")
_EXTERNAL = PARAMETER_PATHS.index(EXTERNAL_RESISTANCE)


def noise_of(config: TaskConfig) -> Floats:
    """Standard deviation of each channel's white noise, (channels,): noise and steps of the acquisition.

    For exact sensors it is a millionth of their range, about the integrator's error.
    """
    on = float(config.sensors.enabled)
    return np.array(
        [max(on * np.hypot(s.noise, s.resolution / 12**0.5), 1e-6 * (s.high - s.low)) for s in config.sensors.in_order]
    )


class Model:
    """The simulator as a model of B windows with P unknowns.

    Unknowns have two scales, between which ``prior`` converts: *values* in their units, and *scaled* values, standard
    deviations from the mean of the prior.

    ``commands``: (B, T), column k acts until one latency after sample k. Known are the parameters ``physical``, (B,
    parameters) in the order of ``PARAMETER_PATHS``, the states ``start``, (B, states), as of
    :class:`~hydro_rig.estimation.replay.Rows`, and recorded supply and tank pressure, ``boundary``, (B, 2, T), Pa; NaN,
    ``None``: those of the task's plant, its supply at its setting. ``threads``: ``None`` takes one per core.

    Raises:
        ConfigurationError: a command is missing or beyond full scale.
    """

    def __init__(
        self,
        config: TaskConfig,
        priors: Priors,
        commands: Floats,
        physical: Floats | None = None,
        start: Floats | None = None,
        threads: int | None = None,
        boundary: Floats | None = None,
    ) -> None:
        self.config, self.threads, self.noise = config, threads, noise_of(config)
        command = np.array(commands, float)
        count = len(command)
        wrong = np.argwhere(~(np.abs(command) <= 1.0))
        if len(wrong):
            window, sample = wrong[0]
            raise ConfigurationError(
                f"commands: window {window}, sample {sample} = {command[window, sample]:g}: must be within -1 to 1"
            )
        unrecorded = np.full((count, 2, command.shape[1]), np.nan)
        self.commands = Commands(command, unrecorded if boundary is None else boundary)
        own = to_vector(config.plant) if physical is None else np.asarray(physical, float)
        self._physical = np.array(np.broadcast_to(own, (count, len(PARAMETER_PATHS))))
        resting = np.zeros(N_ALL_STATES)
        resting[_SUPPLY] = config.plant.supply.pressure
        resting[_UNFOLLOWED] = np.nan
        self._start = np.tile(resting, (count, 1)) if start is None else with_all_states(np.array(start))
        self._set_priors(priors)

    def _set_priors(self, priors: Priors) -> None:
        self.priors, self.names = dict(priors), tuple(priors)
        parts = [(prior.mean, prior.deviation, prior.logarithmic) for prior in priors.values()]
        columns = np.array(parts, float).reshape(-1, 3).T
        self.prior: Any = Prior(columns[0], columns[1], columns[2] != 0.0)  # of all unknowns, (P,)
        # A bias adds to the readings: its derivative needs no simulation.
        self._added = {place: BIASES.index(name) for place, name in enumerate(self.names) if name in BIASES}
        self.simulated = np.array([place for place in range(len(self.names)) if place not in self._added], np.int64)
        starts = np.array([self.names[place] in STARTS for place in self.simulated], bool)
        own = self.config.plant.structure
        self.structure = Structure(own.lines, own.tip or "load.tip_share" in priors)
        self._first_steps = np.where(starts, FIRST_START_STEP, FIRST_STEP)

    @property
    def count(self) -> int:
        """B."""
        return len(self.commands.command)

    @property
    def samples(self) -> int:
        """T."""
        return self.commands.command.shape[1]

    def part(self, windows: Indices) -> Self:
        """The same model of some of the windows."""
        other = copy(self)
        other.commands = self.commands.part(windows)
        other._physical, other._start = self._physical[windows], self._start[windows]
        return other

    def with_more(self, priors: Priors) -> Self:
        """The model of the same windows with more unknowns behind the others."""
        other = copy(self)
        other._set_priors({**self.priors, **priors})
        return other

    def readings(self, scaled: Floats, samples: int | None = None) -> Floats:
        """Readings over their noise of R rows, (R, channels, T), or of their first samples.

        ``scaled``: the unknowns of each row, (R, P): first all rows of the first window, then as many of the next.
        """
        config, period = self.config, self.config.control_period
        window = np.repeat(np.arange(self.count), len(scaled) // self.count)
        physical, start = self._physical[window], self._start[window]
        latency = np.full(len(window), config.command_latency)
        lag = np.full(len(window), settings_of(config)[0]["pressure_lag"] * period)
        bias, gain = np.zeros((len(window), len(SENSORS))), np.ones((len(window), len(SENSORS)))
        commands = self.commands.beginning(samples or self.samples)
        course = np.zeros((len(window), commands.command.shape[1]))
        offset = np.zeros((len(window), 2))
        drift = 0.0
        for name, value in zip(self.names, self.prior.value(scaled).T, strict=True):
            if name.startswith(COURSE):
                time = period * np.arange(commands.command.shape[1])
                course += value[:, None] * np.clip(time / KNOTS - int(name.removeprefix(COURSE)) + 1, 0.0, 1.0)
            elif name == LEAKAGE:
                for field, size in leak_past_piston(value, config.leakage.law).items():
                    physical[:, PARAMETER_PATHS.index(f"leakage.{field}")] = size
            elif name == EXTERNAL_LEAKAGE:
                physical[:, _EXTERNAL] = ROD_SEAL.value(value)
            elif name == LATENCY:
                reach = max(MOST_LATE * period, config.command_latency + period)
                latency = np.clip(value, -reach, reach)
            elif name == RISE_TIME:
                lag = np.maximum(value, 0.0) / RISE
            elif name == NULL_DRIFT:
                drift = value
            for names, values in (
                (BIASES, bias),
                (GAINS, gain),
                (STARTS, start),
                (PARAMETER_PATHS, physical),
                (RECORDED_BIASES, offset),
            ):
                if name in names:
                    values[:, names.index(name)] = value
        physical[:, _NULL] += drift
        if config.plant.supply.model == "constant" and "start.supply_pressure" not in self.names:
            start[:, _SUPPLY] = physical[:, _SETTING]  # a constant supply stays there
        rows = Rows(window, physical, start, latency, lag, course, offset)
        read = replay(config, commands, rows, self.threads, self.structure)
        if config.sensors.differential_pressure:
            read[:, PRESSURE_A] -= read[:, PRESSURE_B]
        read *= (gain / self.noise)[:, :, None]
        read += (bias / self.noise)[:, :, None]
        return read

    def linearise(
        self, scaled: Floats, directions: Floats | None = None, samples: int | None = None, central: bool = False
    ) -> tuple[Floats, Floats]:
        """Readings (B, channels, T) and their derivatives (B, P, channels, T), both over the noise of each channel.

        The derivatives are finite differences at unknowns (B, P), all plants in one batch, per standard deviation of
        each unknown's prior; their steps are ``directions`` (:meth:`directions`), or small ones. ``central`` steps go
        to both sides: a long forward step measures the slope beside the point, so that a search with it ends beside the
        minimum of a curved valley.
        """
        if directions is None:
            directions = np.tile(np.diag(self._first_steps), (len(scaled), 1, 1))
        count, unknowns = scaled.shape
        moved = len(self.simulated)
        steps = directions.transpose(0, 2, 1)
        if central:
            steps = np.concatenate([steps, -steps], axis=1)
        rows = np.repeat(scaled[:, None], steps.shape[1] + 1, axis=1)
        rows[:, 1:, self.simulated] += steps
        read = self.readings(rows.reshape(-1, unknowns), samples).reshape(count, rows.shape[1], len(SENSORS), -1)
        with np.errstate(invalid="ignore", over="ignore"):
            other, share = (read[:, moved + 1 :], 0.5) if central else (read[:, :1], 1.0)
            moves = share * (read[:, 1 : moved + 1] - other)
        # No derivative where one of the plants of the difference failed.
        moves = np.nan_to_num(moves, posinf=0.0, neginf=0.0)
        moves[np.abs(moves).max(axis=(2, 3)) > LARGEST_CHANGE] = 0.0
        back = np.linalg.inv(directions).transpose(0, 2, 1)
        jacobian = np.zeros((count, unknowns, len(SENSORS), read.shape[-1]))
        jacobian[:, self.simulated] = (back @ moves.reshape(count, moved, -1)).reshape(moves.shape)
        for place, channel in self._added.items():
            jacobian[:, place, channel] = self.prior.deviation[place] / self.noise[channel]
        return read[:, 0], jacobian

    def directions(self, precision: Floats, length: float) -> Floats:
        """Steps (B, S, S), one per column, along the axes of the uncertainty with this precision (B, P, P).

        Each step is ``length`` standard deviations long. It changes the readings by about their noise: far more than
        the integrator's error, but within the region of probable values. Steps along single unknowns would leave that
        region, because some unknowns compensate each other.
        """
        values, vectors = np.linalg.eigh(precision[:, self.simulated[:, None], self.simulated])
        return vectors * (length / np.sqrt(np.clip(values, 1e-12, 1e12)))[:, None]  # beyond: rounding alone
