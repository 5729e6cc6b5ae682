"""The load that the rod moves: mass, spring, damper, end stops; (14), (17)."""

from typing import NamedTuple

from hydro_env.compiling import inline, merged
from hydro_env.files import Group
from hydro_env.plant.states import TipState
from hydro_env.units import Number, quantity


class Load(Group):
    """Mass, spring and damper that the rod moves; a share of the mass may hang behind a spring (boom, frame, rope)."""

    mass: Number = quantity(60.0, "kg", "paper, Table 1", 0.01, 1e6)
    spring_stiffness: Number = quantity(89e3, "N/m", "paper, Table 1 (89 N/mm)", 0.0, 1e9)
    viscous_damping: Number = quantity(300.0, "N s/m", "assumed; load and seals", 0.0, 1e7)
    external_force: Number = quantity(0.0, "N", "assumed; positive against extension", -1e7, 1e7)
    tip_share: Number = quantity(0.0, "1", "assumed; share of the mass behind a spring, 0: a rigid load", 0.0, 0.99)
    tip_frequency: Number = quantity(60.0, "rad/s", "assumed; of that share while the piston stands", 1.0, 1e4)
    tip_damping_ratio: Number = quantity(0.02, "1", "assumed; of that oscillation", 0.0, 1.0)


class LoadCoefficients(NamedTuple):
    """Constants of the load in the right-hand side."""

    inverse_mass: float  # 1 / (M + m_d), 1/kg
    spring_stiffness: float  # k, N/m
    viscous_damping: float  # c, N s/m
    external_force: float  # F_ext, N
    end_stop_position: float  # L / 2, m
    end_stop_stiffness: float  # N/m
    end_stop_damping: float  # N s/m
    tip_mass: float  # kg, behind the spring
    tip_stiffness: float  # ω², 1/s², of that spring, per mass
    tip_damping: float  # 2 ζ ω, 1/s


@inline
def load_coefficients(p):
    """:class:`LoadCoefficients` of the physical parameters ``p``."""
    return LoadCoefficients(
        inverse_mass=1.0 / (p.load_mass * (1.0 - p.load_tip_share) + p.cylinder_piston_mass),
        spring_stiffness=p.load_spring_stiffness,
        viscous_damping=p.load_viscous_damping,
        external_force=p.load_external_force,
        end_stop_position=0.5 * p.cylinder_stroke,
        end_stop_stiffness=p.cylinder_end_stop_stiffness,
        end_stop_damping=p.cylinder_end_stop_damping,
        tip_mass=p.load_mass * p.load_tip_share,
        tip_stiffness=p.load_tip_frequency**2,
        tip_damping=2.0 * p.load_tip_damping_ratio * p.load_tip_frequency,
    )


@inline
def piston_force(pressure_a, pressure_b, c):
    """Force P_a A_a − P_b A_b of the oil on the piston, N."""
    return pressure_a * c.area_a - pressure_b * c.area_b


@inline
def holding_force(position, c):
    """Force in N that holds the load at rest at a position: against spring and external force."""
    return c.spring_stiffness * position + c.external_force


@inline
def balancing_pressure_b(pressure_a, force, c):
    """Pressure of chamber b in Pa at which the piston exerts a force (N): :func:`piston_force` solved for it."""
    return (pressure_a * c.area_a - force) / c.area_b


@inline
def end_stop_force(position, velocity, c):
    """F_stop in N: stiff spring and damper beyond ± stroke/2 that only push, never pull."""
    beyond_out = max(position - c.end_stop_position, 0.0)
    beyond_in = max(-position - c.end_stop_position, 0.0)
    push_out = max(c.end_stop_stiffness * beyond_out + c.end_stop_damping * velocity, 0.0)
    push_in = max(c.end_stop_stiffness * beyond_in - c.end_stop_damping * velocity, 0.0)
    return (push_out if beyond_out > 0.0 else 0.0) - (push_in if beyond_in > 0.0 else 0.0)


@inline
def acceleration(s, friction_force, c):
    """dv_d/dt in m/s²: (14), (17) with the friction that (18) drops, and with the pull of a second mass added to it."""
    resisting = (
        c.spring_stiffness * s.position
        + c.viscous_damping * s.velocity
        + friction_force
        + end_stop_force(s.position, s.velocity, c)
        + c.external_force
    )
    return (piston_force(s.pressure_a, s.pressure_b, c) - resisting) * c.inverse_mass


class TipLaws(NamedTuple):
    """What the right-hand side asks of the load; a rigid load and one with a second mass answer."""

    resistance: object  # (friction_force, s, c) → friction plus the pull of the second mass, N
    rates: object  # (s, c) → derivative of the TipState
    weights: object  # (c) → error weight of each of these states


RIGID_LOAD = TipLaws(
    resistance=merged("friction_alone", "friction_force, s, c", "friction_force"),
    rates=merged("no_tip_rates", "s, c", "0.0"),
    weights=merged("no_tip_weights", "c", "0.0"),
)


@inline
def _tip_acceleration(s, c):
    return c.tip_stiffness * (s.position - s.tip_position) + c.tip_damping * (s.velocity - s.tip_velocity)


@inline
def _friction_and_pull(friction_force, s, c):
    return friction_force + c.tip_mass * _tip_acceleration(s, c)


@inline
def _tip_rates(s, c):
    return TipState(s.tip_velocity, _tip_acceleration(s, c))


@inline
def _tip_weights(c):
    return TipState(c.position_weight, c.velocity_weight)


SECOND_MASS = TipLaws(_friction_and_pull, _tip_rates, _tip_weights)
"""A part of the load hangs on the rest by spring and damper; the position sensor is at the piston."""
