"""The state at rest that holds a position: pressures, supply, and the small spool offset that balances the flows."""

from __future__ import annotations

import math

from hydro_env.compiling import inline
from hydro_env.plant.equations import ATMOSPHERIC_PRESSURE, State, smooth_root

_SMALLEST_UNDERLAP_SQUARED = 1e-12
_SUPPLY_ITERATIONS = 8
_PRESSURE_ITERATIONS = 80


@inline
def _spool_for_flow_a(pressure_a, supply_pressure, flow_a, underlap_squared, c):
    """Spool position at which chamber a receives ``flow_a``: the flow law (2) solved for the spool."""
    inflow = smooth_root(supply_pressure - pressure_a, c.transition_squared)
    outflow = smooth_root(pressure_a - c.tank_pressure, c.transition_squared)
    total = inflow + outflow
    difference = inflow - outflow
    twice = 2.0 * flow_a / c.edge_gain
    spread = total * total - difference * difference
    return (twice * total - difference * math.sqrt(twice * twice + spread * underlap_squared)) / spread


@inline
def _surplus_of_b(pressure_a, supply_pressure, force, underlap_squared, c):
    """Oil that chamber b would gain (m³/s) if chamber a is balanced and the forces are; and the spool position."""
    pressure_b = (pressure_a * c.area_a - force) / c.area_b
    drop = pressure_a - pressure_b
    leakage = c.leakage_conductance * drop + c.leakage_orifice_gain * smooth_root(drop, c.transition_squared)
    spool = _spool_for_flow_a(pressure_a, supply_pressure, leakage, underlap_squared, c)
    width = math.sqrt(spool * spool + underlap_squared)
    flow_b = c.edge_gain * (
        0.5 * (width + spool) * smooth_root(pressure_b - c.tank_pressure, c.transition_squared)
        - 0.5 * (width - spool) * smooth_root(supply_pressure - pressure_b, c.transition_squared)
    )
    return -flow_b + leakage - c.external_conductance * pressure_b, spool


@inline
def _balance(position, supply_pressure, c):
    """Pressure of chamber a, spool position, and 1 (found) or 0 (the position cannot be held)."""
    force = c.spring_stiffness * position + c.external_force
    underlap_squared = max(c.underlap_squared, _SMALLEST_UNDERLAP_SQUARED)
    # Both pressures stay between tank and supply; the surplus of chamber b falls as pressure a rises.
    low = max(c.tank_pressure, (force + c.area_b * c.tank_pressure) / c.area_a)
    high = min(supply_pressure, (force + c.area_b * supply_pressure) / c.area_a)
    edge = 1e-9 * (supply_pressure - c.tank_pressure)
    low += edge
    high -= edge
    if not high > low:
        return 0.0, 0.0, 0.0
    at_low, spool = _surplus_of_b(low, supply_pressure, force, underlap_squared, c)
    at_high, spool = _surplus_of_b(high, supply_pressure, force, underlap_squared, c)
    if not (at_low >= 0.0 and at_high <= 0.0):
        return 0.0, 0.0, 0.0
    pressure = 0.5 * (low + high)
    for iteration in range(_PRESSURE_ITERATIONS):  # regula falsi (Illinois) with bisection as a safeguard
        secant = (low * at_high - high * at_low) / (at_high - at_low) if at_high != at_low else 0.5 * (low + high)
        bisect = iteration % 4 == 3 or not (low < secant < high)
        pressure = 0.5 * (low + high) if bisect else secant
        value, spool = _surplus_of_b(pressure, supply_pressure, force, underlap_squared, c)
        if value == 0.0 or high - low < 1e-6:
            break
        if value > 0.0:
            low, at_low = pressure, value
            at_high *= 0.5
        else:
            high, at_high = pressure, value
            at_low *= 0.5
    found = 1.0 if abs(spool) <= 1.0 else 0.0
    return pressure, spool, found


@inline
def equilibrium_state(position, p, c):
    """State at rest at ``position`` (m), the voltage (V) that holds it, and whether there is one.

    Without pump or relief valve nothing holds the supply pressure: it starts at its set value, and the rest rests.

    Args:
        position: m from mid-stroke.
        p: physical parameters (:data:`~hydro_env.plant.equations.Physical`).
        c: coefficients of the same plant.

    Returns:
        (:class:`State`, voltage in V, 1.0 if the position can be held or 0.0).
    """
    supply_pressure = c.relief_pressure
    pressure_a, spool, found = _balance(position, supply_pressure, c)
    regulated = (c.supply_dynamics > 0.0 or c.line_stiffness > 0.0) and c.pump_flow > 0.0 and c.relief_slope > 0.0
    if regulated and found > 0.0:
        # The relief valve passes what the pump delivers and the valve does not draw. The null flow of the valve
        # hardly depends on the supply pressure, so that this iteration converges at once.
        for _ in range(_SUPPLY_ITERATIONS):
            pressure_b = (pressure_a * c.area_a - c.spring_stiffness * position - c.external_force) / c.area_b
            width = math.sqrt(spool * spool + max(c.underlap_squared, _SMALLEST_UNDERLAP_SQUARED))
            drawn = c.edge_gain * (
                0.5 * (width + spool) * smooth_root(supply_pressure - pressure_a, c.transition_squared)
                + 0.5 * (width - spool) * smooth_root(supply_pressure - pressure_b, c.transition_squared)
            )
            before = supply_pressure
            supply_pressure = c.relief_pressure + (c.pump_flow - drawn) / c.relief_slope
            if supply_pressure < c.relief_pressure:
                found = 0.0  # the pump cannot feed even the null flow
                break
            pressure_a, spool, found = _balance(position, supply_pressure, c)
            if abs(supply_pressure - before) < 1e-6:
                break
    pressure_b = (pressure_a * c.area_a - c.spring_stiffness * position - c.external_force) / c.area_b
    gas_volume = p.supply_accumulator_volume * (
        (p.supply_precharge_pressure + ATMOSPHERIC_PRESSURE) / (supply_pressure + ATMOSPHERIC_PRESSURE)
    ) ** (1.0 / p.supply_polytropic_index)
    coil_current = spool / c.spool_gain
    voltage = coil_current * c.coil_rate / c.drive_rate
    return (
        State(position, 0.0, pressure_a, pressure_b, spool, 0.0, coil_current, supply_pressure, gas_volume, 0.0),
        voltage,
        found,
    )
