"""Practical units, quantities written with a unit, and configuration fields with unit, origin and bounds."""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from hydro_env.errors import ConfigurationError
from hydro_env.mistakes import one_of

LITRE_PER_MINUTE = 1e-3 / 60  # one litre per minute in m³/s
LEAKAGE_TEST_PRESSURE = 100e5  # pressure difference (Pa) for quoting a leak: 100 bar across the piston
FULL_VOLTAGE = 10.0  # largest input of the valve's amplifier (V); a command of 1


UNITS = {
    "m": {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 0.0254, "um": 1e-6, "µm": 1e-6},
    "m³": {"l": 1e-3, "cm³": 1e-6, "ml": 1e-6, "dm³": 1e-3, "m³": 1.0},
    "m/s": {"mm/s": 1e-3, "m/s": 1.0, "m/min": 1.0 / 60.0},
    "m³/s": {"l/min": LITRE_PER_MINUTE, "cm³/min": 1e-3 * LITRE_PER_MINUTE, "l/s": 1e-3, "cm³/s": 1e-6, "m³/s": 1.0},
    "m³/(s Pa)": {"l/min/bar": LITRE_PER_MINUTE / 1e5, "m³/(s Pa)": 1.0},
    "Pa": {"bar": 1e5, "MPa": 1e6, "psi": 6894.757293168, "kPa": 1e3, "Pa": 1.0, "mbar": 1e2, "GPa": 1e9},
    "kg": {"kg": 1.0, "t": 1e3, "g": 1e-3},
    "N": {"N": 1.0, "kN": 1e3},
    "N/m": {"N/mm": 1e3, "kN/mm": 1e6, "kN/m": 1e3, "N/m": 1.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "rad/s": {"Hz": 2.0 * math.pi, "rad/s": 1.0},
    "A": {"mA": 1e-3, "A": 1.0},
    "V": {"V": 1.0, "mV": 1e-3},
    "1": {"%": 1e-2, "1": 1.0, "-": 1.0},
}
"""SI units per unit, by SI unit; the usual units come first. Pressures are gauge pressures."""

FACTORS = {name: factor for known in UNITS.values() for name, factor in known.items()}  # SI units per unit, by its name

_QUANTITY = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?![eE][-+]?\d)(-|[^\d\s.,:+-].*)")
_HEADING = re.compile(r"\s*(.*?)\s*(?:[\[(]([^\[\]()]*)[\])])?\s*")


def unit_factor(text: str, known: Mapping[str, float]) -> float:
    """SI units per unit of a text, by the ``known`` ones; it may contain ``3`` or ``^3`` for ``³``, and ``µ`` or ``μ``.

    Raises:
        ConfigurationError: the unit is unknown.
    """
    names = {_plain(name): factor for name, factor in known.items()}
    if _plain(text) not in names:
        raise ConfigurationError(f"unit '{text.strip()[:40]}': {one_of(text.strip(), known)}")
    return names[_plain(text)]


def _plain(unit: str) -> str:
    letters = str.maketrans({"³": "3", "²": "2", "μ": "µ", "^": None, "·": None, "*": None, " ": None})
    return unit.translate(letters)


def split_quantity(text: str) -> tuple[float | None, str]:
    """Number and unit of a text such as ``63 mm``; ``None`` and nothing for any other text."""
    found = _QUANTITY.fullmatch(text.strip())
    return (float(found[1]), found[2].strip()) if found else (None, "")


def split_heading(heading: str) -> tuple[str, str | None]:
    """Name and unit of the heading of a column: ``position [mm]`` or ``position (mm)``."""
    match = _HEADING.fullmatch(heading)
    return (match[1], match[2]) if match else (heading, None)


def written(value: float, unit: str) -> str:
    """A value with its usual unit, such as ``160 bar`` for 1.6e7 in Pa."""
    usual, factor = next(iter(UNITS.get(unit, {unit: 1.0}).items()))
    return f"{value / factor:.6g} {usual}"


def from_unit(number: float, unit: str, digits: int = 15) -> float:
    """A number with so many digits in a unit, in SI: 36 mm are 0.036 m, not 0.036000000000000004."""
    return float(f"{float(f'{number:.{digits}g}') * FACTORS[unit]:.15g}")


def rounded(value: float, unit: str = "1", digits: int = 3) -> float:
    """A value in SI as a person would write it, with so many digits in a unit."""
    return from_unit(value / FACTORS[unit], unit, digits)


def in_si(value: Any, unit: str) -> Any:
    """A quantity written with its unit, such as ``63 mm``, or a list of them, in SI; anything else unchanged.

    A unit of the result that is not in :data:`UNITS` accepts only its own name.

    Raises:
        ConfigurationError: the text names a unit of another quantity.
    """
    if isinstance(value, list | tuple):
        return [in_si(entry, unit) for entry in value]
    number, own = split_quantity(value) if isinstance(value, str) else (None, "")
    if number is None:
        return value
    factor = unit_factor(own, UNITS.get(unit, {unit: 1.0}))
    return float(f"{number * factor:.15g}")  # 36 mm are 0.036 m, not 0.036000000000000004


def resistance_from_flow(flow_lpm: float) -> float:
    """Leakage resistance R_i in Pa s/m³ of a leak quoted in l/min at 100 bar; 0 gives infinity (10).

    Raises:
        ConfigurationError: the leak is negative or no number.

    Example:
        >>> from hydro_env import resistance_from_flow
        >>> f"{resistance_from_flow(1.0):.3g} Pa s/m³"
        '6e+11 Pa s/m³'
    """
    if not flow_lpm >= 0.0:
        raise ConfigurationError(f"leakage = {flow_lpm}: must be a number in l/min, at least 0")
    flow = float(flow_lpm) * LITRE_PER_MINUTE
    return LEAKAGE_TEST_PRESSURE / flow if flow > 0.0 else math.inf  # the smallest numbers become 0 in m³/s


def flow_from_resistance(resistance: float) -> float:
    """Leakage in l/min at 100 bar of a resistance in Pa s/m³; the inverse of :func:`resistance_from_flow`.

    Raises:
        ConfigurationError: the resistance is not above 0, or no number.

    Example:
        >>> from hydro_env import flow_from_resistance, resistance_from_flow
        >>> round(flow_from_resistance(resistance_from_flow(2.0)), 6)
        2.0
    """
    if not resistance > 0.0:
        raise ConfigurationError(f"leakage resistance = {resistance}: must be a number in Pa s/m³, above 0")
    return LEAKAGE_TEST_PRESSURE / float(resistance) / LITRE_PER_MINUTE


def _no_truth_value(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not true/false")
    return value


def _no_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError("must be a number, not NaN")
    return value


Number = Annotated[float, BeforeValidator(_no_truth_value), AfterValidator(_no_nan)]  # neither a truth value nor NaN
Whole = Annotated[int, BeforeValidator(_no_truth_value)]  # an integer that is no truth value


def quantity(default: float, unit: str, origin: str, low: float, high: float) -> Any:
    """A numeric field with its unit, its origin and its allowed range, beyond which a value must be a mistake."""
    return Field(default, description=origin, json_schema_extra={"unit": unit}, ge=low, le=high)


Range = tuple[Number, Number]


def interval(default: tuple[float, float], unit: str, low: float, high: float, description: str = "") -> Any:
    """A pair of rising numbers with its unit and its allowed range, beyond which a value must be a mistake."""
    return Field(default, description=description, json_schema_extra={"unit": unit, "low": low, "high": high})
