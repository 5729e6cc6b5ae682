"""The options of ``reset``: they fix parts of the next episode of some axes, and are checked before any change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.arguments import numbers, shown
from hydro_env.errors import ConfigurationError, UnknownKeyError
from hydro_env.mistakes import did_you_mean, one_of, unknown
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS, PlantParameters, from_vector, to_vector
from hydro_env.task.configuration import LEAKAGE_LIMIT, TaskConfig
from hydro_env.task.faults import FAULTS, fault_limits
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK
from hydro_env.task.record import OPTION_NAMES, Fixed
from hydro_env.task.reference_signals import FAMILIES, REFERENCE_FAMILIES, USER_FAMILY
from hydro_env.task.settings import draws_of
from hydro_env.types import Floats
from hydro_env.units import flow_from_resistance

MUST_EXCEED_ANOTHER = ("cylinder.bore_diameter", "friction.breakaway_force", "supply.pressure")
"""Parameters that must exceed another one (rod, Coulomb force, precharge): their lowest draw is critical."""

Indices = NDArray[np.int64]


def options_given(options: Any) -> dict[str, Any]:
    """A copy of the options of a reset as a dictionary.

    Raises:
        ConfigurationError: the options are not a mapping.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ConfigurationError(f"reset options: {shown(options)}: must be a mapping, of {', '.join(OPTION_NAMES)}")
    return dict(options)


class ResetOptions:
    """The parts of the next episode that the caller fixes, for each of N axes.

    Args:
        tasks: the task on each of its rigs.
        count: number of axes N.
        samples: number of samples of a reference, preview included.

    Raises:
        ConfigurationError: the randomisation can draw impossible plants, or the task's own reference is impossible.
    """

    def __init__(self, tasks: Sequence[TaskConfig], count: int, samples: int) -> None:
        self.count = count
        self._samples = samples
        self._rigs = [(to_vector(task.plant), draws_of(task)) for task in tasks]
        self._half = 0.5 * min(task.plant.cylinder.stroke for task in tasks)
        self.fixed = Fixed(
            parameters=np.full((count, len(PARAMETER_PATHS)), np.nan),
            leakage_flow_lpm=np.full(count, np.nan),
            initial_position=np.full(count, np.nan),
            rig=np.full(count, -1, dtype=np.int64),
            family=np.full(count, -1, dtype=np.int64),
            user_reference=np.zeros((1, samples)),
            faults=np.full((count, len(FAULTS)), np.nan),
        )
        self.persistent = np.zeros(count, dtype=np.bool_)
        self._check_parameters(np.full(len(PARAMETER_PATHS), np.nan), "task: randomisation")
        if tasks[0].references.user:
            row = np.asarray(tasks[0].references.user)
            self.fixed.user_reference[:] = self._checked_reference(row, "references.user")
        self._own_reference = self.fixed.user_reference[0].copy()

    def used(self, axes: Indices) -> None:
        """Release the options that do not persist, after an episode has begun on these axes."""
        passing = axes[~self.persistent[axes]]
        self.fixed.parameters[passing] = np.nan
        self.fixed.leakage_flow_lpm[passing] = np.nan
        self.fixed.initial_position[passing] = np.nan
        self.fixed.rig[passing] = -1
        self.fixed.family[passing] = -1
        self.fixed.faults[passing] = np.nan
        if len(self.fixed.user_reference) == self.count:
            self.fixed.user_reference[passing] = self._own_reference

    def set_user_reference(self, rows: Floats, axes: Indices) -> None:
        """Set the user's own references on some axes, (axes, samples) or (1, samples), m."""
        if self.count > 1 and len(self.fixed.user_reference) == 1:
            everyone = np.repeat(self.fixed.user_reference, self.count, axis=0)
            self.fixed = self.fixed._replace(user_reference=everyone)
        self.fixed.user_reference[axes] = rows

    def set(self, options: Mapping[str, Any] | None, axes: Indices) -> None:
        """Fix parts of the next episode of some axes; see ``ServoHydraulicEnv.reset``.

        Raises:
            ConfigurationError: an option is unknown, a shape is wrong, or a value is impossible; then nothing is
                changed.
        """
        options = options_given(options)
        for name in options:
            if name not in OPTION_NAMES:
                raise UnknownKeyError(f"reset options: {unknown(name, OPTION_NAMES, 'option')}")
        leak = self._leak_option(options, axes)
        position = self._position_option(options, axes)
        rig = self._rig_option(options, axes)
        parameters = self._parameter_option(options.get("parameters"), axes)
        families, user = self._reference_option(options.get("reference"), axes)
        faults = self._fault_option(options.get("faults"), axes)
        persist = options.get("persist", False)
        if not isinstance(persist, bool | np.bool_):
            raise ConfigurationError(f"reset options: persist = {shown(persist)}: must be true or false")
        self.fixed.leakage_flow_lpm[axes] = leak
        self.fixed.initial_position[axes] = position
        self.fixed.rig[axes] = rig
        self.fixed.parameters[axes] = parameters
        self.fixed.family[axes] = families
        self.fixed.faults[axes] = faults
        self.persistent[axes] = bool(persist)
        if user is not None:
            self.set_user_reference(user, axes)

    def _per_axis(self, value: Any, name: str, axes: Indices) -> Floats:
        """One number for all axes, or one per axis."""
        array = numbers(value)
        if array is None:
            raise ConfigurationError(f"reset options: {name} = {shown(value)}: must be a number")
        if array.shape == (self.count,) and self.count > 1:
            array = array[axes]
        elif array.shape not in ((), (len(axes),)):
            raise ConfigurationError(
                f"reset options: {name} has shape {array.shape}: must be one number, or one per axis ({self.count},)"
            )
        return np.broadcast_to(array, (len(axes),)).copy()

    def _leak_option(self, options: Mapping[str, Any], axes: Indices) -> Floats:
        if "leakage_resistance" in options and "leakage_flow_lpm" in options:
            raise ConfigurationError("reset options: leakage_resistance and leakage_flow_lpm exclude each other")
        if "leakage_resistance" in options:
            resistance = self._per_axis(options["leakage_resistance"], "leakage_resistance", axes)
            if not np.all(resistance > 0.0):
                raise ConfigurationError(
                    f"reset options: leakage_resistance = {resistance.min():g} Pa s/m³: must be positive"
                )
            flow = np.array([flow_from_resistance(r) for r in resistance])  # infinity gives 0
        elif "leakage_flow_lpm" in options:
            flow = self._per_axis(options["leakage_flow_lpm"], "leakage_flow_lpm", axes)
        else:
            return np.full(len(axes), np.nan)
        wrong = ~((flow >= 0.0) & (flow <= LEAKAGE_LIMIT))
        if wrong.any():
            raise ConfigurationError(
                f"reset options: leakage of {flow[wrong][0]:g} l/min at 100 bar: must be within 0 to {LEAKAGE_LIMIT:g}"
            )
        return flow

    def _position_option(self, options: Mapping[str, Any], axes: Indices) -> Floats:
        if "initial_position" not in options:
            return np.full(len(axes), np.nan)
        position = self._per_axis(options["initial_position"], "initial_position", axes)
        wrong = ~(np.abs(position) <= self._half)
        if wrong.any():
            first = position[wrong][0]
            raise ConfigurationError(
                f"reset options: initial_position = {first:g} m: must be within the stroke, ±{self._half:g} m"
            )
        return position

    def _rig_option(self, options: Mapping[str, Any], axes: Indices) -> Indices:
        if "rig" not in options:
            return np.full(len(axes), -1, dtype=np.int64)
        number = self._per_axis(options["rig"], "rig", axes)
        wrong = ~np.isin(number, np.arange(len(self._rigs)))
        if wrong.any():
            raise ConfigurationError(
                f"reset options: rig = {number[wrong][0]:g}: must be the number of a rig, 0 to {len(self._rigs) - 1}"
            )
        return number.astype(np.int64)

    def _fault_option(self, given: Any, axes: Indices) -> Floats:
        magnitudes = np.full((len(axes), len(FAULTS)), np.nan)
        if given is None:
            return magnitudes
        if not isinstance(given, Mapping):
            raise ConfigurationError('reset options: faults must be a mapping, {"valve_null_shift": 0.01}')
        for name, value in given.items():
            if name not in FAULTS:
                raise UnknownKeyError(f"reset options: {unknown(name, FAULTS, 'fault')}")
            column = self._per_axis(value, f"faults.{name}", axes)
            low, high = fault_limits(name)
            wrong = ~((column >= low) & (column <= high))
            if wrong.any():
                raise ConfigurationError(
                    f"reset options: faults.{name} = {column[wrong][0]:g}: must be within {low:g} to {high:g}"
                )
            magnitudes[:, FAULTS.index(name)] = column
        return magnitudes

    def _parameter_option(self, changes: Any, axes: Indices) -> Floats:
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
                    guess = did_you_mean(path, PARAMETER_PATHS)
                    raise ConfigurationError(f"reset options: parameters.{path} is not a parameter of the plant{guess}")
                if path in LEAKAGE_OF_THE_TASK:
                    raise ConfigurationError(
                        f"reset options: parameters.{path}: give leakage_flow_lpm or leakage_resistance instead"
                    )
                if path in MODEL_CODES:
                    if not isinstance(value, str) or value not in MODEL_CODES[path]:
                        raise ConfigurationError(
                            f"reset options: parameters.{path} = {shown(value)}: {one_of(value, MODEL_CODES[path])}"
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
        """Check that the plant is valid for the least favourable draws with these parameters fixed (if not NaN)."""
        for base, draws in self._rigs:
            vector = np.where(np.isnan(row), base, row)
            for draw in draws:
                index, times = int(draw["parameter"]), int(draw["times"])
                if not np.isnan(row[index]):
                    continue
                factor = vector[times] if times >= 0 else 1.0
                values = [factor * draw["low"], factor * draw["high"]]
                if draw["otherwise_probability"] > 0.0:
                    values.append(draw["otherwise"])
                vector[index] = min(values) if PARAMETER_PATHS[index] in MUST_EXCEED_ANOTHER else max(values)
            try:
                from_vector(vector)
            except ConfigurationError as error:
                raise ConfigurationError(f"{where}: {error}") from None

    def _reference_option(self, given: Any, axes: Indices) -> tuple[Indices, Floats | None]:
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
                if name not in FAMILIES:
                    known = f"{', '.join(FAMILIES)}{did_you_mean(name, FAMILIES)}"
                    raise ConfigurationError(
                        f"reset options: reference = {shown(name)}: must be an array in m, or of {known}"
                    )
                families[index] = REFERENCE_FAMILIES.index(name)
            return families, None
        array = numbers(given)
        if array is None:
            raise ConfigurationError("reset options: reference must be numbers in m, or the name of a family")
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
        """The reference with the length that an episode needs; its last value is repeated."""
        if values.ndim != 1 or len(values) == 0:
            raise ConfigurationError(f"{where}: must be a row of positions in m")
        wrong = ~(np.abs(values) < self._half)
        if wrong.any():
            first = int(np.argmax(wrong))
            raise ConfigurationError(
                f"{where}[{first}] = {values[first]:g} m: must be a position within the stroke, ±{self._half:g} m "
                "(unit: m)"
            )
        row = np.empty(self._samples)
        row[: len(values)] = values[: self._samples]
        row[len(values) :] = values[-1]
        return row
