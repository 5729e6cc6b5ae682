"""Rows of SciPy's solvers on the same compiled right-hand side, at the accuracy of the project's integrator."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from hydro_agents.benchmark.environment_rows import vector_rate
from hydro_agents.benchmark.kernel_access import BareKernel
from hydro_agents.benchmark.table import Case, Row, UnavailableError, one_row
from hydro_agents.benchmark.timing import Extent, rate
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium, simulate
from hydro_env.plant.arrays import coefficient_array, derivative_array
from hydro_env.plant.states import TYPICAL_SIZE

Array = NDArray[np.float64]
PERIOD = 5e-3  # s
METHODS = ("LSODA", "RK45", "Radau")
TOLERANCES = tuple(math.pow(10.0, -0.5 * half) for half in range(3, 21))  # relative, loosest first


def solver_cases(extent: Extent) -> list[Case]:
    """A user's loop of ``solve_ivp``, one call per control period, beside the project's integrator."""
    parameters = PlantParameters()
    start = np.array(list(equilibrium(parameters)[0].values()))
    voltage = np.repeat(np.random.default_rng(0).normal(0.0, 1.5, 8), -(-extent.solver_periods // 8))
    voltage = voltage[: extent.solver_periods].clip(-5.0, 5.0)
    exact = simulate(parameters, voltage, PERIOD, method="radau").states
    allowed = error_of(simulate(parameters, voltage, PERIOD).states, exact)
    coefficients = coefficient_array(parameters)

    def derivative(time: float, state: Array, volts: float) -> Array:
        return np.asarray(derivative_array(state, coefficients, volts))

    def solver(method: str) -> Case:
        tolerances: list[float] = []  # found in the first run

        def states(tolerance: float) -> Array:
            states = [start]
            for value in voltage:
                options: dict[str, Any] = {"method": method, "rtol": tolerance, "atol": tolerance * TYPICAL_SIZE}
                states.append(solve_ivp(derivative, (0.0, PERIOD), states[-1], args=(value,), **options).y[:, -1])
            return np.array(states)

        def measure(run: int) -> Sequence[float]:
            if not tolerances:
                tolerances.append(matching_tolerance(states, exact, allowed))
            began = time.perf_counter()
            solution = states(tolerances[0])
            seconds = time.perf_counter() - began
            return len(voltage) / seconds, tolerances[0], error_of(solution, exact)

        name = f"solve_ivp, {method}"
        rows = (
            Row(name, "control periods/s", own, "right-hand side compiled"),
            Row(f"{name}: relative tolerance", "1", note="the loosest of 10^(−n/2) with the same accuracy"),
            Row(f"{name}: error", "of range"),
        )
        return Case(rows, measure, extent.runs)

    own = "hydro_env, one plant"
    note = f"error {allowed:.1e} of a state's range against Radau at 1e-10, {len(voltage)} control periods"
    commands = held_random_commands(1024)
    return [
        one_row(
            own, "control periods/s", lambda: rate(BareKernel(1, 1).advance, extent.seconds), extent.runs, note=note
        ),
        *map(solver, METHODS),
        one_row(
            "hydro_env, vector environment, N = 1,024",
            "axis steps/s",
            lambda: vector_rate(ServoHydraulicVectorEnv(1024), extent.seconds, commands),
            extent.runs,
            "solve_ivp, LSODA",
            "sensors, reward, restarts",
        ),
    ]


def held_random_commands(count: int) -> Iterator[Array]:
    """Actions (count, 1) like the solvers' voltages: normally distributed, each held for eight control periods."""
    generator = np.random.default_rng(0)
    return cycle([held for _ in range(16) for held in [generator.normal(0.0, 0.15, (count, 1)).clip(-0.5, 0.5)] * 8])


def error_of(states: Array, exact: Array) -> float:
    """Largest difference of any state at any sample, as a fraction of that state's range along the run."""
    spread = np.maximum(np.ptp(exact, axis=0), 1e-12)
    return float(np.max(np.abs(states - exact) / spread))


def matching_tolerance(run: Callable[[float], Array], exact: Array, allowed: float) -> float:
    """The loosest relative tolerance whose error is at most the allowed one.

    Raises:
        UnavailableError: none of :data:`TOLERANCES` is accurate enough.
    """
    for tolerance in TOLERANCES:
        if error_of(run(tolerance), exact) <= allowed:
            return tolerance
    raise UnavailableError(f"no tolerance down to {TOLERANCES[-1]:.0e} is as accurate")
