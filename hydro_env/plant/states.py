"""The states of one axis: this table alone lists their names, units, typical sizes and valid ranges.

Everything else follows from the table: the layout of arrays, the error weights of the integrator, trajectories, tests.
SI units, gauge pressures.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, get_type_hints

import numpy as np

from hydro_env.compiling import inline, tuple_first
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

ATMOSPHERIC_PRESSURE = 101_325.0
"""Pa; the zero of gauge pressures."""

VAPOUR_PRESSURE = -0.9e5
"""Pa, gauge; a chamber cavitates at this pressure, which is the lowest possible."""


class StateInfo(NamedTuple):
    """Unit, typical size and error weight of a state."""

    unit: str
    typical: float  # size; absolute tolerances and finite differences are relative to it
    emphasis: float = 1.0  # weight of its error in the integrator, relative to its full scale


class State(NamedTuple):
    """State of one axis, or its time derivative."""

    # Position 0 is mid-stroke; + extends.
    position: Annotated[float, StateInfo("m", 0.1)]
    # Speed and pressures swing about their mean by a third of their full scale.
    velocity: Annotated[float, StateInfo("m/s", 0.1, emphasis=3.0)]
    pressure_a: Annotated[float, StateInfo("Pa", 1e6, emphasis=3.0)]  # bore side
    pressure_b: Annotated[float, StateInfo("Pa", 1e6, emphasis=3.0)]  # rod side
    # At 1 the valve is fully open; + opens P to A.
    spool_position: Annotated[float, StateInfo("1", 1.0)]
    # Errors of spool speed and current decay within milliseconds.
    spool_velocity: Annotated[float, StateInfo("1/s", 10.0, emphasis=0.1)]
    coil_current: Annotated[float, StateInfo("A", 1.0, emphasis=0.1)]
    supply_pressure: Annotated[float, StateInfo("Pa", 1e6, emphasis=3.0)]
    gas_volume: Annotated[float, StateInfo("m³", 1e-3)]  # of the accumulator
    # Deflection of the seal before it slides; moves with LuGre friction only.
    bristle_deflection: Annotated[float, StateInfo("m", 1e-5)]


STATES: dict[str, StateInfo] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(State, include_extras=True).items()
}
STATE_NAMES = State._fields
STATE_UNITS = tuple(info.unit for info in STATES.values())
N_STATES = len(STATES)
TYPICAL_SIZE: Floats = np.array([info.typical for info in STATES.values()])
EMPHASIS: Floats = np.array([info.emphasis for info in STATES.values()])


first_outside = tuple_first(State, "not (lowest.{name} <= s.{name} <= highest.{name})", "s, lowest, highest")
"""``first_outside(s, lowest, highest)``: index of the first state outside a range (or not a number), −1 for none."""


@inline
def error_weights(p, c):
    """Weight of each state's error in the integrator: emphasis divided by full scale, as a :class:`State`.

    Full scale: half the stroke, speed without load, supply pressure, slew limit, current at 10 V, volume of the
    accumulator, deflection at breakaway.

    Args:
        p: physical parameters (:data:`~hydro_env.plant.parameters.Physical`).
        c: coefficients of the parts of the same plant.
    """
    pressure = 3.0 / p.supply_pressure
    return State(
        position=2.0 / p.cylinder_stroke,
        velocity=3.0 * c.area_a / (c.edge_gain * math.sqrt(0.5 * p.supply_pressure)),
        pressure_a=pressure,
        pressure_b=pressure,
        spool_position=1.0,
        spool_velocity=0.1 / p.valve_slew_limit,
        coil_current=0.1 * p.valve_coil_resistance / (FULL_VOLTAGE * p.valve_amplifier_gain),
        supply_pressure=pressure,
        gas_volume=1.0 / p.supply_accumulator_volume,
        bristle_deflection=p.friction_bristle_stiffness / max(p.friction_breakaway_force, 1e-3),
    )


@inline
def valid_range(c):
    """Lowest and highest state for which the model is valid, two :class:`State`.

    A steel cylinder withstands no more than 2000 bar; the accumulator must hold gas and oil; the piston may enter an
    end stop by half the depth that the dead volume allows.

    Args:
        c: coefficients of the plant (:class:`~hydro_env.plant.equations.Coefficients`).
    """
    stop = c.end_stop_position
    dead_volume = min(c.volume_a0 - c.area_a * stop, c.volume_b0 - c.area_b * stop)
    reach = c.end_stop_position + 0.5 * dead_volume / max(c.area_a, c.area_b)
    slew = c.slew_limit * (1.0 + 1e-9)
    floor, ceiling = VAPOUR_PRESSURE * (1.0 + 1e-9), 2e8
    lowest = State(
        position=-reach,
        velocity=-20.0,
        pressure_a=floor,
        pressure_b=floor,
        spool_position=-1.000000001,
        spool_velocity=-slew,
        coil_current=-1e4,
        supply_pressure=floor,
        gas_volume=1e-12,
        bristle_deflection=-1.0,
    )
    highest = State(
        position=reach,
        velocity=20.0,
        pressure_a=ceiling,
        pressure_b=ceiling,
        spool_position=1.000000001,
        spool_velocity=slew,
        coil_current=1e4,
        supply_pressure=ceiling,
        gas_volume=c.accumulator_volume * 1.001 if c.supply_dynamics > 0.0 else 1e300,
        bristle_deflection=1.0,
    )
    return lowest, highest
