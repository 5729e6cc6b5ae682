"""Lines between valve and cylinder: a volume of oil, or with a length pipes in which pressure travels as a wave.

A line with waves is a chain of :data:`CELLS` cells of oil, with a column of oil that has mass and friction between each
two, and half a column between the last cell and the chamber. The chain lowers the first natural frequency of a line
that is closed at the valve by about 1 %.
"""

import math
from typing import NamedTuple

from hydro_env.compiling import inline, merged, tuple_replacer
from hydro_env.files import Group, whole_group
from hydro_env.plant.parts.chambers import chamber_volumes, pressure_rate, pressure_within_limits, time_to_fall
from hydro_env.plant.parts.leakage import external_leakage, internal_leakage
from hydro_env.plant.states import LineState, Structure, state_kind
from hydro_env.units import Number, quantity

CELLS = 3


class Lines(Group):
    """Pipes or hoses between valve and cylinder: more compressible oil, elastic walls, and with a length waves."""

    volume_a: Number = quantity(0.0, "m³", "assumed; oil between valve and chamber a", 0.0, 0.1)
    volume_b: Number = quantity(0.0, "m³", "assumed; oil between valve and chamber b", 0.0, 0.1)
    wall_bulk_modulus: Number = quantity(math.inf, "Pa", "assumed; V dp/dV of the wall: steel inf", 1e6, math.inf)
    length_a: Number = quantity(0.0, "m", "assumed; 0: a volume without waves; give both lengths", 0.0, 100.0)
    length_b: Number = quantity(0.0, "m", "assumed; of the line to chamber b", 0.0, 100.0)

    @property
    def have_waves(self) -> bool:
        """Whether pressure travels through the lines as a wave."""
        return self.length_a > 0.0

    @whole_group
    def _both_lines(self) -> "Lines":
        if (self.length_a > 0.0) != (self.length_b > 0.0):
            raise ValueError(f"length_a = {self.length_a:g} m, length_b = {self.length_b:g} m: give both, or none")
        for side in ("a", "b"):
            if self.have_waves and getattr(self, f"volume_{side}") <= 0.0:
                raise ValueError(f"length_{side} needs volume_{side}: oil in a line without volume has no inertia")
        return self


class LineCoefficients(NamedTuple):
    """Constants of lines with waves in the right-hand side; 0 without a length."""

    cell_volume_a: float  # m³
    cell_volume_b: float
    cell_wall_a: float  # dV/dp of a cell's wall, m³/Pa
    cell_wall_b: float
    column_rate_a: float  # 1 / inertance of a column, m⁴/kg
    column_rate_b: float
    column_resistance_a: float  # Pa s/m³
    column_resistance_b: float


@inline
def _column(volume, length, p):
    """Inverse inertance (m⁴/kg) and resistance (Pa s/m³) of a column of a line; 0 without a length.

    The friction is that of laminar flow, which at the frequency ω₁ of the line's first wave shears a thin layer alone:
    R = I √(2 ν ω₁)/r (Zielke 1968, Trikha 1975, at high frequency), at least the steady 8 ν I/r² (Hagen–Poiseuille).
    It damps that wave by ζ = √(ν/(2 ω₁))/r.
    """
    if length <= 0.0:
        return 0.0, 0.0
    area = volume / length
    radius = math.sqrt(area / math.pi)
    inertance = p.fluid_density * length / (CELLS * area)
    softness = 1.0 / p.fluid_bulk_modulus + 1.0 / p.lines_wall_bulk_modulus
    first = 0.5 * math.pi / (length * math.sqrt(p.fluid_density * softness))
    shear = max(math.sqrt(2.0 * p.fluid_kinematic_viscosity * first), 8.0 * p.fluid_kinematic_viscosity / radius)
    return 1.0 / inertance, inertance * shear / radius


@inline
def line_coefficients(p):
    """:class:`LineCoefficients` of the physical parameters ``p``."""
    rate_a, resistance_a = _column(p.lines_volume_a, p.lines_length_a, p)
    rate_b, resistance_b = _column(p.lines_volume_b, p.lines_length_b, p)
    share = (1.0 if p.lines_length_a > 0.0 else 0.0) / CELLS
    return LineCoefficients(
        cell_volume_a=share * p.lines_volume_a,
        cell_volume_b=share * p.lines_volume_b,
        cell_wall_a=share * p.lines_volume_a / p.lines_wall_bulk_modulus,
        cell_wall_b=share * p.lines_volume_b / p.lines_wall_bulk_modulus,
        column_rate_a=rate_a,
        column_rate_b=rate_b,
        column_resistance_a=resistance_a,
        column_resistance_b=resistance_b,
    )


class Ports(NamedTuple):
    """What the valve's edges see: spool, supply, and the pressures at its ports a and b."""

    spool_position: float
    supply_pressure: float
    pressure_a: float  # Pa
    pressure_b: float


@inline
def lines_at_rest(s, c):
    """:class:`~hydro_env.plant.states.LineState` while the lines carry what leaks out of the chambers."""
    flow_a = internal_leakage(s.pressure_a, s.pressure_b, c)
    flow_b = external_leakage(s.pressure_b, c) - flow_a
    drop_a, drop_b = c.column_resistance_a * flow_a, c.column_resistance_b * flow_b
    return LineState(
        line_a_pressure_1=s.pressure_a + 2.5 * drop_a,
        line_a_pressure_2=s.pressure_a + 1.5 * drop_a,
        line_a_pressure_3=s.pressure_a + 0.5 * drop_a,
        line_b_pressure_1=s.pressure_b + 2.5 * drop_b,
        line_b_pressure_2=s.pressure_b + 1.5 * drop_b,
        line_b_pressure_3=s.pressure_b + 0.5 * drop_b,
        line_a_flow_1=flow_a,
        line_a_flow_2=flow_a,
        line_a_flow_3=flow_a,
        line_b_flow_1=flow_b,
        line_b_flow_2=flow_b,
        line_b_flow_3=flow_b,
    )


class LineLaws(NamedTuple):
    """What the right-hand side asks of the lines; both kinds of lines answer."""

    ports: object  # (s) → what the valve's edges see
    ports_at_rest: object  # (s, c) → the same while the lines carry what leaks out of the chambers
    into_chambers: object  # (s, edges) → flow into chamber a and out of chamber b, m³/s
    chambers: object  # (position, c) → volumes (m³) and wall compliances (m³/Pa) of both chambers
    rates: object  # (s, edges, c) → derivative of the LineState
    weights: object  # (c) → error weight of each of these states
    within_limits: object  # (s) → state without pressures below the vapour pressure in the lines
    kink: object  # (nearest, s, rate) → time in s to the next kink, if it is nearer


@inline
def _from_the_edges(s, edges):
    return edges.supply_to_a - edges.a_to_tank, edges.b_to_tank - edges.supply_to_b  # (2), (3)


@inline
def _chambers_and_lines(position, c):
    volume_a, volume_b = chamber_volumes(position, c)  # (8), (9)
    return volume_a, volume_b, c.wall_compliance_a, c.wall_compliance_b


VOLUMES = LineLaws(
    ports=merged("chambers_as_ports", "s", "s"),
    ports_at_rest=merged("chambers_at_rest", "s, c", "s"),
    into_chambers=_from_the_edges,
    chambers=_chambers_and_lines,
    rates=merged("no_rates", "s, edges, c", "0.0"),
    weights=merged("no_weights", "c", "0.0"),
    within_limits=merged("as_it_is", "s", "s"),
    kink=merged("no_kink", "nearest, s, rate", "nearest"),
)
"""Lines as volumes: their oil belongs to the chambers."""


@inline
def _valve_cells(s):
    return Ports(s.spool_position, s.supply_pressure, s.line_a_pressure_1, s.line_b_pressure_1)


@inline
def _valve_cells_at_rest(s, c):
    rest = lines_at_rest(s, c)
    return Ports(s.spool_position, s.supply_pressure, rest.line_a_pressure_1, rest.line_b_pressure_1)


@inline
def _from_the_lines(s, edges):
    return s.line_a_flow_3, -s.line_b_flow_3


@inline
def _chambers_alone(position, c):
    volume_a, volume_b = chamber_volumes(position, c)
    return volume_a - CELLS * c.cell_volume_a, volume_b - CELLS * c.cell_volume_b, 0.0, 0.0


@inline
def _line_rates(s, edges, c):
    """Each cell stores oil, each column accelerates; the half column before the chamber has half of both constants."""
    volume_a, wall_a, rate_a, friction_a = c.cell_volume_a, c.cell_wall_a, c.column_rate_a, c.column_resistance_a
    volume_b, wall_b, rate_b, friction_b = c.cell_volume_b, c.cell_wall_b, c.column_rate_b, c.column_resistance_b
    from_valve_a = edges.supply_to_a - edges.a_to_tank
    from_valve_b = edges.supply_to_b - edges.b_to_tank
    a_1, a_2, a_3 = s.line_a_pressure_1, s.line_a_pressure_2, s.line_a_pressure_3
    b_1, b_2, b_3 = s.line_b_pressure_1, s.line_b_pressure_2, s.line_b_pressure_3
    return LineState(
        line_a_pressure_1=pressure_rate(from_valve_a - s.line_a_flow_1, volume_a, wall_a, a_1, c),
        line_a_pressure_2=pressure_rate(s.line_a_flow_1 - s.line_a_flow_2, volume_a, wall_a, a_2, c),
        line_a_pressure_3=pressure_rate(s.line_a_flow_2 - s.line_a_flow_3, volume_a, wall_a, a_3, c),
        line_b_pressure_1=pressure_rate(from_valve_b - s.line_b_flow_1, volume_b, wall_b, b_1, c),
        line_b_pressure_2=pressure_rate(s.line_b_flow_1 - s.line_b_flow_2, volume_b, wall_b, b_2, c),
        line_b_pressure_3=pressure_rate(s.line_b_flow_2 - s.line_b_flow_3, volume_b, wall_b, b_3, c),
        line_a_flow_1=rate_a * (a_1 - a_2 - friction_a * s.line_a_flow_1),
        line_a_flow_2=rate_a * (a_2 - a_3 - friction_a * s.line_a_flow_2),
        line_a_flow_3=rate_a * (2.0 * (a_3 - s.pressure_a) - friction_a * s.line_a_flow_3),
        line_b_flow_1=rate_b * (b_1 - b_2 - friction_b * s.line_b_flow_1),
        line_b_flow_2=rate_b * (b_2 - b_3 - friction_b * s.line_b_flow_2),
        line_b_flow_3=rate_b * (2.0 * (b_3 - s.pressure_b) - friction_b * s.line_b_flow_3),
    )


@inline
def _line_weights(c):
    """Those of chamber pressures and of the speed, as a flow of the larger chamber."""
    pressure, flow = c.pressure_a_weight, c.velocity_weight / c.area_a
    return LineState(pressure, pressure, pressure, pressure, pressure, pressure, flow, flow, flow, flow, flow, flow)


@inline
def _cavitation(nearest, s, rate):
    time_a = min(
        time_to_fall(s.line_a_pressure_1, rate.line_a_pressure_1),
        time_to_fall(s.line_a_pressure_2, rate.line_a_pressure_2),
    )
    time_b = min(
        time_to_fall(s.line_b_pressure_1, rate.line_b_pressure_1),
        time_to_fall(s.line_b_pressure_2, rate.line_b_pressure_2),
    )
    last = min(
        time_to_fall(s.line_a_pressure_3, rate.line_a_pressure_3),
        time_to_fall(s.line_b_pressure_3, rate.line_b_pressure_3),
    )
    return min(min(nearest, last), min(time_a, time_b))


def waves(structure: Structure) -> LineLaws:
    """Lines in which pressure travels, of an axis with this structure."""
    pressures = LineState._fields[: 2 * CELLS]
    limited = ", ".join(f"pressure_within_limits(s.{name})" for name in pressures)
    replace = tuple_replacer(state_kind(structure), *pressures)
    names = {"replace": replace, "pressure_within_limits": pressure_within_limits}
    within = merged("within", "s", f"replace(s, {limited})", **names)
    return LineLaws(
        _valve_cells,
        _valve_cells_at_rest,
        _from_the_lines,
        _chambers_alone,
        _line_rates,
        _line_weights,
        within,
        _cavitation,
    )


WAVES = waves(Structure(lines=True))
