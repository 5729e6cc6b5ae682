"""The right-hand side of the servo axis, put together from its parts: the page to read beside the paper.

Each part (``parts``) holds its own parameters, coefficients and laws; every line here names its equation in Kovari
(2015). docs/model.md lists the corrections of the printed equations. The functions take plain numbers. Numba compiles
them for the fast kernel; the reference solver and the linearisation call them from Python. All but the coefficients
are algebraic (no exp, tanh, pow), which lets the compiler vectorise them. SI units, gauge pressures.
"""

from functools import cache
from typing import Annotated, Any, NamedTuple

from hydro_env.compiling import inline, merged, named_tuple, tuple_joiner, tuple_replacer
from hydro_env.plant.parts.chambers import (
    ChamberCoefficients,
    chamber_coefficients,
    pressure_rate,
    pressure_within_limits,
    time_to_cavitation,
)
from hydro_env.plant.parts.friction import FrictionCoefficients, friction, friction_coefficients, time_to_reversal
from hydro_env.plant.parts.leakage import LeakageCoefficients, external_leakage, internal_leakage, leakage_coefficients
from hydro_env.plant.parts.lines import VOLUMES, LineCoefficients, LineLaws, line_coefficients, waves
from hydro_env.plant.parts.load import (
    RIGID_LOAD,
    SECOND_MASS,
    LoadCoefficients,
    TipLaws,
    acceleration,
    load_coefficients,
    piston_force,
)
from hydro_env.plant.parts.supply import SupplyCoefficients, supply_coefficients, supply_rates
from hydro_env.plant.parts.valve import (
    EdgeCoefficients,
    ValveCoefficients,
    after_command,
    current_rate,
    edge_coefficients,
    edge_flows,
    nearest_edge_kink,
    spool_rates,
    spool_within_limits,
    time_to_spool_kink,
    valve_coefficients,
)
from hydro_env.plant.states import LineState, State, Structure, TipState, error_weights, state_kind

_PARTS = (
    ChamberCoefficients,
    EdgeCoefficients,
    ValveCoefficients,
    FrictionCoefficients,
    LoadCoefficients,
    SupplyCoefficients,
    LeakageCoefficients,
    LineCoefficients,
)
_part_fields = [field for part in _PARTS for field in part._fields]
_Weights = named_tuple("_Weights", [f"{name}_weight" for name in State._fields], __name__)
_PartCoefficients = named_tuple("_PartCoefficients", _part_fields, __name__)

Coefficients = named_tuple("Coefficients", [*_part_fields, *_Weights._fields], __name__)
"""Constants of the right-hand side, computed once per plant: the coefficients of all parts, and the error weights."""

_own_weights = merged("own_weights", "c", f"State({', '.join(f'c.{name}' for name in _Weights._fields)})", State=State)
_join_parts = tuple_joiner(_PartCoefficients, _PARTS)
_join_weights = tuple_joiner(Coefficients, (_PartCoefficients, State))


@inline
def coefficients(p):
    """:class:`Coefficients` of the physical parameters ``p`` (:data:`~hydro_env.plant.parameters.Physical`)."""
    parts = _join_parts(
        chamber_coefficients(p),
        edge_coefficients(p),
        valve_coefficients(p),
        friction_coefficients(p),
        load_coefficients(p),
        supply_coefficients(p),
        leakage_coefficients(p),
        line_coefficients(p),
    )
    return _join_weights(parts, error_weights(p, parts))


class Parts(NamedTuple):
    """The laws of the parts that an axis may lack, for one structure; an absent part's laws change nothing."""

    lines: LineLaws
    tip: TipLaws
    edge_kink: Any  # (nearest, s, rate, c) → time in s to the next kink of the edges, if it is nearer
    join: Any  # (State, LineState or 0, TipState or 0) → all states of the axis
    with_valve: Any  # (s, spool_position, spool_velocity, coil_current) → the state with a new valve
    with_limits: Any  # (s, pressure_a, pressure_b, spool_position, spool_velocity) → the state with these


class _Nothing(NamedTuple):
    """The states of a part that is absent."""


@cache
def parts_of(structure: Structure) -> Parts:
    """The laws of the optional parts of an axis with this structure."""
    kind = state_kind(structure)
    kinds = (State, LineState if structure.lines else _Nothing, TipState if structure.tip else _Nothing)
    return Parts(
        waves(structure) if structure.lines else VOLUMES,
        SECOND_MASS if structure.tip else RIGID_LOAD,
        nearest_edge_kink if structure.sharp_edges else merged("no_kink", "nearest, s, rate, c", "nearest"),
        tuple_joiner(kind, kinds),
        tuple_replacer(kind, "spool_position", "spool_velocity", "coil_current"),
        tuple_replacer(kind, "pressure_a", "pressure_b", "spool_position", "spool_velocity"),
    )


@inline
def chamber_net_flows(s, edges, c, lines):
    """Net oil flow in m³/s that raises the pressure of each chamber; the right-hand sides of (12), (13)."""
    leakage = internal_leakage(s.pressure_a, s.pressure_b, c)  # (10)
    flow_a, flow_b = lines.into_chambers(s, edges)
    net_a = flow_a - c.area_a * s.velocity - leakage
    net_b = -flow_b + c.area_b * s.velocity + leakage - external_leakage(s.pressure_b, c)  # (11)
    return net_a, net_b


@inline
def derivatives(s, c, voltage, parts):
    """Time derivative of the whole state: (18), corrected and completed.

    Args:
        s: state (:class:`~hydro_env.plant.states.State`, and the states of the parts that the axis has).
        c: coefficients of the plant (:data:`Coefficients`).
        voltage: command to the valve drive, V.
        parts: laws of the optional parts (:class:`Parts`).

    Returns:
        The derivative of every state, per second, as a state.
    """
    spool_rate, spool_acceleration = spool_rates(s, c)  # (18) rows 5, 6
    edges = edge_flows(parts.lines.ports(s), c)  # (2), (3)
    net_a, net_b = chamber_net_flows(s, edges, c, parts.lines)
    volume_a, volume_b, wall_a, wall_b = parts.lines.chambers(s.position, c)  # (8), (9)
    friction_force, bristle_rate = friction(s.velocity, s.bristle_deflection, c)
    resistance = parts.tip.resistance(friction_force, s, c)
    supply_rate, gas_rate = supply_rates(s, edges.supply_to_a + edges.supply_to_b, c)
    rates = State(
        position=s.velocity,
        velocity=acceleration(s, resistance, c),  # (14), (17)
        pressure_a=pressure_rate(net_a, volume_a, wall_a, s.pressure_a, c),  # (12)
        pressure_b=pressure_rate(net_b, volume_b, wall_b, s.pressure_b, c),  # (13)
        spool_position=spool_rate,
        spool_velocity=spool_acceleration,
        coil_current=current_rate(s, c, voltage),  # (1), (18) row 7
        supply_pressure=supply_rate,
        gas_volume=gas_rate,
        bristle_deflection=bristle_rate,
    )
    return parts.join(rates, parts.lines.rates(s, edges, c), parts.tip.rates(s, c))


@inline
def weights(c, parts):
    """Weight of each state's error in the integrator, as a state."""
    return parts.join(_own_weights(c), parts.lines.weights(c), parts.tip.weights(c))


@inline
def command_changed(s, c, voltage, parts):
    """State just after a new command takes effect; an ideal drive or spool has already jumped to it."""
    spool, spool_velocity, current = after_command(s, c, voltage)
    return parts.with_valve(s, spool, spool_velocity, current)


@inline
def hold_limits(s, c, parts):
    """State clipped to its hard limits: spool stroke and slew, vapour pressure.

    The derivative stops at these limits, but a step overshoots them a little; this removes the overshoot.
    """
    spool, spool_velocity = spool_within_limits(s, c)
    limited = parts.with_limits(
        s, pressure_within_limits(s.pressure_a), pressure_within_limits(s.pressure_b), spool, spool_velocity
    )
    return parts.lines.within_limits(limited)


SHORTEST_TO_KINK = 1e-6  # s; kinks are located no more exactly than this


@inline
def time_to_kink(s, rate, c, parts):
    """Time in s to the next kink of any part, extrapolated from a state and its derivative; at least 1 µs.

    Kinks: the spool meets or leaves its slew limit or its stroke, or a sharp edge opens; a chamber or a line begins to
    cavitate; the piston reverses.
    """
    nearest = min(time_to_spool_kink(s, rate, c), min(time_to_cavitation(s, rate), time_to_reversal(s, rate, c)))
    nearest = parts.lines.kink(parts.edge_kink(nearest, s, rate, c), s, rate)
    return max(nearest, SHORTEST_TO_KINK)


class Derived(NamedTuple):
    """Quantities that follow from a state, each with its unit."""

    flow_a: Annotated[float, "m³/s"]  # into chamber a through the valve
    flow_b: Annotated[float, "m³/s"]  # out of chamber b through the valve
    leakage_flow: Annotated[float, "m³/s"]
    external_leakage_flow: Annotated[float, "m³/s"]
    supply_flow: Annotated[float, "m³/s"]
    load_force: Annotated[float, "N"]
    friction_force: Annotated[float, "N"]
    acceleration: Annotated[float, "m/s²"]


@inline
def derived_quantities(s, c, parts):
    """:class:`Derived` of a state."""
    edges = edge_flows(parts.lines.ports(s), c)
    friction_force, _ = friction(s.velocity, s.bristle_deflection, c)
    return Derived(
        flow_a=edges.supply_to_a - edges.a_to_tank,
        flow_b=edges.b_to_tank - edges.supply_to_b,
        leakage_flow=internal_leakage(s.pressure_a, s.pressure_b, c),
        external_leakage_flow=external_leakage(s.pressure_b, c),
        supply_flow=edges.supply_to_a + edges.supply_to_b,
        load_force=piston_force(s.pressure_a, s.pressure_b, c),
        friction_force=friction_force,
        acceleration=acceleration(s, parts.tip.resistance(friction_force, s, c), c),
    )
