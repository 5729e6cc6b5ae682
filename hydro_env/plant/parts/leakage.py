"""Leaks: past the piston (10), through the throttle in parallel, and past the rod seal (11)."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from hydro_env.compiling import inline
from hydro_env.files import Group
from hydro_env.plant.parts.valve import smooth_root
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE, Number, quantity


class Leakage(Group):
    """Oil past the piston (internal) and past the rod seal (external)."""

    internal_resistance: Number = quantity(2e13, "Pa s/m³", "assumed; 0.03 l/min at 100 bar", 1e8, np.inf)
    external_resistance: Number = quantity(np.inf, "Pa s/m³", "assumed; tight rod seal", 1e8, np.inf)
    orifice_gain: Number = quantity(0.0, "m³/(s √Pa)", "assumed; throttle in parallel, as on the rig", 0.0, 1e-4)


class LeakageCoefficients(NamedTuple):
    """Constants of the leaks in the right-hand side."""

    leakage_conductance: float  # 1 / R_i, m³/(s Pa)
    leakage_orifice_gain: float  # K_i, m³/(s √Pa)
    external_conductance: float  # 1 / R_e, m³/(s Pa)


class Law(NamedTuple):
    """Flow of a leak over its pressure difference; one parameter sets the size."""

    parameter: str  # field of Leakage
    coefficient: str  # field of LeakageCoefficients
    at_test: float  # flow in m³/s at LEAKAGE_TEST_PRESSURE, with a coefficient of 1
    resists: bool = False  # the parameter is the inverse of the coefficient

    def value(self, flow_lpm: Any) -> Any:
        """The parameter of a leak in l/min at 100 bar, a number or an array; may be negative."""
        flow = np.asarray(flow_lpm, float) * LITRE_PER_MINUTE
        with np.errstate(divide="ignore"):
            value = self.at_test / flow if self.resists else flow / self.at_test
        return value if np.ndim(value) else float(value)

    def flow(self, value: Any) -> Any:
        """The leak in l/min at 100 bar of a parameter, a number or an array; the inverse of :meth:`value`."""
        return (self.at_test / value if self.resists else value * self.at_test) / LITRE_PER_MINUTE

    def value_of_coefficient(self, coefficient: float) -> float:
        """The parameter that gives a coefficient."""
        if not self.resists:
            return coefficient
        return 1.0 / coefficient if coefficient > 0.0 else math.inf


LeakLaw = Literal["laminar", "orifice"]
"""Laws of the leak past the piston."""

LEAK_LAWS = {
    "laminar": Law("internal_resistance", "leakage_conductance", LEAKAGE_TEST_PRESSURE, resists=True),
    "orifice": Law("orifice_gain", "leakage_orifice_gain", math.sqrt(LEAKAGE_TEST_PRESSURE)),
}
ROD_SEAL = Law("external_resistance", "external_conductance", LEAKAGE_TEST_PRESSURE, resists=True)


def leak_past_piston(flow_lpm: Any, law: LeakLaw) -> dict[str, Any]:
    """Fields of :class:`Leakage` of a leak past the piston, in l/min at 100 bar (number or array), by one law alone."""
    return {each.parameter: each.value(flow_lpm if name == law else 0.0) for name, each in LEAK_LAWS.items()}


@inline
def leakage_coefficients(p):
    """:class:`LeakageCoefficients` of the physical parameters ``p``."""
    return LeakageCoefficients(
        leakage_conductance=1.0 / p.leakage_internal_resistance,
        leakage_orifice_gain=p.leakage_orifice_gain,
        external_conductance=1.0 / p.leakage_external_resistance,
    )


@inline
def internal_leakage(pressure_a, pressure_b, c):
    """Q_i in m³/s from chamber a to b: laminar (10) plus orifice, the rig's throttle in parallel."""
    difference = pressure_a - pressure_b
    return c.leakage_conductance * difference + c.leakage_orifice_gain * smooth_root(difference, c.transition_squared)


@inline
def external_leakage(pressure_b, c):
    """Q_e in m³/s from chamber b to ambient (11)."""
    return c.external_conductance * pressure_b
