"""Replays recorded commands on many plants at once and returns the readings of their sensors."""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np

from hydro_env import TaskConfig
from hydro_env.compiling import SOURCES, compiled, inline
from hydro_env.plant.arrays import N_COEFFICIENTS, read_complete_state, read_physical, write_coefficients
from hydro_env.plant.equations import Coefficients, coefficients, derivatives, parts_of
from hydro_env.plant.kernel import N_PEAKS, STEPS, Accuracy, Plants, integrators
from hydro_env.plant.parts.lines import CELLS
from hydro_env.plant.parts.supply import gas_volume_at
from hydro_env.plant.states import COMPLETE, N_ALL_STATES, RIGID, Structure
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B, SENSORS, SPOOL
from hydro_env.task.signals import lagged
from hydro_env.types import Floats, Indices
from hydro_env.units import FULL_VOLTAGE

KINDS = 2 ** len(Structure._fields)  # of structures
ROWS_PER_THREAD = 64  # smallest number of rows per thread; with fewer, starting the thread takes longer than its work
RISE = math.log(9.0)  # 10–90 % rise time of a first-order lag over its time constant
MOST_STEPS = 500.0  # inner steps between two samples; a plant that needs more could not have moved as recorded
_PLACES = COMPLETE(*range(len(COMPLETE._fields)))
_TIP_POSITION, _TIP_VELOCITY = _PLACES.tip_position, _PLACES.tip_velocity
_CURRENT, _GAS_VOLUME, _SUPPLY_PRESSURE = _PLACES.coil_current, _PLACES.gas_volume, _PLACES.supply_pressure
_LINE_PRESSURES, _LINE_FLOWS = _PLACES.line_a_pressure_1, _PLACES.line_a_flow_1

_TANK, _RELIEF, _SUPPLY_DYNAMICS, _LINE_STIFFNESS = (
    Coefficients._fields.index(name)
    for name in ("tank_pressure", "relief_pressure", "supply_dynamics", "line_stiffness")
)


class Lag(NamedTuple):
    """A transducer's lag over one interval, under the names that :func:`~hydro_env.task.signals.lagged` reads."""

    pressure_lag: float  # time constant over the interval
    pressure_decay: float  # exp(−interval over time constant)


class Commands(NamedTuple):
    """The commands of B recorded windows of T samples; see docs/leak_detection.md for the format."""

    command: Floats  # (B, T), −1 to 1; column k acts until one latency after sample k
    boundary: Floats  # (B, 2, T), recorded supply and tank pressure, Pa; NaN: those of the plant

    def beginning(self, samples: int) -> Self:
        """The first samples."""
        return type(self)(self.command[:, :samples], np.ascontiguousarray(self.boundary[:, :, :samples]))

    def part(self, windows: Indices) -> Self:
        """Some of the windows."""
        return type(self)(*(values[windows] for values in self))


class Rows(NamedTuple):
    """R plants; each replays a window."""

    window: Indices  # (R,), index of the window
    physical: Floats  # (R, parameters), in the order of PARAMETER_PATHS
    start: Floats
    """(R, states), state at the first sample; those of optional parts may be absent. NaN as coil current means the
    current of the first command, as gas volume the volume at the supply pressure, as tip that of the piston, in the
    lines a steady flow."""

    latency: Floats
    """(R,), s, from a sample until its command acts; a negative one, or one beyond the interval to the next sample,
    moves the commands by whole samples."""

    lag: Floats  # (R,), s, time constant of the pressure transducers
    course: Floats  # (R, T), Pa, added to setting and pressure of the supply
    offset: Floats  # (R, 2), Pa, of recorded supply and tank pressure: readings minus pressure


def with_all_states(start: Floats) -> Floats:
    """States (R, N_ALL_STATES), NaN those of optional parts where ``start``, (R, N_STATES), lacks them."""
    return np.pad(start, ((0, 0), (0, N_ALL_STATES - start.shape[1])), constant_values=np.nan)


def replay(
    config: TaskConfig, commands: Commands, rows: Rows, threads: int | None = None, structure: Structure = RIGID
) -> Floats:
    """Readings of R plants with a structure, without noise and bias, (R, sensors, T), in the order of ``SENSORS``.

    They are NaN after a failure of the integration. ``threads``: ``None`` takes one per core.
    """
    count, samples = len(rows.window), commands.command.shape[1]
    whole = rows._replace(start=with_all_states(np.array(rows.start, float)))
    accuracy = Accuracy(config.maximum_step, config.tolerance, MOST_STEPS)
    readings = np.full((count, len(SENSORS), samples), np.nan)
    run = _replay(structure, structure.lines and config.sensors.pressures_at == "valve")

    def part(first: int, last: int) -> None:
        run(commands, whole, config.control_period, accuracy, readings, first, last)

    parts = max(1, min(threads or os.cpu_count() or 1, count // ROWS_PER_THREAD))
    if parts == 1:
        part(0, count)
        return readings
    ends = [count * number // parts for number in range(parts + 1)]
    with ThreadPoolExecutor(parts, thread_name_prefix="estimation") as pool:
        list(pool.map(part, ends[:-1], ends[1:]))
    return readings


@inline
def sense(s: Any, sensed: Floats, reading: Floats) -> None:
    """Write what the sensors read in the states ``s``; ``sensed``: the signals of the pressure transducers."""
    reading[POSITION] = s.position
    reading[PRESSURE_A] = sensed[0]
    reading[PRESSURE_B] = sensed[1]
    reading[SPOOL] = s.spool_position


@inline
def as_it_is(s: Any) -> Any:
    """The chambers, where the transducers usually sit."""
    return s


@inline
def begin(own: Floats, coefficient: Floats, physical: Floats, volts: float, supply: float) -> Any:
    """Complete the state ``own`` of a plant at the first command, and write and return its coefficients.

    With a recorded pressure of the supply (else NaN) the supply has no dynamics of its own.
    """
    p = read_physical(physical)
    c = coefficients(p)
    write_coefficients(coefficient, c)
    if not math.isnan(supply):
        own[_SUPPLY_PRESSURE] = supply
        coefficient[_SUPPLY_DYNAMICS] = coefficient[_LINE_STIFFNESS] = 0.0
    if math.isnan(own[_CURRENT]):
        own[_CURRENT] = c.drive_rate * volts / c.coil_rate
    if math.isnan(own[_GAS_VOLUME]):
        own[_GAS_VOLUME] = gas_volume_at(own[_SUPPLY_PRESSURE], p)
    s = read_complete_state(own)
    if math.isnan(s.tip_position):
        own[_TIP_POSITION], own[_TIP_VELOCITY] = s.position, s.velocity
    if math.isnan(s.line_a_pressure_1):
        for cell in range(CELLS):
            own[_LINE_PRESSURES + cell], own[_LINE_FLOWS + cell] = s.pressure_a, c.area_a * s.velocity
            own[_LINE_PRESSURES + CELLS + cell], own[_LINE_FLOWS + CELLS + cell] = s.pressure_b, -c.area_b * s.velocity
    return c


@inline
def move_supply(own: Floats, coefficient: Floats, moved: float, supply: float, tank: float) -> None:
    """Move the supply by a step, and set recorded pressures of supply and tank (else NaN)."""
    own[_SUPPLY_PRESSURE] += moved
    coefficient[_RELIEF] += moved
    if not math.isnan(supply):
        own[_SUPPLY_PRESSURE] = supply
    if not math.isnan(tank):
        coefficient[_TANK] = tank


@cache
def _replay(structure: Structure, at_the_valve: bool) -> Any:
    """The compiled replay of plants with a structure, whose pressure sensors sit at the cylinder or at the valve."""
    parts, integrate = parts_of(structure), integrators(structure)[1]
    sensed_at: Any = parts.lines.ports if at_the_valve else as_it_is
    sources = SOURCES + structure.number + KINDS * at_the_valve

    def run(
        recorded: Any, plants: Any, duration: float, accuracy: Any, readings: Floats, first: int, last: int
    ) -> None:
        assert sources >= 0  # keys numba's cache
        rows, samples = last - first, readings.shape[2]
        command, boundary, offset = recorded.command, recorded.boundary, plants.offset
        states, latency, course = plants.start[first:last], plants.latency, plants.course
        coefficient = np.empty((rows, N_COEFFICIENTS))
        voltage, interval, peaks = np.empty((rows, 2)), np.empty((rows, 2)), np.empty((rows, N_PEAKS))
        true, sensed = np.empty((rows, 2)), np.empty((rows, 2))  # pressures, and the transducers' signals
        for row in range(rows):
            plant, source, constant = first + row, plants.window[first + row], plants.lag[first + row]
            volts, supply = FULL_VOLTAGE * command[source, 0], boundary[source, 0, 0] - offset[plant, 0]
            c = begin(states[row], coefficient[row], plants.physical[plant], volts, supply)
            s = read_complete_state(states[row])
            at, rate = sensed_at(s), sensed_at(derivatives(s, c, volts, parts))
            # After a steady change, a lag is behind by the change within its time constant.
            true[row, 0], true[row, 1] = at.pressure_a, at.pressure_b
            sensed[row, 0] = at.pressure_a - constant * rate.pressure_a
            sensed[row, 1] = at.pressure_b - constant * rate.pressure_b
            sense(s, sensed[row], readings[plant, :, 0])
        for sample in range(1, samples):
            for row in range(rows):
                plant, source = first + row, plants.window[first + row]
                late = math.floor(latency[plant] / duration)  # whole samples
                interval[row, 0] = latency[plant] - late * duration
                interval[row, 1] = duration - interval[row, 0]
                moved = course[plant, sample] - course[plant, sample - 1]
                supply = 0.5 * (boundary[source, 0, sample - 1] + boundary[source, 0, sample]) - offset[plant, 0]
                tank = 0.5 * (boundary[source, 1, sample - 1] + boundary[source, 1, sample]) - offset[plant, 1]
                move_supply(states[row], coefficient[row], moved, supply, tank)
                if math.isnan(states[row, 0]):  # it has failed
                    interval[row, :] = 0.0
                before, after = min(max(sample - 1 - late, 0), samples - 1), min(max(sample - late, 0), samples - 1)
                voltage[row, 0] = FULL_VOLTAGE * command[source, before]
                voltage[row, 1] = FULL_VOLTAGE * command[source, after]
            integrate(Plants(states, coefficient, voltage, interval, peaks), accuracy, 0, rows)
            for row in range(rows):
                if peaks[row, STEPS] > accuracy.most_steps:
                    states[row, :] = np.nan
                constant = plants.lag[first + row]
                lag = Lag(constant / duration, math.exp(-duration / constant) if constant > 0.0 else 0.0)
                s = read_complete_state(states[row])
                at = sensed_at(s)
                sensed[row, 0] = lagged(sensed[row, 0], true[row, 0], at.pressure_a, lag)
                sensed[row, 1] = lagged(sensed[row, 1], true[row, 1], at.pressure_b, lag)
                true[row, 0], true[row, 1] = at.pressure_a, at.pressure_b
                sense(s, sensed[row], readings[first + row, :, sample])

    return compiled(run)
