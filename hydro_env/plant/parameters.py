"""Physical parameters of one servo axis: frozen groups of numbers with unit, bounds and origin.

The defaults are the rig of Table 1 of Kovari (2015). Each field gives the origin of its number:
``paper`` (printed there), ``derived`` (computed from printed figures) or ``assumed`` (published rigs of
this class; these are the ones that the environment randomises). SI units, gauge pressures.
"""

from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, cast, get_args, get_origin

import numpy as np
from pydantic import ConfigDict

from hydro_env.compiling import named_tuple
from hydro_env.errors import ConfigurationError
from hydro_env.files import Group, read_yaml, validate
from hydro_env.mistakes import refuse_unknown
from hydro_env.plant.parts.chambers import Cylinder, Fluid
from hydro_env.plant.parts.friction import Friction
from hydro_env.plant.parts.leakage import Leakage
from hydro_env.plant.parts.lines import Lines
from hydro_env.plant.parts.load import Load
from hydro_env.plant.parts.supply import Supply
from hydro_env.plant.parts.valve import SHARP, Valve
from hydro_env.plant.states import Structure
from hydro_env.types import ByName, Floats

OF_THE_TASK = ("randomisation", "sensors")  # groups in the file of a rig that belong to the task


class PlantParameters(Group):
    """All physical parameters of one axis; the default is the test rig of Kovari (2015), Table 1.

    Groups: ``cylinder``, ``valve``, ``lines``, ``fluid``, ``load``, ``friction``, ``supply``, ``leakage``. Instances
    are frozen; ``replace`` gives a changed and validated copy. A wrong value raises
    :class:`hydro_env.ConfigurationError` with one line: field, value, allowed values.

    Example:
        >>> from hydro_env import PlantParameters
        >>> rig = PlantParameters()
        >>> heavy = rig.replace(load={"mass": 80.0})
        >>> rig.load.mass, heavy.load.mass, rig.cylinder.bore_diameter
        (60.0, 80.0, 0.04)
    """

    model_config = ConfigDict(title="plant parameters")

    cylinder: Cylinder = Cylinder()
    valve: Valve = Valve()
    lines: Lines = Lines()
    fluid: Fluid = Fluid()
    load: Load = Load()
    friction: Friction = Friction()
    supply: Supply = Supply()
    leakage: Leakage = Leakage()

    @property
    def structure(self) -> Structure:
        """Which parts that an axis may lack this one has."""
        return Structure(self.lines.have_waves, self.load.tip_share > 0.0, self.valve.underlap < SHARP)

    @property
    def rigid(self) -> "PlantParameters":
        """The same axis as nameplates tell it: all of its mass at the rod, its lines as volumes."""
        if not (self.lines.have_waves or self.load.tip_share):
            return self
        return self.replace(lines={"length_a": 0.0, "length_b": 0.0}, load={"tip_share": 0.0})

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: object = "plant parameters") -> "PlantParameters":
        """Build from nested groups; absent fields keep their default.

        Raises:
            ConfigurationError: unknown key, or a value outside its bounds.
        """
        return validate(cls, values, source)

    @classmethod
    def from_yaml(cls, path: str | Path) -> "PlantParameters":
        """Read a YAML file with the same groups and fields; see ``configs/rigs``.

        The file may also hold ``randomisation`` and ``sensors``, which belong to the task (:mod:`hydro_env.task.rig`).

        Raises:
            ConfigurationError: unreadable file, unknown key, or a value outside its bounds.
        """
        return cls.from_dict({key: value for key, value in read_yaml(path).items() if key not in OF_THE_TASK}, path)

    def replace(self, **groups: Mapping[str, Any]) -> "PlantParameters":
        """Copy with some fields changed: ``parameters.replace(load={"mass": 80.0})``.

        Raises:
            ConfigurationError: unknown group or field, or a value outside its bounds.
        """
        values = self.model_dump()
        refuse_unknown("plant parameters", groups, values, "group")
        for group, fields in groups.items():
            if not isinstance(fields, Mapping):
                raise ConfigurationError(f"plant parameters: {group} = {fields!r}: must be a mapping of fields")
            values[group].update(fields)
        return self.from_dict(values)


def _fields() -> ByName:
    return {
        f"{group}.{field}": inner
        for group, info in PlantParameters.model_fields.items()
        for field, inner in cast("type[Group]", info.annotation).model_fields.items()
    }


PARAMETER_PATHS = tuple(_fields())  # group.field of every parameter, in the order of to_vector

PARAMETER_UNITS: dict[str, str] = {
    path: (info.json_schema_extra or {}).get("unit", "1") for path, info in _fields().items()
}
"""Unit of each parameter."""

MODEL_CODES = {
    path: get_args(info.annotation) for path, info in _fields().items() if get_origin(info.annotation) is Literal
}
"""Choices of each field that names a model; a parameter vector holds the index of the choice."""

PARAMETER_LIMITS: dict[str, tuple[float, float]] = {
    path: (0.0, len(MODEL_CODES[path]) - 1.0)
    if path in MODEL_CODES
    else tuple(next(getattr(bound, name) for bound in info.metadata if hasattr(bound, name)) for name in ("ge", "le"))
    for path, info in _fields().items()
}
"""Smallest and largest allowed value of each parameter, in its unit; of a field that names a model, its index."""

Physical = named_tuple("Physical", (path.replace(".", "_") for path in PARAMETER_PATHS), __name__)
"""The parameters of :class:`PlantParameters` as ``group_field``, for compiled code."""


def to_vector(parameters: PlantParameters) -> Floats:
    """All parameters as one vector of ``len(PARAMETER_PATHS)`` numbers, for compiled code."""
    values = []
    for path in PARAMETER_PATHS:
        value = attrgetter(path)(parameters)
        values.append(MODEL_CODES[path].index(value) if path in MODEL_CODES else value)
    return np.array(values, float)


def from_vector(vector: Floats) -> PlantParameters:
    """The inverse of :func:`to_vector`; validates."""
    values = dict(zip(PARAMETER_PATHS, vector.tolist(), strict=True))
    values |= {path: choices[int(values[path])] for path, choices in MODEL_CODES.items()}
    return PlantParameters.from_dict(grouped(values))


def grouped(values: Mapping[str, Any]) -> dict[str, ByName]:
    """Values by ``group.field`` as nested groups."""
    groups: dict[str, ByName] = {}
    for path, value in values.items():
        group, field = path.split(".")
        groups.setdefault(group, {})[field] = value
    return groups
