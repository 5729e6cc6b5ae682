"""The cylinder's two chambers and the oil in them: volumes, pressure rates, cavitation; (8), (9), (12), (13)."""

import math
from typing import NamedTuple

from hydro_env.compiling import inline
from hydro_env.files import Group, whole_group
from hydro_env.plant.kinks import FAR
from hydro_env.plant.states import ATMOSPHERIC_PRESSURE, VAPOUR_PRESSURE
from hydro_env.units import Number, quantity, written


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

    @whole_group
    def _rod_fits_in_bore(self) -> "Cylinder":
        for name in ("rod_diameter", "rod_diameter_a"):
            if getattr(self, name) >= self.bore_diameter:
                raise ValueError(
                    f"{name} = {written(getattr(self, name), 'm')} does not fit: it must be smaller than "
                    f"bore_diameter = {written(self.bore_diameter, 'm')}"
                )
        return self


class Fluid(Group):
    """Hydraulic oil."""

    density: Number = quantity(872.0, "kg/m³", "paper, Table 1", 500.0, 2000.0)
    bulk_modulus: Number = quantity(1.4e9, "Pa", "paper, section 3 (printed there in N/m)", 1e7, 1e10)
    air_fraction: Number = quantity(0.005, "1", "assumed; free air at atmospheric pressure", 0.0, 0.2)
    kinematic_viscosity: Number = quantity(46e-6, "m²/s", "assumed; VG 46 at 40 °C, for waves in lines", 1e-7, 1e-2)


class ChamberCoefficients(NamedTuple):
    """Constants of the chambers in the right-hand side."""

    area_a: float  # A_a, m²
    area_b: float  # A_b, m²
    volume_a0: float  # V_a0, m³, chamber and dead volume at mid-stroke
    volume_b0: float  # V_b0, m³
    wall_compliance_a: float  # dV/dp of the line's wall, m³/Pa
    wall_compliance_b: float
    bulk_modulus: float  # β, Pa
    dissolved_ratio: float  # 1 − η
    free_air_pressure: float  # η p_atm, Pa


@inline
def chamber_coefficients(p):
    """:class:`ChamberCoefficients` of the physical parameters ``p``."""
    bore = 0.25 * math.pi * p.cylinder_bore_diameter**2
    area_a = bore - 0.25 * math.pi * p.cylinder_rod_diameter_a**2
    area_b = bore - 0.25 * math.pi * p.cylinder_rod_diameter**2
    return ChamberCoefficients(
        area_a=area_a,
        area_b=area_b,
        volume_a0=p.cylinder_dead_volume + p.lines_volume_a + area_a * 0.5 * p.cylinder_stroke,
        volume_b0=p.cylinder_dead_volume + p.lines_volume_b + area_b * 0.5 * p.cylinder_stroke,
        wall_compliance_a=p.lines_volume_a / p.lines_wall_bulk_modulus,
        wall_compliance_b=p.lines_volume_b / p.lines_wall_bulk_modulus,
        bulk_modulus=p.fluid_bulk_modulus,
        dissolved_ratio=1.0 - p.fluid_air_fraction,
        free_air_pressure=p.fluid_air_fraction * ATMOSPHERIC_PRESSURE,
    )


@inline
def chamber_volumes(position, c):
    """Oil volumes V_a and V_b in m³ at a position (8), (9)."""
    return c.volume_a0 + c.area_a * position, c.volume_b0 - c.area_b * position


@inline
def pressure_rate(net_flow, volume, wall_compliance, pressure, c):
    """dP/dt = net_flow / (V/β_eff + wall compliance) of one chamber (8), (9), (12), (13), in Pa/s.

    1/β_eff = 1/β + η p_atm / {[(1−η) p_abs + η p_atm] p_abs}: oil with isothermally compressed free air.
    Below the vapour pressure the chamber cavitates: its pressure falls no further.
    """
    absolute = max(pressure, VAPOUR_PRESSURE) + ATMOSPHERIC_PRESSURE
    oil = (c.dissolved_ratio * absolute + c.free_air_pressure) * absolute
    softness = volume * (oil + c.bulk_modulus * c.free_air_pressure) + wall_compliance * c.bulk_modulus * oil
    rate = net_flow * c.bulk_modulus * oil / softness
    return rate if pressure > VAPOUR_PRESSURE else max(rate, 0.0)


@inline
def pressure_within_limits(pressure):
    """Gauge pressure of a chamber in Pa, no lower than the vapour pressure."""
    return max(pressure, VAPOUR_PRESSURE)


@inline
def time_to_fall(pressure, rate):
    """Time in s until a pressure (Pa) falls to the vapour pressure, extrapolated."""
    over = pressure - VAPOUR_PRESSURE
    return over / -rate if rate < 0.0 and over > 0.0 else FAR


@inline
def time_to_cavitation(s, rate):
    """Time in s until a chamber begins to cavitate, extrapolated."""
    return min(time_to_fall(s.pressure_a, rate.pressure_a), time_to_fall(s.pressure_b, rate.pressure_b))
