"""Fixed-step integration of one or many plants with the right-hand side of ``equations``, compiled.

Plants stand in blocks of ``LANES``: an array of plants has the shape (blocks, rows, LANES), and the classical
Runge–Kutta step runs over the lanes of a block in a loop that the compiler turns into vector instructions. One plant
is a block with unused lanes. No operation mixes lanes, so a plant's numbers do not depend on its neighbours, on how
many there are, or on threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.plant import compiler
from hydro_env.plant.equations import (
    Coefficients,
    State,
    derivatives,
    fastest_rate,
    hold_limits,
)

LANES = 8
"""Plants that one vector instruction works on (eight doubles fill an AVX-512 register)."""

MAXIMUM_STEP = 0.25e-3
"""s; the inner step where nothing asks for a shorter one."""

STEP_LIMIT = 2.4
"""Largest h·|λ|; the classical Runge–Kutta method is stable up to 2.78."""

N_STATES = len(State._fields)
N_COEFFICIENTS = len(Coefficients._fields)
N_PEAKS = 2
PEAK_PRESSURE, IMPACT_SPEED = range(N_PEAKS)
"""Rows of the peaks that an integration notes: highest chamber pressure (Pa), fastest meeting of an end stop (m/s)."""

_STATE_ROW = 0
_COEFFICIENT_ROW = N_STATES
_PEAK_ROW = _COEFFICIENT_ROW + N_COEFFICIENTS
_STEP_ROW = _PEAK_ROW + N_PEAKS
_COUNT_ROW = _STEP_ROW + 1
_VOLTAGE_ROW = _COUNT_ROW + 1
_ROWS = _VOLTAGE_ROW + 1


def _lane_reader(kind: type, first_row: int) -> Callable[..., Any]:
    """A compiled function that reads one lane of the flat work array as a named tuple."""
    fields = ", ".join(f"work[{(first_row + row) * LANES} + lane]" for row in range(len(kind._fields)))  # type: ignore[attr-defined]
    reader: Callable[..., Any] = eval(f"lambda work, lane: Kind({fields})", {"Kind": kind})
    return compiler.inline(reader)


_read_state = _lane_reader(State, _STATE_ROW)
_read_coefficients = _lane_reader(Coefficients, _COEFFICIENT_ROW)


@compiler.inline
def _moved(s, k, step):
    """s + step · k"""
    return State(
        s.position + step * k.position,
        s.velocity + step * k.velocity,
        s.pressure_a + step * k.pressure_a,
        s.pressure_b + step * k.pressure_b,
        s.spool_position + step * k.spool_position,
        s.spool_velocity + step * k.spool_velocity,
        s.coil_current + step * k.coil_current,
        s.supply_pressure + step * k.supply_pressure,
        s.gas_volume + step * k.gas_volume,
    )


@compiler.inline
def runge_kutta_step(s, c, voltage, step):
    """One classical Runge–Kutta step of length ``step`` (s) with the voltage held."""
    k1 = derivatives(s, c, voltage)
    k2 = derivatives(_moved(s, k1, 0.5 * step), c, voltage)
    k3 = derivatives(_moved(s, k2, 0.5 * step), c, voltage)
    k4 = derivatives(_moved(s, k3, step), c, voltage)
    s = _moved(s, k1, step / 6.0)
    s = _moved(s, k2, step / 3.0)
    s = _moved(s, k3, step / 3.0)
    return hold_limits(_moved(s, k4, step / 6.0), c)


def _build(stamp: int) -> Callable[..., None]:
    def integrate(
        state: NDArray[np.float64],
        coefficients: NDArray[np.float64],
        voltage: NDArray[np.float64],
        durations: NDArray[np.float64],
        maximum_step: float,
        peaks: NDArray[np.float64],
        first_block: int,
        last_block: int,
    ) -> None:
        assert stamp >= 0  # keys numba's cache
        work = np.empty(_ROWS * LANES)
        for block in range(first_block, last_block):
            for row in range(N_STATES):
                for lane in range(LANES):
                    work[(_STATE_ROW + row) * LANES + lane] = state[block, row, lane]
            for row in range(N_COEFFICIENTS):
                for lane in range(LANES):
                    work[(_COEFFICIENT_ROW + row) * LANES + lane] = coefficients[block, row, lane]
            for lane in range(LANES):
                work[(_PEAK_ROW + PEAK_PRESSURE) * LANES + lane] = -1e300
                work[(_PEAK_ROW + IMPACT_SPEED) * LANES + lane] = 0.0
            for interval in range(durations.shape[0]):
                duration = durations[interval]
                if duration <= 0.0:
                    continue
                base = math.ceil(duration / maximum_step - 1e-9)
                most = base
                for lane in range(LANES):
                    rate = fastest_rate(_read_state(work, lane), _read_coefficients(work, lane))
                    needed = duration * rate / STEP_LIMIT
                    count = base
                    if needed > count:  # false for NaN, which the caller finds afterwards
                        count = math.ceil(min(needed, 1e6))
                    most = max(most, count)
                    work[_COUNT_ROW * LANES + lane] = float(count)
                    work[_STEP_ROW * LANES + lane] = duration / count
                    work[_VOLTAGE_ROW * LANES + lane] = voltage[block, interval, lane]
                for index in range(most):
                    now = float(index)
                    for lane in range(LANES):  # this loop becomes vector instructions
                        s = _read_state(work, lane)
                        c = _read_coefficients(work, lane)
                        moving = now < work[_COUNT_ROW * LANES + lane]
                        n = runge_kutta_step(s, c, work[_VOLTAGE_ROW * LANES + lane], work[_STEP_ROW * LANES + lane])
                        work[0 * LANES + lane] = n.position if moving else s.position
                        work[1 * LANES + lane] = n.velocity if moving else s.velocity
                        work[2 * LANES + lane] = n.pressure_a if moving else s.pressure_a
                        work[3 * LANES + lane] = n.pressure_b if moving else s.pressure_b
                        work[4 * LANES + lane] = n.spool_position if moving else s.spool_position
                        work[5 * LANES + lane] = n.spool_velocity if moving else s.spool_velocity
                        work[6 * LANES + lane] = n.coil_current if moving else s.coil_current
                        work[7 * LANES + lane] = n.supply_pressure if moving else s.supply_pressure
                        work[8 * LANES + lane] = n.gas_volume if moving else s.gas_volume
                        # Peaks: of pressure over all steps, of speed where an end stop has just been met.
                        # A lane that has done its own steps (not moving) adds nothing, whatever its neighbours need.
                        highest = max(n.pressure_a, n.pressure_b) if moving else -1e300
                        peak = work[(_PEAK_ROW + PEAK_PRESSURE) * LANES + lane]
                        work[(_PEAK_ROW + PEAK_PRESSURE) * LANES + lane] = max(highest, peak)
                        beyond = moving and abs(n.position) > c.end_stop_position
                        outwards = max(s.velocity, 0.0) if n.position > 0.0 else max(-s.velocity, 0.0)
                        impact = work[(_PEAK_ROW + IMPACT_SPEED) * LANES + lane]
                        work[(_PEAK_ROW + IMPACT_SPEED) * LANES + lane] = max(impact, outwards if beyond else 0.0)
            for row in range(N_STATES):
                for lane in range(LANES):
                    state[block, row, lane] = work[(_STATE_ROW + row) * LANES + lane]
            for row in range(N_PEAKS):
                for lane in range(LANES):
                    peaks[block, row, lane] = work[(_PEAK_ROW + row) * LANES + lane]

    return integrate


integrate = compiler.compiled(_build(compiler.source_stamp("plant/equations.py")))
"""Advance plants in place through consecutive hold intervals.

Args:
    state: (blocks, N_STATES, LANES), changed in place.
    coefficients: (blocks, N_COEFFICIENTS, LANES).
    voltage: (blocks, intervals, LANES), V, held in each interval.
    durations: (intervals,), s.
    maximum_step: longest inner step, s; a plant whose fastest rate asks for it gets a shorter one.
    peaks: (blocks, N_PEAKS, LANES), written.
    first_block, last_block: the half-open range of blocks to advance.
"""
