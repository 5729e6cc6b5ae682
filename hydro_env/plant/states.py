"""The states of one axis: this table alone lists their names, units, typical sizes and valid ranges.

Everything else follows from the table: the layout of arrays, the error weights of the integrator, trajectories, tests.
SI units, gauge pressures.
"""

import math
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from hydro_env.compiling import inline, named_tuple, tuple_first
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

ATMOSPHERIC_PRESSURE = 101_325.0  # Pa; the zero of gauge pressures
VAPOUR_PRESSURE = -0.9e5  # Pa, gauge; a chamber cavitates at this pressure, which is the lowest possible


class StateInfo(NamedTuple):
    """Unit, typical size and error weight of a state."""

    unit: str
    typical: float  # size; absolute tolerances and finite differences are relative to it
    emphasis: float = 1.0  # weight of its error in the integrator, relative to its full scale


# Speed and pressures swing about their mean by a third of their full scale.
Speed = Annotated[float, StateInfo("m/s", 0.1, emphasis=3.0)]
Pressure = Annotated[float, StateInfo("Pa", 1e6, emphasis=3.0)]
LineFlow = Annotated[float, StateInfo("m³/s", 1e-4, emphasis=3.0)]


class State(NamedTuple):
    """State of one axis, or its time derivative."""

    # Position 0 is mid-stroke; + extends.
    position: Annotated[float, StateInfo("m", 0.1)]
    velocity: Speed
    pressure_a: Pressure  # bore side
    pressure_b: Pressure  # rod side
    # At 1 the valve is fully open; + opens P to A.
    spool_position: Annotated[float, StateInfo("1", 1.0)]
    # Errors of spool speed and current decay within milliseconds.
    spool_velocity: Annotated[float, StateInfo("1/s", 10.0, emphasis=0.1)]
    coil_current: Annotated[float, StateInfo("A", 1.0, emphasis=0.1)]
    supply_pressure: Pressure
    gas_volume: Annotated[float, StateInfo("m³", 1e-3)]  # of the accumulator
    # Deflection of the seal before it slides; moves with LuGre friction only.
    bristle_deflection: Annotated[float, StateInfo("m", 1e-5)]


class LineState(NamedTuple):
    """States of lines with waves: pressure of each cell, and flow from it to the cylinder; cell 1 is at the valve."""

    line_a_pressure_1: Pressure
    line_a_pressure_2: Pressure
    line_a_pressure_3: Pressure
    line_b_pressure_1: Pressure
    line_b_pressure_2: Pressure
    line_b_pressure_3: Pressure
    line_a_flow_1: LineFlow
    line_a_flow_2: LineFlow
    line_a_flow_3: LineFlow
    line_b_flow_1: LineFlow
    line_b_flow_2: LineFlow
    line_b_flow_3: LineFlow


class TipState(NamedTuple):
    """States of a second mass behind a spring, relative to where it rests on a piston at mid-stroke."""

    tip_position: Annotated[float, StateInfo("m", 0.1)]
    tip_velocity: Speed


class Structure(NamedTuple):
    """Which parts that an axis may lack it has; compiled code is built for them, so that no axis pays for others."""

    lines: bool = False  # lines with waves, not volumes alone
    tip: bool = False  # a second mass behind a spring
    sharp_edges: bool = False  # edges of the valve with corners, which a step must not cross

    @property
    def number(self) -> int:
        """One number per structure, for the cache of compiled code."""
        return sum(2**place for place, present in enumerate(self) if present)


RIGID = Structure()


@cache
def state_kind(structure: Structure) -> Any:
    """The named tuple of an axis's states: :class:`State`, and then those of the parts that it has."""
    extra = [*LineState._fields] * structure.lines + [*TipState._fields] * structure.tip
    return named_tuple("AxisState", [*State._fields, *extra], __name__) if extra else State


COMPLETE = state_kind(Structure(lines=True, tip=True))  # the states of an axis that has every part


def _infos(*kinds: Any) -> dict[str, StateInfo]:
    hints = [get_type_hints(kind, include_extras=True) for kind in kinds]
    return {name: hint.__metadata__[0] for found in hints for name, hint in found.items()}


STATES = _infos(State)
ALL_STATES = _infos(State, LineState, TipState)  # of every part, in the order of state_kind

N_ALL_STATES = len(ALL_STATES)


@cache
def columns_of(structure: Structure) -> list[int]:
    """Place of each state of an axis with this structure among :data:`ALL_STATES`."""
    return [list(ALL_STATES).index(name) for name in state_kind(structure)._fields]


STATE_NAMES = State._fields
STATE_UNITS = tuple(info.unit for info in STATES.values())
N_STATES = len(STATES)


def typical_sizes(names: Iterable[str]) -> Floats:
    """Typical size of each of these states, (n,)."""
    return np.array([ALL_STATES[name].typical for name in names])


TYPICAL_SIZE = typical_sizes(STATE_NAMES)


first_outside = tuple_first(State, "not (lowest.{name} <= s.{name} <= highest.{name})", "s, lowest, highest")
"""``first_outside(s, lowest, highest)``: index of the first state outside a range (or not a number), −1 for none."""


@inline
def error_weights(p, c):
    """Weight of each state's error in the integrator: emphasis divided by full scale, as a :class:`State`.

    Full scale: half the stroke, speed without load, supply pressure, slew limit, current at 10 V, volume of the
    accumulator, deflection at breakaway.
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
    """
    stop = c.end_stop_position
    dead_volume = min(c.volume_a0 - c.area_a * stop, c.volume_b0 - c.area_b * stop)
    reach = stop + 0.5 * dead_volume / max(c.area_a, c.area_b)
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
