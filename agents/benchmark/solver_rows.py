"""Rows of SciPy's solvers on a plant written by hand, at the accuracy of the project's integrator."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from agents.benchmark.environment_rows import vector_rate
from agents.benchmark.hand_written import RightHandSide, right_hand_side
from agents.benchmark.kernel_access import BareKernel
from agents.benchmark.table import Case, Row, UnavailableError
from agents.benchmark.timing import Extent, rate
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium, simulate

Array = NDArray[np.float64]
PERIOD = 5e-3  # s
METHODS = ("LSODA", "RK45", "Radau")
TOLERANCES = tuple(math.pow(10.0, -0.5 * half) for half in range(3, 21))  # relative, loosest first
SIZES = np.array(
    [0.1, 0.1, 50e5, 50e5, 1.0, 10.0, 1.0, 50e5, 5e-4, 1e-5]
)  # of the states; the absolute tolerance is relative × size


def solver_cases(extent: Extent) -> list[Case]:
    """A user's loop of ``solve_ivp``, one call per control period, beside the project's integrator."""
    parameters = PlantParameters()
    start = np.array(list(equilibrium(parameters)[0].values()))
    voltage = np.repeat(np.random.default_rng(0).normal(0.0, 1.5, 8), -(-extent.solver_periods // 8))
    voltage = voltage[: extent.solver_periods].clip(-5.0, 5.0)
    exact = simulate(parameters, voltage, PERIOD, method="radau").states
    allowed = error_of(simulate(parameters, voltage, PERIOD).states, exact)
    f = right_hand_side(parameters)

    def own(run: int) -> Sequence[float]:
        kernel = BareKernel(1, 1)
        return (rate(kernel.advance, extent.seconds),)

    note = f"error {allowed:.1e} of a state's range against Radau at 1e-10, {len(voltage)} control periods"
    cases = [Case((Row("hydro_env, one plant", "control periods/s", note=note),), own, extent.runs)]
    for method in METHODS:
        cases.append(_solver_case(method, f, start, voltage, exact, allowed, extent))
    row = Row(
        "hydro_env, vector environment, N = 1,024", "axis steps/s", "solve_ivp, LSODA", "sensors, reward, restarts"
    )
    lively = lively_commands(1024)
    cases.append(
        Case((row,), lambda run: (vector_rate(ServoHydraulicVectorEnv(1024), extent.seconds, lively),), extent.runs)
    )
    return cases


def lively_commands(count: int) -> Iterator[Array]:
    """Actions (count, 1) of the same kind as the voltage of the solvers' run: held for eight control periods each."""
    generator = np.random.default_rng(0)
    return cycle([held for _ in range(16) for held in [generator.normal(0.0, 0.15, (count, 1)).clip(-0.5, 0.5)] * 8])


def error_of(states: Array, exact: Array) -> float:
    """Largest difference of any state at any sample, in parts of that state's range along the run."""
    spread = np.maximum(np.ptp(exact, axis=0), 1e-12)
    return float((np.abs(states - exact) / spread).max())


def run_solver(f: RightHandSide, start: Array, voltage: Array, method: str, tolerance: float) -> Array:
    """States (n + 1, 9) of a run with ``solve_ivp`` started anew in every control period."""
    states = np.empty((len(voltage) + 1, len(start)))
    states[0] = start
    for sample, value in enumerate(voltage):
        solution: Any = solve_ivp(
            f, (0.0, PERIOD), states[sample], method=method, rtol=tolerance, atol=tolerance * SIZES, args=(value,)
        )
        states[sample + 1] = solution.y[:, -1]
    return states


def matching_tolerance(run: Callable[[float], Array], exact: Array, allowed: float) -> float:
    """The loosest relative tolerance whose error is at most the allowed one.

    Raises:
        UnavailableError: none of those tried is accurate enough.
    """
    for tolerance in TOLERANCES:
        if error_of(run(tolerance), exact) <= allowed:
            return tolerance
    raise UnavailableError(f"no tolerance down to {TOLERANCES[-1]:.0e} is as accurate")


def _solver_case(
    method: str, f: RightHandSide, start: Array, voltage: Array, exact: Array, allowed: float, extent: Extent
) -> Case:
    found: list[float] = []

    def run_at(tolerance: float) -> Array:
        return run_solver(f, start, voltage, method, tolerance)

    def measure(run: int) -> Sequence[float]:
        if not found:
            found.append(matching_tolerance(run_at, exact, allowed))
        began = time.perf_counter()
        states = run_at(found[0])
        seconds = time.perf_counter() - began
        return len(voltage) / seconds, found[0], error_of(states, exact)

    rows = (
        Row(f"solve_ivp, {method}", "control periods/s", "hydro_env, one plant", "right-hand side in plain Python"),
        Row(f"solve_ivp, {method}: relative tolerance", "1", note="the loosest of 10^(−n/2) that is as accurate"),
        Row(f"solve_ivp, {method}: error", "of range"),
    )
    return Case(rows, measure, extent.runs)
