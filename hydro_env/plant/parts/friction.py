"""Friction of seals and guides: none, Coulomb, Stribeck or LuGre."""

import math
from typing import Literal, NamedTuple

from pydantic import Field

from hydro_env.compiling import inline
from hydro_env.files import Group, whole_group
from hydro_env.plant.kinks import FAR
from hydro_env.units import Number, quantity

FrictionModel = Literal["none", "coulomb", "stribeck", "lugre"]
"""Friction laws; each adds one effect to the law before it; Hess & Soom (1990), Canudas de Wit et al. (1995)."""


class Friction(Group):
    """Friction of seals and guides."""

    model: FrictionModel = Field("stribeck", description="assumed; Hess & Soom (1990), Canudas de Wit et al. (1995)")
    coulomb_force: Number = quantity(120.0, "N", "assumed", 0.0, 1e6)
    breakaway_force: Number = quantity(180.0, "N", "assumed", 0.0, 1e6)
    stribeck_velocity: Number = quantity(0.012, "m/s", "assumed", 1e-5, 10.0)
    transition_velocity: Number = quantity(0.0015, "m/s", "assumed; smooths the sign function", 1e-6, 1.0)
    bristle_stiffness: Number = quantity(5e6, "N/m", "assumed; lugre: seal before it slides", 1e3, 1e10)
    bristle_damping: Number = quantity(1e3, "N s/m", "assumed; lugre: of the seal's deflection", 0.0, 1e7)

    @whole_group
    def _breakaway_is_the_peak(self) -> "Friction":
        if self.model == "lugre" and self.coulomb_force <= 0.0:
            raise ValueError("coulomb_force = 0 N must be above 0 with model lugre; model none has no friction")
        if self.model in ("stribeck", "lugre") and self.breakaway_force < self.coulomb_force:
            least = f"coulomb_force = {self.coulomb_force:g} N"
            raise ValueError(f"breakaway_force = {self.breakaway_force:g} N must not be below {least}")
        return self

    @property
    def largest_force(self) -> float:
        """Force in N that must be overcome to start moving."""
        if self.model == "none":
            return 0.0
        return self.coulomb_force if self.model == "coulomb" else self.breakaway_force


class FrictionCoefficients(NamedTuple):
    """Constants of the friction in the right-hand side."""

    coulomb_force: float  # F_c, N
    stribeck_force: float  # F_st − F_c, N
    has_bristles: float  # 1 with LuGre friction
    bristle_stiffness: float  # σ_0, N/m
    bristle_damping: float  # σ_1, N s/m
    inverse_stribeck_velocity: float  # 1 / v_st, s/m
    inverse_transition_velocity: float  # 1 / v_t, s/m


_, _COULOMB, _STRIBECK, _LUGRE = range(4)  # numbers of the laws


@inline
def friction_coefficients(p):
    """:class:`FrictionCoefficients` of the physical parameters ``p``."""
    has_friction = 1.0 if p.friction_model >= _COULOMB else 0.0
    has_stribeck = 1.0 if p.friction_model >= _STRIBECK else 0.0
    return FrictionCoefficients(
        coulomb_force=has_friction * p.friction_coulomb_force,
        stribeck_force=has_stribeck * (p.friction_breakaway_force - p.friction_coulomb_force),
        has_bristles=1.0 if p.friction_model == _LUGRE else 0.0,
        bristle_stiffness=p.friction_bristle_stiffness,
        bristle_damping=p.friction_bristle_damping,
        inverse_stribeck_velocity=1.0 / p.friction_stribeck_velocity,
        inverse_transition_velocity=1.0 / p.friction_transition_velocity,
    )


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
def time_to_reversal(s, rate, c):
    """Time in s to the next point of interest before the piston reverses, extrapolated.

    Near standstill dry friction changes within its transition velocity of a few mm/s; a long inner step would skip
    this change. A step therefore ends at twice that velocity, and later steps change the speed by it once each.
    """
    speed = abs(s.velocity) * c.inverse_transition_velocity
    turning = s.velocity * rate.velocity < 0.0 or speed < 2.0
    change = abs(rate.velocity) * c.inverse_transition_velocity
    return max(speed - 2.0, 1.0) / change if turning and change > 0.0 else FAR
