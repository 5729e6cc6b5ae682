"""What is assumed about a rig, each number moved down and up by itself."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from agents.reproduction.rig import Rig, with_leak
from hydro_env import ConfigurationError, PlantParameters, resistance_from_flow
from hydro_env.plant.analysis import force_limits
from hydro_env.plant.parts.friction import FrictionModel

CHANGE = 0.2
FORCE_SHARE = 0.02
"""External force, zero as assumed, in parts of the force limit."""

EXTERNAL_LEAKS = (0.1, 1.0)
"""l/min at 100 bar past the rod seal; assumed tight, randomised over these."""

EXTRA_THROTTLE = 0.06
"""l/min at 100 bar through an orifice besides the leak; 20 % of :data:`~agents.reproduction.results.LEAK`."""


class Variation(NamedTuple):
    """One assumed parameter, and the two plants with it moved; ``None`` where a value is not possible."""

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


def variations(rig: Rig) -> list[Variation]:
    """Every assumed parameter ±20 %; those that are zero, infinite or a choice by what else they might be.

    The internal leak is varied by the results themselves, see :func:`leak_variation`. What the rig's models do not
    use (:func:`unused_parameters`) is left out.
    """
    base, found = rig.parameters, []
    unused = unused_parameters(rig)
    for name, value in assumed_parameters(base).items():
        group, field = name.split(".")
        if name in unused:
            continue
        if name == "leakage.internal_resistance":
            continue
        if name in _SPECIAL:
            found.append(_SPECIAL[name](base))
        elif isinstance(value, float) and 0.0 < value < math.inf:
            low, high = (1 - CHANGE) * value, (1 + CHANGE) * value
            found.append(_variation(base, group, field, value, low, high))
        else:  # nobody has said what else it might be; it stands in the table without an effect
            found.append(Variation(name, _shown(value), "–", "–", None, None))
    return found


_USED_WITH = {
    "valve.coil_inductance": ("valve", ("drive",)),
    "valve.natural_frequency": ("valve", ("drive", "spool")),
    "valve.damping_ratio": ("valve", ("drive", "spool")),
    "valve.slew_limit": ("valve", ("drive", "spool")),
    "friction.breakaway_force": ("friction", ("stribeck", "lugre")),
    "friction.stribeck_velocity": ("friction", ("stribeck", "lugre")),
    "friction.transition_velocity": ("friction", ("coulomb", "stribeck")),
    "friction.bristle_stiffness": ("friction", ("lugre",)),
    "friction.bristle_damping": ("friction", ("lugre",)),
    "supply.relief_slope": ("supply", ("accumulator", "pump")),
    "supply.line_volume": ("supply", ("pump",)),
    "supply.precharge_pressure": ("supply", ("accumulator",)),
    "supply.polytropic_index": ("supply", ("accumulator",)),
}
"""Parameters that only some models of their group use."""


def unused_parameters(rig: Rig) -> list[str]:
    """Assumed parameters that the models of a rig do not use."""
    base = rig.parameters
    unused = []
    for name in assumed_parameters(base):
        group, models = _USED_WITH.get(name, (name.split(".")[0], ()))
        if (group == "friction" and not rig.has_friction) or (models and getattr(base, group).model not in models):
            unused.append(name)
    return unused


def leak_variation(leak: float) -> Variation:
    """The internal leak ±20 %, as a yardstick; its plants are made where the leak is set."""
    value, low, high = (f"{resistance_from_flow(factor * leak):.4g}" for factor in (1.0, 1 + CHANGE, 1 - CHANGE))
    return Variation("leakage.internal_resistance", value, low, high, None, None)


def _variation(base: PlantParameters, group: str, field: str, value: Any, low: Any, high: Any) -> Variation:
    return Variation(
        f"{group}.{field}",
        _shown(value),
        _shown(low),
        _shown(high),
        _changed(base, group, field, low),
        _changed(base, group, field, high),
    )


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return "∞" if math.isinf(value) else f"{value:.4g}"
    return str(value)


def _changed(base: PlantParameters, group: str, field: str, value: Any) -> PlantParameters | None:
    try:
        return base.replace(**{group: {field: value}})
    except ConfigurationError:  # outside what the parameter may be
        return None


def _external_force(base: PlantParameters) -> Variation:
    value = base.load.external_force
    step = FORCE_SHARE * sum(force_limits(base)) if value == 0.0 else CHANGE * abs(value)
    return _variation(base, "load", "external_force", value, value - step, value + step)


def _external_resistance(base: PlantParameters) -> Variation:
    value = base.leakage.external_resistance
    low, high = (
        (resistance_from_flow(EXTERNAL_LEAKS[1]), resistance_from_flow(EXTERNAL_LEAKS[0]))
        if math.isinf(value)
        else ((1 - CHANGE) * value, (1 + CHANGE) * value)
    )
    return _variation(base, "leakage", "external_resistance", value, low, high)


def _orifice_gain(base: PlantParameters) -> Variation:
    more = with_leak(base, EXTRA_THROTTLE, "throttle").leakage.orifice_gain
    return _variation(base, "leakage", "orifice_gain", base.leakage.orifice_gain, 0.0, more)


def _friction_model(base: PlantParameters) -> Variation:
    known = [model for model in FrictionModel if model != base.friction.model]
    other = "lugre" if "lugre" in known else "stribeck"
    return _variation(base, "friction", "model", base.friction.model, "none", other)


def _air_fraction(base: PlantParameters) -> Variation:
    value = base.fluid.air_fraction
    low, high = ((1 - CHANGE) * value, (1 + CHANGE) * value) if value > 0.0 else (0.0, 0.001)
    return _variation(base, "fluid", "air_fraction", value, low, high)


def _supply_model(base: PlantParameters) -> Variation:
    other = "constant" if base.supply.model == "accumulator" else "accumulator"
    return _variation(base, "supply", "model", base.supply.model, other, base.supply.model)


_SPECIAL = {
    "load.external_force": _external_force,
    "leakage.external_resistance": _external_resistance,
    "leakage.orifice_gain": _orifice_gain,
    "friction.model": _friction_model,
    "fluid.air_fraction": _air_fraction,
    "supply.model": _supply_model,
}
