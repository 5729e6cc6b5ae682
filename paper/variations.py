"""Every assumed parameter of a rig, varied down and up one at a time."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from hydro_env import ConfigurationError, PlantParameters, resistance_from_flow
from hydro_env.plant.analysis import force_limits
from hydro_env.plant.parts.friction import FrictionModel
from paper.rig import Rig, with_leak

CHANGE = 0.2
FORCE_SHARE = 0.02
"""Variation of the external force (assumed to be zero), relative to the force limit."""

EXTERNAL_LEAKS = (0.1, 1.0)
"""l/min at 100 bar past the rod seal; assumed tight, varied over these values."""

EXTRA_THROTTLE = 0.06
"""l/min at 100 bar through an additional orifice; 20 % of :data:`~paper.results.LEAK`."""

LEAK_NAME = "leakage.internal_resistance"


class Variation(NamedTuple):
    """One assumed parameter, and the two plants with other values of it; ``None`` if a value is impossible."""

    name: str  # group.field
    value: str
    low_value: str
    high_value: str
    low: PlantParameters | None
    high: PlantParameters | None


def assumed_parameters(base: PlantParameters) -> dict[str, Any]:
    """``group.field`` and value of every parameter whose origin is ``assumed`` (hydro_env/plant/parameters.py)."""
    return {
        f"{group}.{field}": getattr(getattr(base, group), field)
        for group in PlantParameters.model_fields
        for field, details in type(getattr(base, group)).model_fields.items()
        if (details.description or "").startswith("assumed")
    }


_USED_WITH = {
    "valve.coil_inductance": ("drive",),
    "valve.natural_frequency": ("drive", "spool"),
    "valve.damping_ratio": ("drive", "spool"),
    "valve.slew_limit": ("drive", "spool"),
    "friction.breakaway_force": ("stribeck", "lugre"),
    "friction.stribeck_velocity": ("stribeck", "lugre"),
    "friction.transition_velocity": ("coulomb", "stribeck"),
    "friction.bristle_stiffness": ("lugre",),
    "friction.bristle_damping": ("lugre",),
    "supply.relief_slope": ("accumulator", "pump"),
    "supply.line_volume": ("pump",),
    "supply.precharge_pressure": ("accumulator",),
    "supply.polytropic_index": ("accumulator",),
}
"""Parameters that only some models of their group use."""


def unused_parameters(rig: Rig) -> list[str]:
    """Assumed parameters that the models of a rig do not use."""
    unused = []
    for name in assumed_parameters(rig.parameters):
        group, models = name.split(".")[0], _USED_WITH.get(name)
        idle = models is not None and getattr(rig.parameters, group).model not in models
        if idle or (group == "friction" and not rig.has_friction):
            unused.append(name)
    return unused


def variations(rig: Rig) -> list[Variation]:
    """Every assumed parameter ±20 %; one that is zero, infinite or a choice takes other values.

    The results vary the internal leak themselves, see :func:`leak_variation`. Parameters that the rig's models do not
    use (:func:`unused_parameters`) are left out.
    """
    base, unused = rig.parameters, unused_parameters(rig)
    assumed = {name: value for name, value in assumed_parameters(base).items() if name not in (*unused, LEAK_NAME)}
    return [_variation(base, name, value, *_other_values(base, name, value)) for name, value in assumed.items()]


def _other_values(base: PlantParameters, name: str, value: Any) -> tuple[Any, Any]:
    """The lower and the higher value of a parameter; None twice if no other value is known."""
    scaled = isinstance(value, float) and 0.0 < value < math.inf
    around = ((1 - CHANGE) * value, (1 + CHANGE) * value) if scaled else (None, None)
    if name == "load.external_force":
        step = FORCE_SHARE * sum(force_limits(base)) if value == 0.0 else CHANGE * abs(value)
        return value - step, value + step
    if name == "leakage.external_resistance" and not scaled:
        return resistance_from_flow(EXTERNAL_LEAKS[1]), resistance_from_flow(EXTERNAL_LEAKS[0])
    if name == "leakage.orifice_gain":
        return 0.0, with_leak(base, EXTRA_THROTTLE, "throttle").leakage.orifice_gain
    if name == "friction.model":
        known = set(FrictionModel) - {value}
        return "none", "lugre" if "lugre" in known else "stribeck"
    if name == "fluid.air_fraction" and not scaled:
        return 0.0, 0.001
    if name == "supply.model":
        return "constant" if value == "accumulator" else "accumulator", value
    return around


def leak_variation(leak: float) -> Variation:
    """The internal leak ±20 %, for comparison; the functions that set the leak make its plants."""
    value, low, high = (f"{resistance_from_flow(factor * leak):.4g}" for factor in (1.0, 1 + CHANGE, 1 - CHANGE))
    return Variation(LEAK_NAME, value, low, high, None, None)


def _variation(base: PlantParameters, name: str, value: Any, low: Any, high: Any) -> Variation:
    shown = (_shown(value), _shown(low), _shown(high))
    return Variation(name, *shown, _changed(base, name, low), _changed(base, name, high))


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return "∞" if math.isinf(value) else f"{value:.4g}"
    return "–" if value is None else str(value)


def _changed(base: PlantParameters, name: str, value: Any) -> PlantParameters | None:
    group, field = name.split(".")
    try:
        return None if value is None else base.replace(**{group: {field: value}})
    except ConfigurationError:  # outside what the parameter may be
        return None
