"""The 4/3 servo valve: drive coil, spool, and the four metering edges; (1) to (3) and (18), rows 5 to 7."""

import math
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from hydro_env.compiling import inline
from hydro_env.files import Group
from hydro_env.plant.kinks import FAR, time_to_cover
from hydro_env.units import Number, quantity

ValveModel = Literal["drive", "spool", "ideal"]
"""Which parts of the valve have dynamics; each later model has fewer."""


class Valve(Group):
    """4/3 servo valve with its drive: flow edges, second-order spool, coil.

    ``model``: ``drive`` (coil and spool), ``spool`` (an ideal drive: the current follows the command at once),
    ``ideal`` (the spool follows at once).
    """

    model: ValveModel = Field("drive", description="paper, eqs (1) and (18)")
    rated_flow: Number = quantity(10e-3 / 60, "m³/s", "paper, Table 1 (10 l/min)", 1e-7, 0.1)
    rated_pressure_drop: Number = quantity(70e5, "Pa", "paper, Table 1; over both edges", 1e4, 1e8)
    natural_frequency: Number = quantity(500.0, "rad/s", "assumed (80 Hz)", 1.0, 1e4)
    damping_ratio: Number = quantity(0.8, "1", "assumed", 0.05, 5.0)
    slew_limit: Number = quantity(100.0, "1/s", "assumed; full stroke in 10 ms", 0.1, 1e5)
    underlap: Number = quantity(
        0.015, "1", "assumed; rounding of the edges: opening at the null, of full spool stroke; 0 = sharp", 0.0, 0.5
    )
    null_shift: Number = quantity(
        0.0, "1", "none in a new valve; spool position at which the edges are centred, of full stroke", -0.5, 0.5
    )
    overlap: Number = quantity(
        0.0,
        "1",
        "assumed; lap to each side of the null, of full spool stroke: a dead band; negative: all edges open there",
        -0.3,
        0.5,
    )
    knee_position: Number = quantity(0.5, "1", "assumed; stroke after the dead band where the flow bends", 0.01, 0.99)
    knee_opening: Number = quantity(0.5, "1", "assumed; opening there; equal to knee_position: straight", 0.01, 0.99)
    edge_ratio: Number = quantity(1.0, "1", "assumed; edges of chamber b over those of a; 0.5 for 2 : 1", 0.05, 20.0)
    coil_resistance: Number = quantity(2.5, "Ω", "assumed", 1e-3, 1e5)
    coil_inductance: Number = quantity(2.5e-3, "H", "assumed; with the drive's current loop", 1e-6, 100.0)
    amplifier_gain: Number = quantity(0.625, "V/V", "assumed", 1e-6, 1e6)
    spool_gain: Number = quantity(0.4, "1/A", "assumed; with the two above: full stroke at 10 V", 1e-6, 1e6)
    transition_pressure: Number = quantity(1e5, "Pa", "assumed; laminar to turbulent flow", 1.0, 1e7)


class EdgeCoefficients(NamedTuple):
    """Constants of the metering edges in the right-hand side."""

    edge_gain: float  # K, m³/(s √Pa), of chamber a
    edge_ratio: float  # edges of chamber b over those of chamber a
    transition_squared: float  # dp_t², Pa²
    underlap_squared: float  # x_0²
    null_shift: float  # x_n
    overlap: float  # x_d
    stroke_factor: float  # 1/(1 − x_d)
    knee_position: float
    slope: float  # of the opening before the knee
    slope_change: float  # at the knee


class ValveCoefficients(NamedTuple):
    """Constants of spool and drive in the right-hand side."""

    spool_stiffness: float  # ω_s², 1/s²
    spool_damping: float  # 2 ζ_s ω_s, 1/s
    slew_limit: float  # 1/s
    coil_rate: float  # R_C / L_C, 1/s
    drive_rate: float  # K_a / L_C, A/(s V)
    spool_gain: float  # k_t, 1/A
    ideal_drive: float  # 1 if the coil current follows the command at once
    ideal_spool: float  # 1 if the spool follows the command at once


_DRIVE, _SPOOL, _IDEAL = range(3)  # numbers of the models


@inline
def edge_coefficients(p):
    """:class:`EdgeCoefficients` of the physical parameters ``p``."""
    slope = p.valve_knee_opening / p.valve_knee_position
    return EdgeCoefficients(
        edge_gain=p.valve_rated_flow / math.sqrt(0.5 * p.valve_rated_pressure_drop),  # (3), K alone
        edge_ratio=p.valve_edge_ratio,
        transition_squared=p.valve_transition_pressure**2,
        underlap_squared=p.valve_underlap**2,
        null_shift=p.valve_null_shift,
        overlap=p.valve_overlap,
        stroke_factor=1.0 / (1.0 - p.valve_overlap),
        knee_position=p.valve_knee_position,
        slope=slope,
        slope_change=(1.0 - p.valve_knee_opening) / (1.0 - p.valve_knee_position) - slope,
    )


@inline
def valve_coefficients(p):
    """:class:`ValveCoefficients` of the physical parameters ``p``."""
    return ValveCoefficients(
        spool_stiffness=p.valve_natural_frequency**2,
        spool_damping=2.0 * p.valve_damping_ratio * p.valve_natural_frequency,
        slew_limit=p.valve_slew_limit,
        coil_rate=p.valve_coil_resistance / p.valve_coil_inductance,
        drive_rate=p.valve_amplifier_gain / p.valve_coil_inductance,
        spool_gain=p.valve_spool_gain,
        ideal_drive=0.0 if p.valve_model == _DRIVE else 1.0,
        ideal_spool=1.0 if p.valve_model == _IDEAL else 0.0,
    )


@inline
def smooth_root(pressure_drop, transition_squared):
    """S(dp) = dp / (dp² + dp_t²)^(1/4): signed root of a pressure drop, laminar near zero (√Pa)."""
    return pressure_drop * _inverse_fourth_root(pressure_drop * pressure_drop + transition_squared)


@inline
def _inverse_fourth_root(x):
    """x^(−1/4), error 4e-14: roots in single precision plus one Newton step (a third faster than in double)."""
    y = np.float64(np.float32(1.0) / math.sqrt(math.sqrt(np.float32(x))))
    squared = y * y
    return y * (1.25 - 0.25 * x * (squared * squared))


@inline
def _edge_opening(stroke, c):
    """Opening of an edge, 1 = full, whose land has moved by ``stroke`` from the null, beyond its overlap."""
    beyond = (stroke - c.overlap) * c.stroke_factor
    opening = 0.5 * (math.sqrt(beyond * beyond + c.underlap_squared) + beyond)
    return c.slope * opening + c.slope_change * max(beyond - c.knee_position, 0.0)


@inline
def edge_openings(spool_position, c):
    """Openings (P→A and B→T, A→T and P→B) of the four edges, 1 = full; zero-lapped for x_0 = 0 and no overlap.

    The edges are centred at the spool position ``null_shift``; the spool's sensor reads the spool itself.
    """
    opening = spool_position - c.null_shift
    return _edge_opening(opening, c), _edge_opening(-opening, c)


class EdgeFlows(NamedTuple):
    """Flows through the four edges in their working direction, m³/s."""

    supply_to_a: float
    a_to_tank: float
    b_to_tank: float
    supply_to_b: float


@inline
def edge_flows(s, c):
    """:class:`EdgeFlows` at a state; (2), (3) and (18) for both spool directions."""
    forward, backward = edge_openings(s.spool_position, c)
    return EdgeFlows(
        supply_to_a=c.edge_gain * forward * smooth_root(s.supply_pressure - s.pressure_a, c.transition_squared),
        a_to_tank=c.edge_gain * backward * smooth_root(s.pressure_a - c.tank_pressure, c.transition_squared),
        b_to_tank=c.edge_ratio
        * c.edge_gain
        * forward
        * smooth_root(s.pressure_b - c.tank_pressure, c.transition_squared),
        supply_to_b=c.edge_ratio
        * c.edge_gain
        * backward
        * smooth_root(s.supply_pressure - s.pressure_b, c.transition_squared),
    )


@inline
def current_rate(s, c, voltage):
    """di/dt in A/s of the coil (1)."""
    return c.drive_rate * voltage - c.coil_rate * s.coil_current


@inline
def spool_pull(s, c):
    """Acceleration of the spool without its slew limit, 1/s²; linear in the state, so it maps rates to the jerk too."""
    return c.spool_stiffness * (c.spool_gain * s.coil_current - s.spool_position) - c.spool_damping * s.spool_velocity


@inline
def spool_rates(s, c):
    """Speed (1/s) and acceleration (1/s²) of the spool within slew limit and stroke."""
    rate = min(max(s.spool_velocity, -c.slew_limit), c.slew_limit)
    rate = min(rate, 0.0) if s.spool_position >= 1.0 else rate
    rate = max(rate, 0.0) if s.spool_position <= -1.0 else rate
    acceleration = spool_pull(s, c)
    acceleration = min(acceleration, 0.0) if s.spool_velocity >= c.slew_limit else acceleration
    acceleration = max(acceleration, 0.0) if s.spool_velocity <= -c.slew_limit else acceleration
    return rate, acceleration


@inline
def after_command(s, c, voltage):
    """Spool position, spool speed and current just after a new command; ideal parts have jumped to it."""
    current = c.drive_rate * voltage / c.coil_rate if c.ideal_drive > 0.0 else s.coil_current
    spool = min(max(c.spool_gain * current, -1.0), 1.0) if c.ideal_spool > 0.0 else s.spool_position
    return spool, 0.0 if c.ideal_spool > 0.0 else s.spool_velocity, current


@inline
def holding_command(spool_position, c):
    """Coil current (A) and voltage (V) that hold the spool at a position."""
    current = spool_position / c.spool_gain
    return current, current * c.coil_rate / c.drive_rate


@inline
def spool_within_limits(s, c):
    """Spool position and speed, limited to the stroke and the slew limit."""
    return min(max(s.spool_position, -1.0), 1.0), min(max(s.spool_velocity, -c.slew_limit), c.slew_limit)


@inline
def time_to_spool_kink(s, rate, c):
    """Time in s until the spool meets or leaves its slew limit or its stroke, extrapolated."""
    direction = 1.0 if s.spool_velocity >= 0.0 else -1.0
    pull, jerk = spool_pull(s, c), spool_pull(rate, c)
    to_slew = c.slew_limit - direction * s.spool_velocity
    slewing = to_slew <= 0.0
    # A slewing spool leaves the limit when its pull has fallen to zero; a slower one meets the limit.
    fading = -c.coil_rate * c.spool_stiffness * c.spool_gain * rate.coil_current
    slew = time_to_cover(
        direction * pull if slewing else to_slew,
        -direction * jerk if slewing else direction * pull,
        -direction * fading if slewing else direction * jerk,
    )
    slew = FAR if slewing and direction * pull <= 0.0 else slew
    # Likewise the stroke: the spool leaves its end when the speed reverses, and meets it after the remaining distance.
    to_end = 1.0 - direction * s.spool_position
    ended = to_end <= 0.0
    stroke = time_to_cover(
        direction * s.spool_velocity if ended else to_end,
        -direction * rate.spool_velocity if ended else direction * s.spool_velocity,
        0.0 if ended else direction * rate.spool_velocity,
    )
    return min(slew, stroke)


SHARP = 1e-3  # of full stroke; edges with less rounding have corners that a step must not cross


@inline
def _time_to_corner(ahead, speed, change):
    return time_to_cover(ahead, speed, change) if ahead > 0.0 else FAR


@inline
def nearest_edge_kink(nearest, s, rate, c):
    """Time in s until an edge opens, closes or reaches its knee, extrapolated, if that is before ``nearest``."""
    stroke = s.spool_position - c.null_shift
    direction = 1.0 if s.spool_velocity >= 0.0 else -1.0
    knee = c.overlap + c.knee_position / c.stroke_factor
    speed, change = direction * s.spool_velocity, direction * rate.spool_velocity
    lap = min(
        _time_to_corner(direction * (-c.overlap - stroke), speed, change),
        _time_to_corner(direction * (c.overlap - stroke), speed, change),
    )
    bend = min(
        _time_to_corner(direction * (-knee - stroke), speed, change),
        _time_to_corner(direction * (knee - stroke), speed, change),
    )
    return min(nearest, min(lap, bend))
