"""Units in which practice quotes leaks, and fields of a configuration with unit, origin and bounds."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

LITRE_PER_MINUTE = 1e-3 / 60
"""One litre per minute in m³/s."""

LEAKAGE_TEST_PRESSURE = 100e5
"""Pressure difference (Pa) at which practice quotes a leak: 100 bar across the piston."""

FULL_VOLTAGE = 10.0
"""Largest input of the valve's amplifier (V); a command of 1."""


def resistance_from_flow(flow_lpm: float) -> float:
    """Leakage resistance R_i in Pa s/m³ of a leak quoted in l/min at 100 bar; 0 gives infinity (10)."""
    return LEAKAGE_TEST_PRESSURE / (flow_lpm * LITRE_PER_MINUTE) if flow_lpm > 0 else math.inf


def flow_from_resistance(resistance: float) -> float:
    """Leakage in l/min at 100 bar of a resistance in Pa s/m³; the inverse of :func:`resistance_from_flow`."""
    return LEAKAGE_TEST_PRESSURE / resistance / LITRE_PER_MINUTE


def orifice_gain_from_flow(flow_lpm: float) -> float:
    """Gain in m³/(s √Pa) of a throttle that passes a leak quoted in l/min at 100 bar."""
    return flow_lpm * LITRE_PER_MINUTE / math.sqrt(LEAKAGE_TEST_PRESSURE)


def _no_truth_value(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not true/false")
    return value


def _no_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError("must be a number, not NaN")
    return value


Number = Annotated[float, BeforeValidator(_no_truth_value), AfterValidator(_no_nan)]
"""A float that is neither a truth value nor NaN."""


def quantity(default: float, unit: str, origin: str, low: float, high: float, *, above: bool = False) -> Any:
    """A numeric field with its unit, its origin and its allowed range; a value outside must be a mistake."""
    bounds: dict[str, Any] = {"gt" if above else "ge": low, "le": high}
    return Field(default, description=origin, json_schema_extra={"unit": unit}, **bounds)
