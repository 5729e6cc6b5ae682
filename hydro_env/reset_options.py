"""The options of ``reset``: they fix parts of the next episode of some axes, and are checked before any change."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydro_env.arguments import numbers, shown
from hydro_env.errors import ConfigurationError, at
from hydro_env.mistakes import did_you_mean, one_of, refuse_unknown
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS, PlantParameters, from_vector, to_vector
from hydro_env.task.configuration import LEAKAGE_LIMIT, TaskConfig
from hydro_env.task.faults import FAULTS, fault_limits
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK
from hydro_env.task.record import OPTION_NAMES, Fixed
from hydro_env.task.reference_signals import FAMILIES, REFERENCE_FAMILIES, USER_FAMILY
from hydro_env.task.settings import draws_of
from hydro_env.types import Array, Arrays, ByName, Floats, Indices

MUST_EXCEED_ANOTHER = ("cylinder.bore_diameter", "friction.breakaway_force", "supply.pressure")
"""Parameters that must exceed another one (rod, Coulomb force, precharge): their lowest draw is critical."""


def options_given(options: Any) -> ByName:
    """A copy of the options of a reset as a dictionary.

    Raises:
        ConfigurationError: the options are not a mapping, or one of them is unknown.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ConfigurationError(f"reset options: {shown(options)}: must be a mapping, of {', '.join(OPTION_NAMES)}")
    refuse_unknown("reset options", options, OPTION_NAMES, "option")
    return dict(options)


def _wrong(message: str) -> ConfigurationError:
    return ConfigurationError(f"reset options: {message}")


def _of_axes(values: Array, axes: Indices) -> Array:
    """The rows of these axes; there may be one for each of them, or one for all."""
    return values[axes] if len(values) > len(axes) else values


class ResetOptions:
    """The parts of the next episode that the caller fixes, for each of ``count`` axes, on the task on each of its rigs.

    A reference has so many ``samples``, preview included.

    Raises:
        ConfigurationError: the randomisation can draw impossible plants, or the task's own reference is impossible.
    """

    def __init__(self, tasks: Sequence[TaskConfig], count: int, samples: int) -> None:
        self.count = count
        self._rigs = [(to_vector(task.plant), draws_of(task), task.plant.structure) for task in tasks]
        self._half_strokes = 0.5 * np.array([task.plant.cylinder.stroke for task in tasks])
        self.fixed = Fixed(
            parameters=np.full((count, len(PARAMETER_PATHS)), np.nan),
            leakage_flow_lpm=np.full(count, np.nan),
            initial_position=np.full(count, np.nan),
            rig=np.full(count, -1),
            family=np.full(count, -1),
            user_reference=np.zeros((count, samples)),
            faults=np.full((count, len(FAULTS)), np.nan),
        )
        self._check_parameters(self.fixed.parameters[0], "task: randomisation")
        self._of_task = None
        if tasks[0].references.user:
            own = np.asarray(tasks[0].references.user)
            self._of_task = self._checked_reference(own, "references.user", self._half_strokes.min())
            self.fixed.user_reference[:] = self._of_task

    def fix(self, values: ByName, axes: Indices) -> None:
        """Set these fields of :class:`Fixed` on some axes; all others are drawn."""
        for name, fixed in self.fixed._asdict().items():
            drawn: Any = -1 if fixed.dtype == np.int64 else np.nan
            if name == "user_reference":  # read only if the family says so
                drawn = self._of_task
            value = values.get(name, drawn)
            if value is not None:
                fixed[axes] = value

    def set(self, options: ByName | list[Any] | None, axes: Indices) -> None:
        """Fix parts of the next episode of some axes; see ``ServoHydraulicEnv.reset``. A list has one entry per axis.

        Raises:
            ConfigurationError: an option is unknown, a shape is wrong, or a value is impossible; then nothing is
                changed.
        """
        if isinstance(options, list):
            if len(options) != len(axes):
                raise _wrong(f"{len(options)} entries for {len(axes)} axes")
            for axis, own in zip(axes, options, strict=True):
                self.set(options_given(own), np.array([axis]))
            return
        given = {name: value for name, value in options_given(options).items() if value is not None}
        values = {}
        half = self._half_strokes.min()
        if "rig" in given:
            values["rig"] = self._per_axis(given["rig"], "rig", axes, 0, len(self._rigs) - 1)
            if (values["rig"] % 1.0 != 0.0).any():
                raise _wrong(f"rig = {shown(given['rig'])}: must be whole numbers")
            half = self._half_strokes[values["rig"].astype(np.int64)].min()
        bounds = {"initial_position": (-half, half, "m"), "leakage_flow_lpm": (0.0, LEAKAGE_LIMIT, "l/min at 100 bar")}
        for name in given.keys() & bounds.keys():
            values[name] = self._per_axis(given[name], name, axes, *bounds[name])
        if "faults" in given:
            values["faults"] = self._faults(given["faults"], axes)
        if "parameters" in given:
            values["parameters"] = self._parameters(given["parameters"], axes)
        if "reference" in given:
            values |= self._reference(given["reference"], axes, half)
        self.fix(values, axes)

    def _per_axis(
        self, value: Any, name: str, axes: Indices, low: float = -np.inf, high: float = np.inf, unit: str = ""
    ) -> Floats:
        """One number for all axes, or one per axis, within bounds."""
        array = numbers(value)
        if array is None:
            raise _wrong(f"{name} = {shown(value)}: must be a number")
        if array.shape not in ((), (self.count,), (len(axes),)):
            raise _wrong(f"{name} has shape {array.shape}: must be one number, or one per axis ({self.count},)")
        array = np.broadcast_to(_of_axes(np.atleast_1d(array), axes), len(axes))
        wrong = ~((array >= low) & (array <= high))
        if wrong.any():
            allowed = "a number" if low == -np.inf else f"within {low:g} to {high:g}"
            raise _wrong(f"{name} = {array[wrong][0]:g}{unit and ' '}{unit}: must be {allowed}")
        return array

    def _faults(self, given: Any, axes: Indices) -> Floats:
        if not isinstance(given, Mapping):
            raise _wrong('faults must be a mapping, {"valve_null_shift": 0.01}')
        magnitudes = np.full((len(axes), len(FAULTS)), np.nan)
        refuse_unknown("reset options", given, FAULTS, "fault")
        for name, value in given.items():
            magnitudes[:, FAULTS.index(name)] = self._per_axis(value, f"faults.{name}", axes, *fault_limits(name))
        return magnitudes

    def _parameters(self, changes: Any, axes: Indices) -> Floats:
        if isinstance(changes, PlantParameters):
            changes = changes.model_dump()
            changes["leakage"] = {"external_resistance": changes["leakage"]["external_resistance"]}
        if not isinstance(changes, Mapping) or not all(isinstance(fields, Mapping) for fields in changes.values()):
            raise _wrong("parameters must be groups of fields, {'load': {'mass': 80.0}}")
        override = np.full((len(axes), len(PARAMETER_PATHS)), np.nan)
        for group, fields in changes.items():
            for name, value in fields.items():
                path = f"{group}.{name}"
                if path not in PARAMETER_PATHS:
                    guess = did_you_mean(path, PARAMETER_PATHS)
                    raise _wrong(f"parameters.{path} is not a parameter of the plant{guess}")
                if path in LEAKAGE_OF_THE_TASK:
                    raise _wrong(f"parameters.{path}: give leakage_flow_lpm instead")
                if path in MODEL_CODES:
                    if value not in MODEL_CODES[path]:
                        raise _wrong(f"parameters.{path} = {shown(value)}: {one_of(value, MODEL_CODES[path])}")
                    value = MODEL_CODES[path].index(value)
                override[:, PARAMETER_PATHS.index(path)] = self._per_axis(value, f"parameters.{path}", axes)
        for row in {row.tobytes(): row for row in override}.values():
            self._check_parameters(row, "reset options")
        return override

    def _check_parameters(self, row: Floats, where: str) -> None:
        """Check that the plant is valid for the least favourable draws with these parameters fixed (if not NaN)."""
        for base, draws, own in self._rigs:
            vector = np.where(np.isnan(row), base, row)
            for draw in draws:
                index, times = draw["parameter"], draw["times"]
                if not np.isnan(row[index]):
                    continue
                factor = vector[times] if times >= 0 else 1.0
                values = [factor * draw["low"], factor * draw["high"]]
                if draw["otherwise_probability"] > 0.0:
                    values.append(draw["otherwise"])
                vector[index] = min(values) if PARAMETER_PATHS[index] in MUST_EXCEED_ANOTHER else max(values)
            with at(where):
                drawn = from_vector(vector).structure
            if (drawn.lines, drawn.tip) != (own.lines, own.tip):
                raise ConfigurationError(
                    f"{where}: lines.length_a, load.tip_share: no episode adds or removes lines with waves or a second "
                    "mass; give them in the rig"
                )

    def _reference(self, given: Any, axes: Indices, half: float) -> Arrays:
        """Family of each axis, and the rows of references that the user gives as numbers."""
        array = numbers(given)
        if array is None:
            names = np.atleast_1d(np.array(given, object))
            if names.shape not in ((1,), (len(axes),), (self.count,)):
                raise _wrong(f"reference has {len(names)} names for {len(axes)} axes")
            for name in names:
                if name not in FAMILIES:
                    known = f"{', '.join(FAMILIES)}{did_you_mean(name, FAMILIES)}"
                    raise _wrong(f"reference = {shown(name)}: must be an array in m, or of {known}")
            return {"family": _of_axes(np.array([REFERENCE_FAMILIES.index(name) for name in names]), axes)}
        if array.ndim == 1:
            array = array[None]  # the same for all axes
        elif array.ndim != 2 or len(array) not in (self.count, len(axes)):
            raise _wrong(f"reference has shape {array.shape}: must be (samples,) or ({self.count}, samples)")
        rows = [self._checked_reference(row, "reset options: reference", half) for row in _of_axes(array, axes)]
        return {"family": np.array(USER_FAMILY), "user_reference": np.array(rows)}

    def _checked_reference(self, values: Floats, where: str, half: float) -> Floats:
        """The reference with the length that an episode needs; its last value is repeated."""
        if not len(values):
            raise ConfigurationError(f"{where}: must be a row of positions in m")
        wrong = ~(np.abs(values) < half)
        if wrong.any():
            first, limit = np.argmax(wrong), f"±{half:g} m"
            raise ConfigurationError(
                f"{where}[{first}] = {values[first]:g} m: must be a position within the stroke, {limit} (unit: m)"
            )
        row = np.full(self.fixed.user_reference.shape[1], values[-1])
        row[: len(values)] = values[: len(row)]
        return row
