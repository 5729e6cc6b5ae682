"""Many axes at once: the episodes that both environments share.

:class:`ServoHydraulicEnv` is this with one axis, :class:`ServoHydraulicVectorEnv` with N; so they agree bit for bit.
The class holds the arrays and calls two compiled functions: one begins episodes, one advances a control period.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hydro_env.plant.errors import ConfigurationError
from hydro_env.plant import kernel as plant_kernel
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parameters import (
    MODEL_CODES,
    PARAMETER_PATHS,
    PlantParameters,
    flow_from_resistance,
    from_vector,
    to_vector,
)
from hydro_env.plant.simulate import coefficient_array, equilibrium
from hydro_env.task import kernel as task_kernel
from hydro_env.task.configuration import (
    DISTURBANCES,
    LEAKAGE_LIMIT,
    LEAKAGE_SCHEDULES,
    REFERENCE_FAMILIES,
    TaskConfig,
)
from hydro_env.task.kernel import FAILURES, Record
from hydro_env.task.reference_signals import Limits

LANES = plant_kernel.LANES
USER_FAMILY = REFERENCE_FAMILIES.index("user")
OPTION_NAMES = (
    "leakage_resistance",
    "leakage_flow_lpm",
    "reference",
    "parameters",
    "initial_position",
    "persist",
    "reset_mask",
)
MUST_EXCEED_ANOTHER = ("cylinder.bore_diameter", "friction.breakaway_force", "supply.pressure")
"""Parameters that must be larger than another one (rod, Coulomb force, precharge): impossible when drawn too low."""

LEAKAGE_OF_THE_TASK = ("leakage.internal_resistance", "leakage.orifice_gain")
"""Parameters that the group ``leakage`` of the task sets."""

AXES_PER_THREAD = 64
"""A second thread starts when each has at least this many axes to work on."""

ERROR_INTEGRAL_TIME = 0.5
"""s; time constant with which the observed integral of the error leaks."""

ERROR_INTEGRAL_LIMIT = 0.010
"""m s; where the observed integral saturates."""

Floats = NDArray[np.float64]


def settings_of(config: TaskConfig) -> Floats:
    """The numbers of a task for compiled code, in the order of ``task.kernel.Settings``."""
    period, sensors, leakage = config.control_period, config.sensors, config.leakage
    rise = sensors.pressure_rise_time / math.log(9.0)  # 10–90 % rise of a first-order lag is τ ln 9
    return np.array(
        task_kernel.Settings(
            control_period=period,
            maximum_step=config.maximum_step,
            steps=config.steps,
            healthy_share=leakage.healthy_share,
            healthy_low=leakage.healthy_range[0],
            healthy_high=leakage.healthy_range[1],
            faulty_low=leakage.faulty_range[0],
            faulty_high=leakage.faulty_range[1],
            orifice_law=float(leakage.law == "orifice"),
            schedule=LEAKAGE_SCHEDULES.index(leakage.schedule),
            leak_start_low=leakage.start_range[0],
            leak_start_high=leakage.start_range[1],
            initial_low=config.initial_position_range[0],
            initial_high=config.initial_position_range[1],
            sensors_enabled=float(sensors.enabled),
            pressure_decay=math.exp(-period / rise) if rise > 0.0 else 0.0,
            pressure_lag=rise / period,
            velocity_blend=period / (period + sensors.velocity_filter_time),
            integral_time=ERROR_INTEGRAL_TIME,
            integral_limit=ERROR_INTEGRAL_LIMIT,
            tracking_weight=config.reward.tracking,
            error_scale=config.reward.error_scale,
            error_limit=config.reward.error_limit,
            effort_weight=config.reward.effort,
            failure_weight=config.reward.failure,
            end_stop_speed=config.failure.end_stop_speed,
            pressure_rating=config.failure.pressure_rating,
            disturbance=DISTURBANCES.index(config.disturbance.kind),
            force_low=config.disturbance.force_range[0],
            force_high=config.disturbance.force_range[1],
            force_start_low=config.disturbance.start_range[0],
            force_start_high=config.disturbance.start_range[1],
            pulse_duration=config.disturbance.pulse_duration,
            force_frequency_low=config.disturbance.frequency_range[0],
            force_frequency_high=config.disturbance.frequency_range[1],
        ),
        dtype=np.float64,
    )


def observation_layout(config: TaskConfig) -> tuple[tuple[str, ...], tuple[str, ...], Floats, Floats]:
    """Names, units, scales (unit per 1 of the observation) and largest absolute values (in the observation)."""
    half = 0.5 * config.plant.cylinder.stroke
    rows = [("reference", "m", 0.1, 1.5 * half)]
    rows += [(f"reference_preview_{1e3 * t:g}ms", "m", 0.01, 2.0 * half) for t in config.references.preview_times]
    rows += [
        ("position", "m", 0.1, 1.5 * half),
        ("velocity_estimate", "m/s", 0.1, 2.0),
        ("pressure_a", "Pa", 50e5, 400e5),
        ("pressure_b", "Pa", 50e5, 400e5),
        ("spool_position", "1", 1.0, 1.0),
        ("previous_command", "1", 1.0, 1.0),
        ("tracking_error", "m", 0.01, 2.5 * half),
        ("error_integral", "m s", 0.001, ERROR_INTEGRAL_LIMIT),
    ]
    names, units, scale, largest = zip(*rows, strict=True)
    return names, units, np.array(scale), np.array(largest) / np.array(scale)


def _draw_table(config: TaskConfig) -> Floats:
    """One row per randomised parameter; a parameter that multiplies another comes before it."""
    pending = dict(config.randomisation)
    order: list[str] = []
    while pending:
        ready = [path for path, d in pending.items() if d.times not in pending or d.times == path]
        if not ready:
            raise ConfigurationError("task: randomisation: 'times' runs in a circle")
        order += ready
        for path in ready:
            del pending[path]
    table = np.zeros((len(order), 7))
    for row, path in enumerate(order):
        d = config.randomisation[path]
        table[row] = (
            PARAMETER_PATHS.index(path),
            d.log_uniform is not None,
            *d.bounds,
            PARAMETER_PATHS.index(d.times) if d.times else -1,
            d.otherwise if d.otherwise is not None else 0.0,
            d.otherwise_probability,
        )
    return table


class Axes:
    """N servo axes in episodes. Arrays are public for reading; ``record`` columns are named by ``Record``.

    Args:
        config: the task.
        count: number of axes N.
        threads: worker threads of a step; ``None`` takes as many as there are cores, where there are axes enough.

    Raises:
        ConfigurationError: the task is impossible.
    """

    def __init__(self, config: TaskConfig, count: int, threads: int | None = None) -> None:
        self.config = config
        self.count = count
        self.blocks = -(-count // LANES)
        self.observation_names, self.observation_units, self.scale, self.limit = observation_layout(config)
        self.observation_space = spaces.Box(-self.limit.astype(np.float32), self.limit.astype(np.float32))
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

        self._settings = settings_of(config)
        references = config.references
        self._limits = np.array(
            Limits(
                references.range_share,
                references.largest_amplitude,
                references.speed_share,
                references.acceleration_limit,
                *references.frequency_range,
                *references.step_range,
            )
        )
        sensors = config.sensors
        channels = (sensors.position, sensors.pressure_a, sensors.pressure_b, sensors.spool_position)
        self._sensors = np.array([(s.noise, s.bias, s.resolution, s.low, s.high) for s in channels])
        self._preview = np.array(config.preview_samples, dtype=np.int64)
        self._durations = np.array([config.command_latency, config.control_period - config.command_latency])
        self._base = to_vector(config.plant)
        self._draws = _draw_table(config)
        self._check_parameters(np.full(len(PARAMETER_PATHS), np.nan), "task: randomisation")
        weights = np.array([references.weights.get(name, 0.0) for name in REFERENCE_FAMILIES])
        self._family_weights = weights / weights.sum()

        samples = config.steps + 1 + max(config.preview_samples, default=0)
        self._samples = samples
        self.state = np.ones((self.blocks, plant_kernel.N_STATES, LANES))
        self.coefficient = np.ones((self.blocks, plant_kernel.N_COEFFICIENTS, LANES))
        self._voltage = np.zeros((self.blocks, 2, LANES))
        self._peaks = np.zeros((self.blocks, plant_kernel.N_PEAKS, LANES))
        self.physical = np.zeros((count, len(PARAMETER_PATHS)))
        self.record = np.zeros((count, len(Record._fields)))
        self.reference = np.zeros((count, samples))
        self._noise_key = np.zeros(count, dtype=np.uint64)
        self._roots = np.zeros(count, dtype=np.uint64)
        self._episodes = np.full(count, -1, dtype=np.int64)

        self._parameter_override = np.full((count, len(PARAMETER_PATHS)), np.nan)
        self._leak_override = np.full(count, np.nan)
        self._position_override = np.full(count, np.nan)
        self._family_override = np.full(count, -1, dtype=np.int64)
        self._persistent = np.zeros(count, dtype=np.bool_)
        self._user_reference = np.zeros((1, samples))
        if references.user:
            self._user_reference = self._checked_reference(np.asarray(references.user), "references.user")[None]

        wanted = threads if threads is not None else (os.cpu_count() or 1)
        self._threads = max(1, min(wanted, count // AXES_PER_THREAD))
        self._pool: ThreadPoolExecutor | None = None
        self._fill_spare_lanes()

    def _fill_spare_lanes(self) -> None:
        """Lanes that hold no axis run along on a plant at rest, the default one, which surely has such a state."""
        state, _ = equilibrium(PlantParameters(), 0.0)
        self.state[-1] = np.array(list(state.values()))[:, None]
        self.coefficient[-1] = coefficient_array(PlantParameters())[:, None]

    # Randomness -----------------------------------------------------------------------------------------------------

    def seed(self, axis: int, generator: np.random.Generator) -> None:
        """Give an axis its root of randomness from its generator; its episodes count from 0 again."""
        self._roots[axis] = generator.integers(0, 2**64, dtype=np.uint64)
        self._episodes[axis] = -1

    # Episodes -------------------------------------------------------------------------------------------------------

    def begin(self, axes: NDArray[np.int64], observation: NDArray[np.float32]) -> None:
        """Begin new episodes on some axes; their rows of ``observation`` (N, n) are written.

        Raises:
            ConfigurationError: an initial position cannot be held by its plant.
        """
        self._episodes[axes] += 1
        task_kernel.begin_episodes(
            axes,
            self._settings,
            self._limits,
            self._sensors,
            self._preview,
            self.scale,
            self.limit,
            self._base,
            self._draws,
            self._family_weights,
            self._roots,
            self._episodes,
            self._parameter_override,
            self._leak_override,
            self._position_override,
            self._family_override,
            self._user_reference,
            self.state,
            self.coefficient,
            self.physical,
            self.record,
            self.reference,
            self._noise_key,
            observation,
        )
        self._check_begun(axes)
        passing = axes[~self._persistent[axes]]
        self._parameter_override[passing] = np.nan
        self._leak_override[passing] = np.nan
        self._position_override[passing] = np.nan
        self._family_override[passing] = -1

    def _check_begun(self, axes: NDArray[np.int64]) -> None:
        failed = axes[self.column("failure")[axes] != 0.0]
        if len(failed):
            axis = int(failed[0])
            physical = dict(zip(PARAMETER_PATHS, self.physical[axis], strict=True))
            start = 1e3 * self.state[axis // LANES, 0, axis % LANES]
            what = (
                f"initial position {start:.4g} mm cannot be held"
                if self.column("failure")[axis] == task_kernel.CANNOT_BE_HELD
                else f"reference up to {1e3 * np.abs(self.reference[axis]).max():.4g} mm cannot be reached"
            )
            raise ConfigurationError(
                f"axis {axis}: {what} by its plant (supply {physical['supply.pressure'] / 1e5:.3g} bar, spring "
                f"{physical['load.spring_stiffness']:.4g} N/m, external force {physical['load.external_force']:.4g} N, "
                f"leakage {self.column('leak_flow')[axis]:.3g} l/min at 100 bar)"
            )

    def step(
        self,
        actions: NDArray[Any],
        observation: NDArray[np.float32],
        reward: Floats,
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> None:
        """Advance every axis by one control period; the four arrays, (N, n) and (N,), are written."""
        if self._threads == 1:
            self._step_blocks(actions, observation, reward, terminated, truncated, 0, self.blocks)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1, thread_name_prefix="hydro_env")
        bounds = [self.blocks * part // self._threads for part in range(self._threads + 1)]
        waiting = [
            self._pool.submit(self._step_blocks, actions, observation, reward, terminated, truncated, first, last)
            for first, last in zip(bounds[1:-1], bounds[2:], strict=True)
        ]
        self._step_blocks(actions, observation, reward, terminated, truncated, bounds[0], bounds[1])
        for future in waiting:
            future.result()

    def _step_blocks(self, actions: Any, observation: Any, reward: Any, ended: Any, cut: Any, a: int, b: int) -> None:
        task_kernel.step_axes(
            self._settings,
            self._sensors,
            self._preview,
            self.scale,
            self.limit,
            self._durations,
            self.state,
            self.coefficient,
            self._voltage,
            self._peaks,
            self.physical,
            self.record,
            self.reference,
            self._noise_key,
            actions,
            observation,
            reward,
            ended,
            cut,
            a,
            b,
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}  # threads cannot be copied; they start again when needed

    def close(self) -> None:
        """Stop the worker threads; may be called more than once."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    # What the judge sees --------------------------------------------------------------------------------------------

    def column(self, name: str) -> Floats:
        """A view of one column of ``record``, shape (N,)."""
        return self.record[:, Record._fields.index(name)]

    def leakage_class(self, flow_lpm: Floats) -> NDArray[np.int64]:
        """Class label (index into LEAKAGE_CLASSES) of leaks in l/min at 100 bar."""
        return np.searchsorted(np.array(self.config.leakage.class_bounds) * (1 + 1e-9), flow_lpm)

    def parameters(self, axis: int) -> PlantParameters:
        """The physical parameters of an axis in its present episode, leakage included."""
        vector = self.physical[axis].copy()
        block, lane = axis // LANES, axis % LANES
        names = Coefficients._fields
        conductance = self.coefficient[block, names.index("leakage_conductance"), lane]
        vector[PARAMETER_PATHS.index("leakage.internal_resistance")] = (
            1.0 / conductance if conductance > 0.0 else np.inf
        )
        orifice = self.coefficient[block, names.index("leakage_orifice_gain"), lane]
        vector[PARAMETER_PATHS.index("leakage.orifice_gain")] = orifice
        return from_vector(vector)

    def external_force(self, axis: int) -> float:
        """External force in N that acts on an axis now, disturbance included."""
        row = Coefficients._fields.index("external_force")
        return float(self.coefficient[axis // LANES, row, axis % LANES])

    # Options of reset -----------------------------------------------------------------------------------------------

    def set_options(self, options: Mapping[str, Any] | None, axes: NDArray[np.int64]) -> None:
        """Fix parts of the next episode of some axes; see ``ServoHydraulicEnv.reset``.

        Raises:
            ConfigurationError: unknown option, wrong shape, or an impossible value; nothing is changed then.
        """
        options = dict(options or {})
        for name in options:
            if name not in OPTION_NAMES:
                raise ConfigurationError(f"reset options: unknown option '{name}'; known: {', '.join(OPTION_NAMES)}")
        leak = self._leak_option(options, axes)
        position = self._position_option(options, axes)
        parameters = self._parameter_option(options.get("parameters"), axes)
        families, user = self._reference_option(options.get("reference"), axes)
        persist = options.get("persist", False)
        if not isinstance(persist, bool | np.bool_):
            raise ConfigurationError(f"reset options: persist = {persist!r}: must be true or false")
        self._leak_override[axes] = leak
        self._position_override[axes] = position
        self._parameter_override[axes] = parameters
        self._family_override[axes] = families
        self._persistent[axes] = bool(persist)
        if user is not None:
            if self.count > 1 and len(self._user_reference) == 1:
                self._user_reference = np.repeat(self._user_reference, self.count, axis=0)
            self._user_reference[axes] = user

    def _per_axis(self, value: Any, name: str, axes: NDArray[np.int64]) -> Floats:
        """A number for all axes, or one for each."""
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ConfigurationError(f"reset options: {name} = {value!r}: must be a number") from None
        if array.shape == (self.count,) and self.count > 1:
            array = array[axes]
        elif array.shape not in ((), (len(axes),)):
            raise ConfigurationError(
                f"reset options: {name} has shape {array.shape}: must be one number, or one per axis ({self.count},)"
            )
        return np.broadcast_to(array, (len(axes),)).copy()

    def _leak_option(self, options: Mapping[str, Any], axes: NDArray[np.int64]) -> Floats:
        if "leakage_resistance" in options and "leakage_flow_lpm" in options:
            raise ConfigurationError("reset options: leakage_resistance and leakage_flow_lpm say the same; give one")
        if "leakage_resistance" in options:
            resistance = self._per_axis(options["leakage_resistance"], "leakage_resistance", axes)
            if not np.all(resistance > 0.0):
                raise ConfigurationError(
                    f"reset options: leakage_resistance = {resistance.min():g} Pa s/m³: must be positive"
                )
            flow = np.array([flow_from_resistance(r) for r in resistance])
        elif "leakage_flow_lpm" in options:
            flow = self._per_axis(options["leakage_flow_lpm"], "leakage_flow_lpm", axes)
        else:
            return np.full(len(axes), np.nan)
        wrong = ~((flow >= 0.0) & (flow <= LEAKAGE_LIMIT))
        if wrong.any():
            raise ConfigurationError(
                f"reset options: leakage of {flow[wrong][0]:g} l/min at 100 bar: must be within 0 to {LEAKAGE_LIMIT:g}"
            )
        lowest: Floats = np.maximum(flow, 1e-9)
        return lowest

    def _position_option(self, options: Mapping[str, Any], axes: NDArray[np.int64]) -> Floats:
        if "initial_position" not in options:
            return np.full(len(axes), np.nan)
        position = self._per_axis(options["initial_position"], "initial_position", axes)
        half = 0.5 * self.config.plant.cylinder.stroke
        wrong = ~(np.abs(position) <= half)
        if wrong.any():
            raise ConfigurationError(
                f"reset options: initial_position = {position[wrong][0]:g} m: must be within the stroke, ±{half:g} m"
            )
        return position

    def _parameter_option(self, changes: Any, axes: NDArray[np.int64]) -> Floats:
        override = np.full((len(axes), len(PARAMETER_PATHS)), np.nan)
        if changes is None:
            return override
        if isinstance(changes, PlantParameters):
            changes = changes.model_dump()
            changes["leakage"] = {"external_resistance": changes["leakage"]["external_resistance"]}
        if not isinstance(changes, Mapping):
            raise ConfigurationError("reset options: parameters must be groups of fields, {'load': {'mass': 80.0}}")
        checked: dict[tuple[Any, ...], None] = {}
        for group, fields in changes.items():
            if not isinstance(fields, Mapping):
                raise ConfigurationError(f"reset options: parameters.{group} must be a mapping of fields")
            for field, value in fields.items():
                path = f"{group}.{field}"
                if path not in PARAMETER_PATHS:
                    raise ConfigurationError(f"reset options: parameters.{path} is no parameter of the plant")
                if path in LEAKAGE_OF_THE_TASK:
                    raise ConfigurationError(
                        f"reset options: parameters.{path}: give leakage_flow_lpm or leakage_resistance instead"
                    )
                if path in MODEL_CODES:
                    if not isinstance(value, str) or value not in MODEL_CODES[path]:
                        raise ConfigurationError(
                            f"reset options: parameters.{path} = {value!r}: must be one of {', '.join(MODEL_CODES[path])}"
                        )
                    value = float(MODEL_CODES[path].index(value))
                column = PARAMETER_PATHS.index(path)
                override[:, column] = self._per_axis(value, f"parameters.{path}", axes)
                if np.isnan(override[:, column]).any():
                    raise ConfigurationError(f"reset options: parameters.{path} = nan: must be a number")
        for row in override:
            key = tuple(row[~np.isnan(row)])
            if key not in checked:
                checked[key] = None
                self._check_parameters(row, "reset options")
        return override

    def _check_parameters(self, row: Floats, where: str) -> None:
        """With these parameters fixed (not NaN), the plant must be possible for the least favourable draws."""
        vector = np.where(np.isnan(row), self._base, row)
        for draw in self._draws:
            index, times = int(draw[task_kernel.DRAW_INDEX]), int(draw[task_kernel.DRAW_TIMES])
            if not np.isnan(row[index]):
                continue
            factor = vector[times] if times >= 0 else 1.0
            values = [factor * draw[task_kernel.DRAW_LOW], factor * draw[task_kernel.DRAW_HIGH]]
            if draw[task_kernel.DRAW_PROBABILITY] > 0.0:
                values.append(draw[task_kernel.DRAW_OTHERWISE])
            vector[index] = min(values) if PARAMETER_PATHS[index] in MUST_EXCEED_ANOTHER else max(values)
        try:
            from_vector(vector)
        except ConfigurationError as error:
            raise ConfigurationError(f"{where}: {error}") from None

    def _reference_option(self, given: Any, axes: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats | None]:
        families = np.full(len(axes), -1, dtype=np.int64)
        if given is None:
            return families, None
        names: Sequence[Any] | None = None
        if isinstance(given, str):
            names = [given] * len(axes)
        elif isinstance(given, list | tuple) and given and all(isinstance(name, str) for name in given):
            names = [given[axis] for axis in axes] if len(given) == self.count else list(given)
        if names is not None:
            if len(names) != len(axes):
                raise ConfigurationError(f"reset options: reference has {len(names)} names for {len(axes)} axes")
            for index, name in enumerate(names):
                if name not in REFERENCE_FAMILIES[:USER_FAMILY]:
                    known = ", ".join(REFERENCE_FAMILIES[:USER_FAMILY])
                    raise ConfigurationError(
                        f"reset options: reference = {name!r}: must be an array in m, or of {known}"
                    )
                families[index] = REFERENCE_FAMILIES.index(name)
            return families, None
        try:
            array = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise ConfigurationError("reset options: reference must be numbers in m, or the name of a family") from None
        if array.ndim == 1:
            rows = np.repeat(self._checked_reference(array, "reset options: reference")[None], len(axes), axis=0)
        elif array.ndim == 2 and len(array) in (self.count, len(axes)):
            chosen = array[axes] if len(array) == self.count else array
            rows = np.array([self._checked_reference(row, "reset options: reference") for row in chosen])
        else:
            raise ConfigurationError(
                f"reset options: reference has shape {array.shape}: must be (samples,) or ({self.count}, samples)"
            )
        families[:] = USER_FAMILY
        return families, rows

    def _checked_reference(self, values: Floats, where: str) -> Floats:
        """One row of the length that an episode needs, held at its end."""
        if values.ndim != 1 or len(values) == 0:
            raise ConfigurationError(f"{where}: must be a row of positions in m")
        half = 0.5 * self.config.plant.cylinder.stroke
        wrong = ~(np.abs(values) < half)
        if wrong.any():
            first = int(np.argmax(wrong))
            raise ConfigurationError(
                f"{where}[{first}] = {values[first]:g} m: must be a position within the stroke, ±{half:g} m (unit: m)"
            )
        row = np.empty(self._samples)
        row[: len(values)] = values[: self._samples]
        row[len(values) :] = values[-1]
        return row


def failure_name(code: float) -> str:
    """What ended an episode, in words."""
    return FAILURES[int(code)]
