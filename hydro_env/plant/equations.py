"""The right-hand side of the servo axis, written once.

Every line names its equation in Kovari (2015) or in its textbook form; the corrections of the printed
equations are listed in docs/model.md. The functions work on plain numbers. Numba compiles them for the fast kernel;
called from Python they serve the reference solver and the linearisation. Apart from the constants of
:func:`coefficients` everything is algebraic (no exp, tanh, pow), so that the compiler can vectorise it.
What must not be passed (strokes, slew, vapour pressure) stands in ``limits``. SI units, gauge pressures.
"""

from __future__ import annotations

import math
from collections import namedtuple
from typing import NamedTuple

import numpy as np

from hydro_env.compiling import inline
from hydro_env.plant.parameters import PARAMETER_PATHS

ATMOSPHERIC_PRESSURE = 101_325.0
"""Pa; what gauge pressures count from."""

VAPOUR_PRESSURE = -0.9e5
"""Pa, gauge; a chamber that would fall below it cavitates and stays at it."""


class State(NamedTuple):
    """State of one axis (or its time derivative)."""

    position: float  # m, 0 = mid-stroke, + = extending
    velocity: float  # m/s
    pressure_a: float  # Pa, bore side
    pressure_b: float  # Pa, rod side
    spool_position: float  # 1 = full stroke, + opens P to A
    spool_velocity: float  # 1/s
    coil_current: float  # A
    supply_pressure: float  # Pa
    gas_volume: float  # m³, of the accumulator
    bristle_deflection: float  # m, of the seal before it slides; a state only with LuGre friction


STATE_NAMES = State._fields
STATE_UNITS = ("m", "m/s", "Pa", "Pa", "1", "1/s", "A", "Pa", "m³", "m")

Physical = namedtuple("Physical", [path.replace(".", "_") for path in PARAMETER_PATHS])  # type: ignore[misc]
"""The parameters of :class:`~hydro_env.plant.parameters.PlantParameters` as ``group_field``."""


class Coefficients(NamedTuple):
    """What the right-hand side needs, computed once per plant by :func:`coefficients`."""

    area_a: float  # A_a, m²
    area_b: float  # A_b, m²
    volume_a0: float  # V_a0, m³, chamber and dead volume at mid-stroke
    volume_b0: float  # V_b0, m³
    edge_gain: float  # K, m³/(s √Pa)
    transition_squared: float  # dp_t², Pa²
    underlap_squared: float  # x_0²
    spool_stiffness: float  # ω_s², 1/s²
    spool_damping: float  # 2 ζ_s ω_s, 1/s
    slew_limit: float  # 1/s
    coil_rate: float  # R_C / L_C, 1/s
    drive_rate: float  # K_a / L_C, A/(s V)
    spool_gain: float  # k_t, 1/A
    ideal_drive: float  # 1 where the coil current follows the command at once
    ideal_spool: float  # 1 where the spool does
    bulk_modulus: float  # β, Pa
    dissolved_ratio: float  # 1 − η
    free_air_pressure: float  # η p_atm, Pa
    inverse_mass: float  # 1 / (M + m_d), 1/kg
    spring_stiffness: float  # k, N/m
    viscous_damping: float  # c, N s/m
    external_force: float  # F_ext, N
    coulomb_force: float  # F_c, N
    stribeck_force: float  # F_st − F_c, N
    has_bristles: float  # 1 with LuGre friction
    bristle_stiffness: float  # σ_0, N/m
    bristle_damping: float  # σ_1, N s/m
    inverse_stribeck_velocity: float  # 1 / v_st, s/m
    inverse_transition_velocity: float  # 1 / v_t, s/m
    end_stop_position: float  # L / 2, m
    end_stop_stiffness: float  # N/m
    end_stop_damping: float  # N s/m
    tank_pressure: float  # P_T, Pa
    relief_pressure: float  # P_set, Pa
    relief_slope: float  # m³/(s Pa)
    pump_flow: float  # Q_pump, m³/s
    supply_dynamics: float  # n with an accumulator, 0 without
    line_stiffness: float  # β / V_line with a pump and no accumulator, Pa/m³; 0 else
    leakage_conductance: float  # 1 / R_i, m³/(s Pa)
    leakage_orifice_gain: float  # K_i, m³/(s √Pa)
    external_conductance: float  # 1 / R_e, m³/(s Pa)
    position_weight: float  # 1 / size of each state, in which the integrator measures its errors
    velocity_weight: float
    pressure_weight: float
    spool_velocity_weight: float
    coil_current_weight: float
    gas_volume_weight: float
    bristle_weight: float


@inline
def coefficients(p):
    """:class:`Coefficients` of the physical parameters ``p`` (:class:`Physical`)."""
    bore = 0.25 * math.pi * p.cylinder_bore_diameter**2
    area_a = bore - 0.25 * math.pi * p.cylinder_rod_diameter_a**2
    area_b = bore - 0.25 * math.pi * p.cylinder_rod_diameter**2
    edge_gain = p.valve_rated_flow / math.sqrt(0.5 * p.valve_rated_pressure_drop)  # (3), K alone
    ideal_drive = 1.0 if p.valve_model >= 1.0 else 0.0
    ideal_spool = 1.0 if p.valve_model == 2.0 else 0.0
    has_bristles = 1.0 if p.friction_model == 3.0 else 0.0
    has_friction = 0.0 if p.friction_model == 0.0 else 1.0
    has_stribeck = 1.0 if p.friction_model >= 2.0 else 0.0
    supply_dynamics = p.supply_polytropic_index if p.supply_model == 1.0 else 0.0
    line_stiffness = p.fluid_bulk_modulus / p.supply_line_volume if p.supply_model == 2.0 else 0.0
    return Coefficients(
        area_a,
        area_b,
        p.cylinder_dead_volume + area_a * 0.5 * p.cylinder_stroke,
        p.cylinder_dead_volume + area_b * 0.5 * p.cylinder_stroke,
        edge_gain,
        p.valve_transition_pressure**2,
        p.valve_underlap**2,
        p.valve_natural_frequency**2,
        2.0 * p.valve_damping_ratio * p.valve_natural_frequency,
        p.valve_slew_limit,
        p.valve_coil_resistance / p.valve_coil_inductance,
        p.valve_amplifier_gain / p.valve_coil_inductance,
        p.valve_spool_gain,
        ideal_drive,
        ideal_spool,
        p.fluid_bulk_modulus,
        1.0 - p.fluid_air_fraction,
        p.fluid_air_fraction * ATMOSPHERIC_PRESSURE,
        1.0 / (p.load_mass + p.cylinder_piston_mass),
        p.load_spring_stiffness,
        p.load_viscous_damping,
        p.load_external_force,
        has_friction * p.friction_coulomb_force,
        has_stribeck * (p.friction_breakaway_force - p.friction_coulomb_force),
        has_bristles,
        p.friction_bristle_stiffness,
        p.friction_bristle_damping,
        1.0 / p.friction_stribeck_velocity,
        1.0 / p.friction_transition_velocity,
        0.5 * p.cylinder_stroke,
        p.cylinder_end_stop_stiffness,
        p.cylinder_end_stop_damping,
        p.supply_tank_pressure,
        p.supply_pressure,
        p.supply_relief_slope,
        p.supply_pump_flow,
        supply_dynamics,
        line_stiffness,
        1.0 / p.leakage_internal_resistance,
        p.leakage_orifice_gain,
        1.0 / p.leakage_external_resistance,
        # Sizes: half the stroke; a third of the speed without load and of the supply pressure, which swing about their
        # mean; slew limit and full current ten times, as errors of the valve die out within milliseconds; the
        # accumulator; the deflection at breakaway.
        2.0 / p.cylinder_stroke,
        3.0 * area_a / (edge_gain * math.sqrt(0.5 * p.supply_pressure)),
        3.0 / p.supply_pressure,
        0.1 / p.valve_slew_limit,
        0.1 * p.valve_coil_resistance / (10.0 * p.valve_amplifier_gain),
        1.0 / p.supply_accumulator_volume,
        p.friction_bristle_stiffness / max(p.friction_breakaway_force, 1e-3),
    )


@inline
def smooth_root(pressure_drop, transition_squared):
    """S(dp) = dp / (dp² + dp_t²)^(1/4): signed root of a pressure drop, laminar near zero (√Pa)."""
    return pressure_drop * inverse_fourth_root(pressure_drop * pressure_drop + transition_squared)


@inline
def inverse_fourth_root(x):
    """x^(−1/4), to 4e-14: roots in single precision, made exact by one Newton step (a third faster than in double)."""
    y = np.float64(np.float32(1.0) / math.sqrt(math.sqrt(np.float32(x))))
    squared = y * y
    return y * (1.25 - 0.25 * x * (squared * squared))


@inline
def edge_openings(spool_position, underlap_squared):
    """Openings (P→A and B→T, A→T and P→B) of the four edges, 1 = full; zero-lapped for x_0 = 0."""
    width = math.sqrt(spool_position * spool_position + underlap_squared)
    return 0.5 * (width + spool_position), 0.5 * (width - spool_position)


@inline
def edge_flows(s, c):
    """Flows in m³/s through the edges P→A, A→T, B→T, P→B; (2), (3) and (18) for both spool directions."""
    forward, backward = edge_openings(s.spool_position, c.underlap_squared)
    return (
        c.edge_gain * forward * smooth_root(s.supply_pressure - s.pressure_a, c.transition_squared),
        c.edge_gain * backward * smooth_root(s.pressure_a - c.tank_pressure, c.transition_squared),
        c.edge_gain * forward * smooth_root(s.pressure_b - c.tank_pressure, c.transition_squared),
        c.edge_gain * backward * smooth_root(s.supply_pressure - s.pressure_b, c.transition_squared),
    )


@inline
def internal_leakage(s, c):
    """Q_i in m³/s from chamber a to b: laminar (10) plus orifice, the throttle in parallel of the rig."""
    difference = s.pressure_a - s.pressure_b
    return c.leakage_conductance * difference + c.leakage_orifice_gain * smooth_root(difference, c.transition_squared)


@inline
def external_leakage(s, c):
    """Q_e in m³/s from chamber b to ambient (11)."""
    return c.external_conductance * s.pressure_b


@inline
def pressure_rate(net_flow, volume, pressure, c):
    """dP/dt = β_eff / V · net_flow of one chamber (8), (9), (12), (13), in Pa/s.

    1/β_eff = 1/β + η p_atm / {[(1−η) p_abs + η p_atm] p_abs}: oil with isothermally compressed free air.
    Below the vapour pressure the chamber cavitates: its pressure falls no further.
    """
    absolute = max(pressure, VAPOUR_PRESSURE) + ATMOSPHERIC_PRESSURE
    oil = (c.dissolved_ratio * absolute + c.free_air_pressure) * absolute
    rate = net_flow * c.bulk_modulus * oil / (volume * (oil + c.bulk_modulus * c.free_air_pressure))
    return rate if pressure > VAPOUR_PRESSURE else max(rate, 0.0)


@inline
def friction(velocity, bristle_deflection, c):
    """Friction force F_f in N and rate of the bristle deflection in m/s.

    Without bristles F_f = g(v) s(v), with g(v) = F_c + (F_st − F_c)/(1 + (v/v_st)²) and s a smooth sign (Hess & Soom
    1990). LuGre (Canudas de Wit et al. 1995), with the same g: dz/dt = v − σ_0 |v| z / g(v), F_f = σ_0 z + σ_1 dz/dt;
    the viscous part is the c v of the load.
    """
    slip = velocity * c.inverse_stribeck_velocity
    ratio = velocity * c.inverse_transition_velocity
    lubrication = 1.0 + slip * slip
    sliding = c.coulomb_force * lubrication + c.stribeck_force  # g(v) times lubrication
    steady = sliding * ratio / (lubrication * math.sqrt(1.0 + ratio * ratio))
    rate = velocity - c.bristle_stiffness * abs(velocity) * bristle_deflection * lubrication / sliding
    bristles = c.bristle_stiffness * bristle_deflection + c.bristle_damping * rate
    return (bristles if c.has_bristles > 0.0 else steady), (rate if c.has_bristles > 0.0 else 0.0)


@inline
def end_stop_force(position, velocity, c):
    """F_stop in N: stiff spring and damper beyond ± stroke/2 that only push, never pull."""
    beyond_out = max(position - c.end_stop_position, 0.0)
    beyond_in = max(-position - c.end_stop_position, 0.0)
    push_out = max(c.end_stop_stiffness * beyond_out + c.end_stop_damping * velocity, 0.0)
    push_in = max(c.end_stop_stiffness * beyond_in - c.end_stop_damping * velocity, 0.0)
    return (push_out if beyond_out > 0.0 else 0.0) - (push_in if beyond_in > 0.0 else 0.0)


@inline
def acceleration(s, c):
    """dv_d/dt in m/s²: (14), (17) with the friction that (18) drops."""
    force = s.pressure_a * c.area_a - s.pressure_b * c.area_b
    friction_force, _ = friction(s.velocity, s.bristle_deflection, c)
    resisting = (
        c.spring_stiffness * s.position
        + c.viscous_damping * s.velocity
        + friction_force
        + end_stop_force(s.position, s.velocity, c)
        + c.external_force
    )
    return (force - resisting) * c.inverse_mass


@inline
def derivatives(s, c, voltage):
    """Time derivative of the whole state: (18), corrected and completed.

    Args:
        s: state (:class:`State`).
        c: coefficients of the plant (:class:`Coefficients`).
        voltage: command to the valve drive, V.

    Returns:
        The derivative of every state, as a :class:`State`, per second.
    """
    # Valve drive and spool: (1), (18) rows 5 to 7, with the limits of slew and stroke.
    current_rate = c.drive_rate * voltage - c.coil_rate * s.coil_current
    spool_rate = min(max(s.spool_velocity, -c.slew_limit), c.slew_limit)
    spool_rate = min(spool_rate, 0.0) if s.spool_position >= 1.0 else spool_rate
    spool_rate = max(spool_rate, 0.0) if s.spool_position <= -1.0 else spool_rate
    spool_acceleration = (
        c.spool_stiffness * (c.spool_gain * s.coil_current - s.spool_position) - c.spool_damping * s.spool_velocity
    )
    spool_acceleration = min(spool_acceleration, 0.0) if s.spool_velocity >= c.slew_limit else spool_acceleration
    spool_acceleration = max(spool_acceleration, 0.0) if s.spool_velocity <= -c.slew_limit else spool_acceleration

    # Flows: (2), (3), (10), (11).
    supply_to_a, a_to_tank, b_to_tank, supply_to_b = edge_flows(s, c)
    flow_a = supply_to_a - a_to_tank
    flow_b = b_to_tank - supply_to_b
    leakage = internal_leakage(s, c)

    # Chambers: (12), (13).
    volume_a = c.volume_a0 + c.area_a * s.position
    volume_b = c.volume_b0 - c.area_b * s.position
    net_a = flow_a - c.area_a * s.velocity - leakage
    net_b = -flow_b + c.area_b * s.velocity + leakage - external_leakage(s, c)

    # Supply: pump, relief valve, and accumulator or oil in the line (Figs 3 and 11). Both stiffnesses are 0 with a
    # constant supply.
    relief = c.relief_slope * max(s.supply_pressure - c.relief_pressure, 0.0)
    surplus = c.pump_flow - (supply_to_a + supply_to_b) - relief
    gas_stiffness = c.supply_dynamics * (s.supply_pressure + ATMOSPHERIC_PRESSURE) / s.gas_volume
    supply_rate = (gas_stiffness + c.line_stiffness) * surplus
    gas_rate = -surplus if c.supply_dynamics > 0.0 else 0.0
    _, bristle_rate = friction(s.velocity, s.bristle_deflection, c)

    return State(
        s.velocity,
        acceleration(s, c),
        pressure_rate(net_a, volume_a, s.pressure_a, c),
        pressure_rate(net_b, volume_b, s.pressure_b, c),
        spool_rate,
        spool_acceleration,
        current_rate,
        supply_rate,
        gas_rate,
        bristle_rate,
    )


@inline
def command_changed(s, c, voltage):
    """The state when a new command begins to act: what follows it at once (an ideal drive, an ideal spool) has."""
    current = c.drive_rate * voltage / c.coil_rate if c.ideal_drive > 0.0 else s.coil_current
    spool = min(max(c.spool_gain * current, -1.0), 1.0) if c.ideal_spool > 0.0 else s.spool_position
    return State(
        s.position,
        s.velocity,
        s.pressure_a,
        s.pressure_b,
        spool,
        0.0 if c.ideal_spool > 0.0 else s.spool_velocity,
        current,
        s.supply_pressure,
        s.gas_volume,
        s.bristle_deflection,
    )


class Rates(NamedTuple):
    """Upper estimates of the rates |λ| in 1/s of the parts of the axis."""

    chamber_a: float  # an edge or a leak relaxes chamber a
    chamber_b: float  # and chamber b
    friction: float  # friction within its transition velocity, and viscous damping
    oil_column: float  # oil column and spring against the mass
    end_stop: float
    valve: float  # spool and coil
    supply_line: float  # pump and relief valve on the oil in the line


@inline
def rates(s, c):
    """:class:`Rates` near a state: slope of S at zero drop, edges fully open, oil without air."""
    margin = 2e-3  # m; further than the piston goes within one control period
    volume_a = max(c.volume_a0 + c.area_a * (s.position - margin), 0.2 * (c.volume_a0 - c.area_a * c.end_stop_position))
    volume_b = max(c.volume_b0 - c.area_b * (s.position + margin), 0.2 * (c.volume_b0 - c.area_b * c.end_stop_position))
    slope = 1.0 / math.sqrt(math.sqrt(c.transition_squared))
    leak = c.leakage_conductance + c.leakage_orifice_gain * slope
    steady_friction = (1.0 - c.has_bristles) * (c.coulomb_force + c.stribeck_force) * c.inverse_transition_velocity
    oil_column = c.bulk_modulus * (c.area_a * c.area_a / volume_a + c.area_b * c.area_b / volume_b)
    return Rates(
        c.bulk_modulus / volume_a * (c.edge_gain * slope + leak),
        c.bulk_modulus / volume_b * (c.edge_gain * slope + leak + c.external_conductance),
        (steady_friction + c.viscous_damping + c.bristle_damping * c.has_bristles) * c.inverse_mass
        + c.has_bristles * c.bristle_stiffness * abs(s.velocity) / max(c.coulomb_force, 1e-300),
        math.sqrt((oil_column + c.spring_stiffness + c.has_bristles * c.bristle_stiffness) * c.inverse_mass),
        c.end_stop_damping * c.inverse_mass + math.sqrt(c.end_stop_stiffness * c.inverse_mass),
        max(math.sqrt(c.spool_stiffness) + c.spool_damping, c.coil_rate),
        c.line_stiffness * (c.relief_slope + 2.0 * c.edge_gain * slope),
    )


@inline
def fastest_rate(s, c):
    """Upper estimate of the fastest rate |λ| in 1/s near a state, which bounds a stable inner step (``workable``)."""
    r = rates(s, c)
    slower = max(max(r.friction, r.oil_column), max(r.end_stop, max(r.valve, r.supply_line)))
    return max(max(r.chamber_a, r.chamber_b), slower)
