"""Leaks: past the piston (10), through the throttle in parallel, and past the rod seal (11)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_env.compiling import inline
from hydro_env.files import Group
from hydro_env.plant.parts.valve import smooth_root
from hydro_env.units import Number, quantity


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
