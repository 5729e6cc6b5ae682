"""Physical parameters of one servo axis: frozen groups of numbers with unit, bounds and origin.

The defaults are the rig of Table 1 of Kovari (2015). Each field says where its number comes from:
``paper`` (printed there), ``derived`` (computed from printed figures) or ``assumed`` (published rigs of
this class; these are the ones that the environment randomises). SI units, gauge pressures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator

from hydro_env.errors import ConfigurationError
from hydro_env.files import Group, read_yaml, validate, write_yaml


def _no_truth_value(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not true/false")
    return value


def _no_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError("must be a number, not NaN")
    return value


Number = Annotated[float, BeforeValidator(_no_truth_value), AfterValidator(_no_nan)]


def quantity(default: float, unit: str, origin: str, low: float, high: float, *, above: bool = False) -> Any:
    """A numeric field with its unit, its origin and the range outside of which it must be a mistake."""
    bounds: dict[str, Any] = {"gt" if above else "ge": low, "le": high}
    return Field(default, description=origin, json_schema_extra={"unit": unit}, **bounds)


class Cylinder(Group):
    """Cylinder; chamber a is the bore side, chamber b the rod side.

    A second rod through chamber a (``rod_diameter_a``) makes a double-rod cylinder, symmetric if both are equal.
    """

    bore_diameter: Number = quantity(0.040, "m", "paper, Table 1", 0.005, 1.0)
    rod_diameter: Number = quantity(0.028, "m", "paper, Table 1", 0.0, 0.95)
    rod_diameter_a: Number = quantity(0.0, "m", "paper, Table 1: no rod through chamber a", 0.0, 0.95)
    stroke: Number = quantity(0.400, "m", "paper, Table 1", 0.01, 10.0)
    dead_volume: Number = quantity(30e-6, "m³", "assumed; oil on each side at the stroke's end", 1e-7, 0.1)
    piston_mass: Number = quantity(3.0, "kg", "assumed; piston and rod", 0.0, 1e4)
    end_stop_stiffness: Number = quantity(1e7, "N/m", "assumed", 1e4, 1e10)
    end_stop_damping: Number = quantity(1e4, "N s/m", "assumed", 0.0, 1e7)

    @model_validator(mode="after")
    def _rod_fits_in_bore(self) -> Cylinder:
        for name in ("rod_diameter", "rod_diameter_a"):
            if getattr(self, name) >= self.bore_diameter:
                raise ValueError(
                    f"{name} = {getattr(self, name):g} m does not fit: it must be smaller than "
                    f"bore_diameter = {self.bore_diameter:g} m"
                )
        return self


class Valve(Group):
    """4/3 servo valve with its drive: flow edges, second-order spool, coil.

    ``model`` says how much of it moves in its own time: ``drive`` (coil and spool), ``spool`` (an ideal drive: the
    current follows the command at once), ``ideal`` (the spool does).
    """

    model: Literal["drive", "spool", "ideal"] = Field("drive", description="paper, eqs (1) and (18)")
    rated_flow: Number = quantity(10e-3 / 60, "m³/s", "paper, Table 1 (10 l/min)", 1e-7, 0.1)
    rated_pressure_drop: Number = quantity(70e5, "Pa", "paper, Table 1; over both edges", 1e4, 1e8)
    natural_frequency: Number = quantity(500.0, "rad/s", "assumed (80 Hz)", 1.0, 1e4)
    damping_ratio: Number = quantity(0.8, "1", "assumed", 0.05, 5.0)
    slew_limit: Number = quantity(100.0, "1/s", "assumed; full stroke in 10 ms", 0.1, 1e5)
    underlap: Number = quantity(0.015, "1", "assumed; of full spool stroke, 0 = zero-lapped", 0.0, 0.5)
    coil_resistance: Number = quantity(2.5, "Ω", "assumed", 1e-3, 1e5)
    coil_inductance: Number = quantity(2.5e-3, "H", "assumed; with the drive's current loop", 1e-6, 100.0)
    amplifier_gain: Number = quantity(0.625, "V/V", "assumed", 1e-6, 1e6)
    spool_gain: Number = quantity(0.4, "1/A", "assumed; with the two above: full stroke at 10 V", 1e-6, 1e6)
    transition_pressure: Number = quantity(1e5, "Pa", "assumed; laminar to turbulent flow", 1.0, 1e7)


class Fluid(Group):
    """Hydraulic oil."""

    density: Number = quantity(872.0, "kg/m³", "paper, Table 1", 500.0, 2000.0)
    bulk_modulus: Number = quantity(1.4e9, "Pa", "paper, section 3 (printed there in N/m)", 1e7, 1e10)
    air_fraction: Number = quantity(0.005, "1", "assumed; free air at atmospheric pressure", 0.0, 0.2)


class Load(Group):
    """Mass, spring and damper that the rod moves."""

    mass: Number = quantity(60.0, "kg", "paper, Table 1", 0.01, 1e6)
    spring_stiffness: Number = quantity(89e3, "N/m", "paper, Table 1 (89 N/mm)", 0.0, 1e9)
    viscous_damping: Number = quantity(300.0, "N s/m", "assumed; load and seals", 0.0, 1e7)
    external_force: Number = quantity(0.0, "N", "assumed; positive against extension", -1e7, 1e7)


class Friction(Group):
    """Friction of seals and guides."""

    model: Literal["none", "coulomb", "stribeck", "lugre"] = Field(
        "stribeck", description="assumed; Hess & Soom (1990), Canudas de Wit et al. (1995)"
    )
    coulomb_force: Number = quantity(120.0, "N", "assumed", 0.0, 1e6)
    breakaway_force: Number = quantity(180.0, "N", "assumed", 0.0, 1e6)
    stribeck_velocity: Number = quantity(0.012, "m/s", "assumed", 1e-5, 10.0)
    transition_velocity: Number = quantity(0.0015, "m/s", "assumed; smooths the sign function", 1e-6, 1.0)
    bristle_stiffness: Number = quantity(5e6, "N/m", "assumed; lugre: seal before it slides", 1e3, 1e10)
    bristle_damping: Number = quantity(1e3, "N s/m", "assumed; lugre: of the seal's deflection", 0.0, 1e7)

    @model_validator(mode="after")
    def _breakaway_is_the_peak(self) -> Friction:
        if self.model == "lugre" and self.coulomb_force <= 0.0:
            raise ValueError("coulomb_force = 0 N must be above 0 with model lugre; model none is without friction")
        if self.model in ("stribeck", "lugre") and self.breakaway_force < self.coulomb_force:
            raise ValueError(
                f"breakaway_force = {self.breakaway_force:g} N must not be below "
                f"coulomb_force = {self.coulomb_force:g} N"
            )
        return self


class Supply(Group):
    """Pump, relief valve and accumulator (``accumulator``), the same without it (``pump``), or a constant pressure.

    ``pump_flow`` 0 is a pump that stands still, ``relief_slope`` 0 a circuit without relief valve.
    """

    model: Literal["constant", "accumulator", "pump"] = Field("accumulator", description="paper, Figs 3 and 11")
    pressure: Number = quantity(70e5, "Pa", "assumed; constant supply, or setting of the relief valve", 1e5, 1e8)
    tank_pressure: Number = quantity(1e5, "Pa", "assumed; back pressure of the return line", 0.0, 1e7)
    pump_flow: Number = quantity(2.15e-4, "m³/s", "derived; 9.4 cm³ × 1450 1/min × 0.95", 0.0, 1.0)
    relief_slope: Number = quantity(4e-10, "m³/(s Pa)", "assumed; of the relief valve", 0.0, 1e-4)
    line_volume: Number = quantity(0.5e-3, "m³", "assumed; oil between pump and valve (model pump)", 1e-6, 1.0)
    accumulator_volume: Number = quantity(1e-3, "m³", "paper, Table 1 (1 l)", 1e-6, 10.0)
    precharge_pressure: Number = quantity(55e5, "Pa", "assumed", 1e4, 1e8)
    polytropic_index: Number = quantity(1.3, "1", "assumed", 1.0, 1.7)

    @model_validator(mode="after")
    def _supply_above_tank(self) -> Supply:
        if self.pressure <= self.tank_pressure:
            raise ValueError(f"pressure = {self.pressure:g} Pa must be above tank_pressure = {self.tank_pressure:g} Pa")
        if self.model != "constant" and self.relief_slope == 0.0 and self.pump_flow > 0.0:
            raise ValueError(
                f"relief_slope = 0 with pump_flow = {self.pump_flow:g} m³/s: nothing limits the pressure; without a "
                f"relief valve pump_flow must be 0 (a pump that stands still) or model constant"
            )
        if self.model == "accumulator" and self.precharge_pressure >= self.pressure:
            raise ValueError(
                f"precharge_pressure = {self.precharge_pressure:g} Pa must be below pressure = "
                f"{self.pressure:g} Pa, else the accumulator stays empty"
            )
        return self


class Leakage(Group):
    """Oil past the piston (internal) and past the rod seal (external)."""

    internal_resistance: Number = quantity(2e13, "Pa s/m³", "assumed; 0.03 l/min at 100 bar", 1e8, np.inf)
    external_resistance: Number = quantity(np.inf, "Pa s/m³", "assumed; tight rod seal", 1e8, np.inf)
    orifice_gain: Number = quantity(0.0, "m³/(s √Pa)", "assumed; throttle in parallel, as on the rig", 0.0, 1e-4)


class PlantParameters(Group):
    """All physical parameters of one axis; the default is the test rig of Kovari (2015), Table 1.

    Groups: ``cylinder``, ``valve``, ``fluid``, ``load``, ``friction``, ``supply``, ``leakage``. Instances are
    frozen; ``replace`` gives a changed and validated copy. A wrong value raises
    :class:`hydro_env.ConfigurationError` with one line: field, value, what is allowed.
    """

    model_config = ConfigDict(title="plant parameters")

    cylinder: Cylinder = Field(default_factory=Cylinder)
    valve: Valve = Field(default_factory=Valve)
    fluid: Fluid = Field(default_factory=Fluid)
    load: Load = Field(default_factory=Load)
    friction: Friction = Field(default_factory=Friction)
    supply: Supply = Field(default_factory=Supply)
    leakage: Leakage = Field(default_factory=Leakage)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "plant parameters") -> PlantParameters:
        """Build from nested groups; absent fields keep their default.

        Raises:
            ConfigurationError: unknown key, or a value outside its bounds.
        """
        return validate(cls, values, source)

    @classmethod
    def from_yaml(cls, path: str | Path) -> PlantParameters:
        """Read a YAML file with the same groups and fields; see ``configs/rigs``.

        Raises:
            ConfigurationError: unreadable file, unknown key, or a value outside its bounds.
        """
        return cls.from_dict(read_yaml(path), source=str(path))

    def to_yaml(self, path: str | Path) -> None:
        """Write all groups and fields as YAML; ``from_yaml`` gives back an equal object."""
        write_yaml(path, self.model_dump(mode="json"))

    def replace(self, **groups: Mapping[str, Any]) -> PlantParameters:
        """Copy with some fields changed: ``parameters.replace(load={"mass": 80.0})``."""
        values = self.model_dump()
        for group, fields in groups.items():
            if group not in values:
                raise ConfigurationError(f"plant parameters: unknown group '{group}'; known: {', '.join(values)}")
            values[group].update(fields)
        return self.from_dict(values)


def _paths() -> tuple[str, ...]:
    return tuple(
        f"{group}.{field}"
        for group, info in PlantParameters.model_fields.items()
        for field in cast("type[Group]", info.annotation).model_fields
    )


PARAMETER_PATHS: tuple[str, ...] = _paths()
"""``group.field`` of every parameter, in the order of :func:`to_vector`."""

MODEL_CODES: dict[str, tuple[str, ...]] = {
    "valve.model": ("drive", "spool", "ideal"),
    "friction.model": ("none", "coulomb", "stribeck", "lugre"),
    "supply.model": ("constant", "accumulator", "pump"),
}
"""Fields that are a choice; in a parameter vector they stand as the index of the choice."""


def to_vector(parameters: PlantParameters) -> NDArray[np.float64]:
    """All parameters as one vector of ``len(PARAMETER_PATHS)`` numbers, for compiled code."""
    values = []
    for path in PARAMETER_PATHS:
        group, field = path.split(".")
        value = getattr(getattr(parameters, group), field)
        values.append(MODEL_CODES[path].index(value) if path in MODEL_CODES else value)
    return np.array(values, dtype=np.float64)


def from_vector(vector: NDArray[np.float64]) -> PlantParameters:
    """The inverse of :func:`to_vector`; validates."""
    values: dict[str, dict[str, Any]] = {}
    for path, value in zip(PARAMETER_PATHS, vector.tolist(), strict=True):
        group, field = path.split(".")
        values.setdefault(group, {})[field] = MODEL_CODES[path][int(value)] if path in MODEL_CODES else value
    return PlantParameters.from_dict(values)
