"""Formulas for hand calculations: natural frequency, stiffness, speed and force limits."""

import math
from typing import NamedTuple

from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import PlantParameters
from hydro_env.plant.parts import chambers
from hydro_env.plant.parts.leakage import internal_leakage
from hydro_env.plant.parts.load import piston_force
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE


def chamber_volumes(parameters: PlantParameters, position: float = 0.0) -> tuple[float, float]:
    """Oil in both chambers with their dead volumes at a position (m), m³: V_a0 + A_a x and V_b0 − A_b x (8), (9)."""
    return chambers.chamber_volumes(float(position), plant_coefficients(parameters))


def closed_port_stiffness(parameters: PlantParameters, position: float = 0.0) -> float:
    """Stiffness in N/m of both closed oil columns and the spring: β (A_a²/V_a + A_b²/V_b) + k (Merritt 1967).

    The walls of lines make the oil columns softer. β is that of oil without free air. Valid for short times only: seal
    and valve leak.
    """
    c = plant_coefficients(parameters)
    volume_a, volume_b = chamber_volumes(parameters, position)
    softness_a = volume_a / c.bulk_modulus + c.wall_compliance_a
    softness_b = volume_b / c.bulk_modulus + c.wall_compliance_b
    return c.area_a**2 / softness_a + c.area_b**2 / softness_b + c.spring_stiffness


def softest_position(parameters: PlantParameters) -> float:
    """Position in m where the natural frequency with closed ports is lowest (Jelali & Kroll 2003).

    There A_a³/V_a² = A_b³/V_b²; if that position lies outside the stroke, the nearer end of the stroke.
    """
    c = plant_coefficients(parameters)
    ratio = (c.area_a / c.area_b) ** 1.5
    # The compliance of a wall counts as additional volume of oil.
    volume_a = c.volume_a0 + c.bulk_modulus * c.wall_compliance_a
    volume_b = c.volume_b0 + c.bulk_modulus * c.wall_compliance_b
    position = (ratio * volume_b - volume_a) / (c.area_a + ratio * c.area_b)
    return min(max(position, -c.end_stop_position), c.end_stop_position)


def leak_at_test_pressure(parameters: PlantParameters) -> float:
    """Internal leakage in l/min at 100 bar across the piston: seal and throttle together."""
    return internal_leakage(LEAKAGE_TEST_PRESSURE, 0.0, plant_coefficients(parameters)) / LITRE_PER_MINUTE


class Limits(NamedTuple):
    """The largest steady values in both directions of motion, each positive where the supply suffices."""

    extending: float
    retracting: float


def full_pressure_forces(parameters: PlantParameters) -> Limits:
    """Forces of the piston with one chamber at supply and the other at tank pressure, in N."""
    c = plant_coefficients(parameters)
    supply, tank = c.relief_pressure, c.tank_pressure
    return Limits(piston_force(supply, tank, c), -piston_force(tank, supply, c))


def force_limits(parameters: PlantParameters) -> Limits:
    """Largest steady forces on the load: P_s A_a − P_T A_b and P_s A_b − P_T A_a in N, less the external force."""
    out, back = full_pressure_forces(parameters)
    external = parameters.load.external_force
    return Limits(out - external, back + external)


def closed_port_natural_frequency(parameters: PlantParameters, position: float = 0.0) -> float:
    """Natural frequency in rad/s of the mass on the two closed oil columns and the spring (Merritt 1967).

    ω = √((β (A_a²/V_a + A_b²/V_b) + k) / (M + m_d)); β is that of oil without free air. Does not depend on leakage.
    """
    return math.sqrt(closed_port_stiffness(parameters, position) * plant_coefficients(parameters.rigid).inverse_mass)


def speed_limits(parameters: PlantParameters, force: float = 0.0) -> Limits:
    """Steady speeds in m/s at ±10 V against a constant force (N, positive against extension); 0 where it is too large.

    From the flow law on both edges and the balance of forces, without leakage:
    v = K √((A_a P_s − A_b P_T − F)/(A_a³ + A_b³/r²)) extending, and with A_b P_s − A_a P_T + F retracting; r is the
    ratio of the edges of chamber b to those of chamber a.
    """
    c = plant_coefficients(parameters)
    cubes = c.area_a**3 + c.area_b**3 / c.edge_ratio**2
    out, back = full_pressure_forces(parameters)
    extending, retracting = (math.sqrt(max(free, 0.0) / cubes) for free in (out - force, back + force))
    return Limits(c.edge_gain * extending, c.edge_gain * retracting)


def reachable_range(parameters: PlantParameters) -> tuple[float, float]:
    """Lowest and highest position in m that the supply can hold against spring and external force."""
    c = plant_coefficients(parameters)
    out, back = force_limits(parameters)
    stop = c.end_stop_position
    if c.spring_stiffness == 0.0:
        return (-stop if back > 0 else stop), (stop if out > 0 else -stop)
    return max(-back / c.spring_stiffness, -stop), min(out / c.spring_stiffness, stop)
