"""Units in which practice quotes leaks, and how they convert to SI."""

from __future__ import annotations

import math

LITRE_PER_MINUTE = 1e-3 / 60
"""One litre per minute in m³/s."""

LEAKAGE_TEST_PRESSURE = 100e5
"""Pressure difference (Pa) at which practice quotes a leak: 100 bar across the piston."""


def resistance_from_flow(flow_lpm: float) -> float:
    """Leakage resistance R_i in Pa s/m³ of a leak quoted in l/min at 100 bar; 0 gives infinity (10)."""
    return LEAKAGE_TEST_PRESSURE / (flow_lpm * LITRE_PER_MINUTE) if flow_lpm > 0 else math.inf


def flow_from_resistance(resistance: float) -> float:
    """Leakage in l/min at 100 bar of a resistance in Pa s/m³; the inverse of :func:`resistance_from_flow`."""
    return LEAKAGE_TEST_PRESSURE / resistance / LITRE_PER_MINUTE


def orifice_gain_from_flow(flow_lpm: float) -> float:
    """Gain in m³/(s √Pa) of a throttle through which 100 bar press a leak quoted in l/min."""
    return flow_lpm * LITRE_PER_MINUTE / math.sqrt(LEAKAGE_TEST_PRESSURE)
