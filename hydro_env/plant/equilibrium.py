"""The state at rest that holds a position: pressures, supply, and the small spool offset that balances the flows.

Two unknowns, the pressure of chamber a and the spool position, must make the net flows of both chambers vanish. The
flows come from the right-hand side (``equations``): another valve or leak needs no change here.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from hydro_env.compiling import inline, merged, tuple_replacer
from hydro_env.plant.equations import Coefficients, chamber_net_flows, parts_of
from hydro_env.plant.parts.lines import VOLUMES, lines_at_rest
from hydro_env.plant.parts.load import balancing_pressure_b, holding_force
from hydro_env.plant.parts.supply import gas_volume_at, regulated_pressure
from hydro_env.plant.parts.valve import edge_flows, holding_command
from hydro_env.plant.states import State, Structure, TipState

_SMALLEST_UNDERLAP_SQUARED = 1e-12  # of a zero-lapped valve at rest; without any flow no pressure is determined

_SUPPLY_ITERATIONS = 8
_ITERATIONS = 100

_with_underlap = tuple_replacer(Coefficients, "underlap_squared")


def _root_of(function: Callable[..., Any], tolerance: float) -> Callable[..., Any]:
    """``find_root(low, high, arguments, lines)`` of a monotone function: regula falsi (Illinois) and bisection.

    If the function does not change its sign, the result is the end with the value closer to zero. The search stops when
    it moves by no more than ``tolerance``; the flow law has errors of 4e-14, so a smaller change is noise.
    """

    @inline
    def find_root(low, high, arguments, lines):
        at_low, at_high = function(low, arguments, lines), function(high, arguments, lines)
        if (at_low > 0.0) == (at_high > 0.0):
            return low if abs(at_low) < abs(at_high) else high
        root, side = low, 0
        for iteration in range(_ITERATIONS):
            before = root
            secant = (low * at_high - high * at_low) / (at_high - at_low)
            bisect = iteration % 16 == 15 or not min(low, high) < secant < max(low, high)
            root = 0.5 * (low + high) if bisect else secant
            value = function(root, arguments, lines)
            if value == 0.0 or abs(root - before) <= tolerance:
                break
            if (value > 0.0) == (at_low > 0.0):
                low, at_low = root, value
                at_high *= 0.5 if side < 0 else 1.0  # the high end has stayed twice
                side = -1
            else:
                high, at_high = root, value
                at_low *= 0.5 if side > 0 else 1.0
                side = 1
        return root

    return find_root


@inline
def _at_rest(position, pressure_a, spool_position, supply_pressure, c):
    """State at rest whose pressures balance the forces; states without influence on the flows get a constant."""
    return State(
        position=position,
        velocity=0.0,
        pressure_a=pressure_a,
        pressure_b=balancing_pressure_b(pressure_a, holding_force(position, c), c),
        spool_position=spool_position,
        spool_velocity=0.0,
        coil_current=0.0,
        supply_pressure=supply_pressure,
        gas_volume=1.0,
        bristle_deflection=0.0,
    )


@inline
def _net_flows(s, c, lines):
    return chamber_net_flows(s, edge_flows(lines.ports_at_rest(s, c), c), c, VOLUMES)


@cache
def rest_of(structure: Structure) -> Any:
    """``rest(s, c)``: all states of an axis with this structure whose first states ``s`` are at rest."""
    lines = "lines_at_rest(s, c)" if structure.lines else "0.0"
    tip = "TipState(s.position, 0.0)" if structure.tip else "0.0"
    names = {"join": parts_of(structure).join, "lines_at_rest": lines_at_rest, "TipState": TipState}
    return merged("rest", "s, c", f"join(s, {lines}, {tip})", **names)


complete_at_rest = rest_of(Structure(lines=True, tip=True))  # (s, c): of an axis that has every part


@inline
def _net_flow_a(spool_position, arguments, lines):
    """Net flow into chamber a; it rises with the spool position."""
    position, pressure_a, supply_pressure, c = arguments
    return _net_flows(_at_rest(position, pressure_a, spool_position, supply_pressure, c), c, lines)[0]


_balanced_spool = _root_of(_net_flow_a, tolerance=1e-15)


@inline
def _net_flow(pressure_a, arguments, lines):
    """Net flow into both chambers while the valve balances chamber a as far as possible; it falls as pressure a rises.

    If the valve can balance chamber a, it is the net flow into chamber b. The leak between the chambers cancels out;
    the sign is therefore correct even if the fully open valve is too small for the leak.
    """
    position, supply_pressure, c = arguments
    spool = _balanced_spool(-1.0, 1.0, (position, pressure_a, supply_pressure, c), lines)
    net_a, net_b = _net_flows(_at_rest(position, pressure_a, spool, supply_pressure, c), c, lines)
    return net_a + net_b


_balanced_pressure = _root_of(_net_flow, tolerance=1e-5)


@inline
def _balance(position, supply_pressure, c, lines):
    """Pressure of chamber a and spool position at which both net flows vanish, and whether such values exist."""
    force, tank = holding_force(position, c), c.tank_pressure
    # Both pressures stay between tank and supply.
    edge = 1e-9 * (supply_pressure - tank)
    low = max(tank, (force + c.area_b * tank) / c.area_a) + edge
    high = min(supply_pressure, (force + c.area_b * supply_pressure) / c.area_a) - edge
    if not high > low:
        return 0.0, 0.0, False
    pressure = _balanced_pressure(low, high, (position, supply_pressure, c), lines)
    spool = _balanced_spool(-1.0, 1.0, (position, pressure, supply_pressure, c), lines)
    return pressure, spool, low < pressure < high and -1.0 < spool < 1.0


@inline
def equilibrium_state(position, p, c, lines):
    """:class:`State` at rest at ``position`` (m), the voltage (V) that holds it, and whether the position can be held.

    Without pump or relief valve nothing holds the supply pressure: it starts at its setting; all other states are at
    rest. ``p`` are the physical parameters, ``c`` the coefficients of the same plant, ``lines`` the laws of its lines.
    """
    resting = _with_underlap(c, max(c.underlap_squared, _SMALLEST_UNDERLAP_SQUARED))
    supply_pressure = c.relief_pressure
    pressure_a, spool, balanced = 0.0, 0.0, False
    for _ in range(_SUPPLY_ITERATIONS):
        # The null flow of the valve hardly depends on the supply pressure: a few iterations suffice.
        pressure_a, spool, balanced = _balance(position, supply_pressure, resting, lines)
        s = _at_rest(position, pressure_a, spool, supply_pressure, resting)
        edges = edge_flows(lines.ports_at_rest(s, resting), resting)
        before = supply_pressure
        supply_pressure = regulated_pressure(edges.supply_to_a + edges.supply_to_b, c)
        if not balanced or supply_pressure < c.relief_pressure or abs(supply_pressure - before) < 1e-6:
            break
    balanced = balanced and supply_pressure >= c.relief_pressure  # else the pump cannot supply even the null flow
    coil_current, voltage = holding_command(spool, c)
    state = State(
        position=position,
        velocity=0.0,
        pressure_a=pressure_a,
        pressure_b=balancing_pressure_b(pressure_a, holding_force(position, c), c),
        spool_position=spool,
        spool_velocity=0.0,
        coil_current=coil_current,
        supply_pressure=supply_pressure,
        gas_volume=gas_volume_at(supply_pressure, p),
        bristle_deflection=0.0,
    )
    return state, voltage, balanced
