"""Can this rig work at all? The figures that make one impossible, each answered with one line."""

from __future__ import annotations

import math
from typing import NamedTuple

from hydro_env.plant.analysis import force_limits
from hydro_env.plant.arrays import coefficient_array
from hydro_env.plant.equations import Coefficients, Rates, State, rates
from hydro_env.plant.errors import ConfigurationError
from hydro_env.plant.kernel import MAXIMUM_STEP, STABLE_PRODUCT
from hydro_env.plant.parameters import PlantParameters

LEAST_TRAVEL = 1e-3
"""m; a rig that cannot move this far from where its spring is free is no servo axis."""

MOST_STEPS = 4000
"""Inner steps in 5 ms beyond which the rig's own numbers are at fault."""

STEPS_PERIOD = 5e-3
"""s; the period over which steps are counted."""

CAUSES = {
    "chamber_a": "cylinder.dead_volume, valve.transition_pressure or a leak: the oil of chamber a relaxes",
    "chamber_b": "cylinder.dead_volume, valve.transition_pressure or a leak: the oil of chamber b relaxes",
    "friction": "friction.transition_velocity or load.viscous_damping for this load.mass: friction brakes",
    "oil_column": "load.mass and cylinder.piston_mass on this oil column: they swing",
    "end_stop": "cylinder.end_stop_damping or end_stop_stiffness for this load.mass: the end stop acts",
    "valve": "valve.natural_frequency or coil_inductance: the valve acts",
    "supply_line": "supply.line_volume: pump and relief valve act on the oil in it",
}


class InnerStep(NamedTuple):
    """How finely an explicit integration must work to be stable, whatever its accuracy."""

    rate: float  # 1/s, upper estimate of the fastest |λ|
    cause: str  # field of :class:`~hydro_env.plant.equations.Rates`
    steps: int  # in STEPS_PERIOD
    step: float  # s


def inner_step(parameters: PlantParameters, position: float = 0.0) -> InnerStep:
    """Fastest rate, what causes it, and the longest stable inner step at a position (m).

    The integrator's method is stable to h·|λ| = 3.2; no step is longer than 2 ms. Most steps are shorter, by the
    tolerance of the integration.
    """
    zeros = dict.fromkeys(State._fields, 0.0)
    found = rates(State(**{**zeros, "position": position}), Coefficients(*coefficient_array(parameters)))
    cause = max(Rates._fields, key=lambda name: getattr(found, name))
    rate = float(getattr(found, cause))
    steps = max(
        math.ceil(STEPS_PERIOD / MAXIMUM_STEP - 1e-9), math.ceil(min(STEPS_PERIOD * rate / STABLE_PRODUCT, 1e15))
    )
    return InnerStep(rate, cause, steps, STEPS_PERIOD / steps)


def shortest_inner_step(parameters: PlantParameters) -> InnerStep:
    """:func:`inner_step` where it is shortest: mid-stroke or one of the ends."""
    half = 0.5 * parameters.cylinder.stroke
    return max((inner_step(parameters, position) for position in (0.0, -half, half)), key=lambda found: found.rate)


def refuse_unworkable(parameters: PlantParameters, source: str = "rig") -> None:
    """Refuse a rig that no command can move, or that no reasonable step can integrate.

    What is impossible by itself (a rod that fills the bore, a supply below tank, an accumulator that stays empty)
    :class:`~hydro_env.plant.parameters.PlantParameters` has refused already.

    Raises:
        ConfigurationError: one line with the figure that is impossible and its limit.
    """
    load, supply = parameters.load, parameters.supply
    out, back = force_limits(parameters)
    least = load.spring_stiffness * LEAST_TRAVEL
    for force, direction in ((out, "out"), (back, "in")):
        own = force + load.external_force if direction == "out" else force - load.external_force
        where = f"{supply.pressure / 1e5:g} bar give {max(own, 0.0):.4g} N {direction}"
        if own <= 0.0:
            raise ConfigurationError(
                f"{source}: supply.tank_pressure = {supply.tank_pressure / 1e5:g} bar: {where} against it on these "
                f"areas; lower it or raise supply.pressure"
            )
        if force <= 0.0:
            raise ConfigurationError(
                f"{source}: load.external_force = {load.external_force:g} N: {where}; "
                f"it must stay within {-_inward(parameters):.4g} to {_outward(parameters):.4g} N"
            )
        if least >= force:
            raise ConfigurationError(
                f"{source}: load.spring_stiffness = {load.spring_stiffness:g} N/m: {where}, which does not move it "
                f"{1e3 * LEAST_TRAVEL:g} mm; the limit is {force / LEAST_TRAVEL:.4g} N/m"
            )
    shortest = shortest_inner_step(parameters)
    if shortest.steps > MOST_STEPS:
        raise ConfigurationError(
            f"{source}: {CAUSES[shortest.cause]} at {shortest.rate:.3g} 1/s, which asks for {shortest.steps:,} inner "
            f"steps in {1e3 * STEPS_PERIOD:g} ms; the limit is {MOST_STEPS:,} "
            f"({MOST_STEPS * STABLE_PRODUCT / STEPS_PERIOD:.3g} 1/s)"
        )


def _outward(parameters: PlantParameters) -> float:
    return force_limits(parameters).extending + parameters.load.external_force


def _inward(parameters: PlantParameters) -> float:
    return force_limits(parameters).retracting - parameters.load.external_force
