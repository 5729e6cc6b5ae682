"""Rows of the integrator: speed, share of the machine's peak, and SciPy's solvers at the same accuracy."""

from __future__ import annotations

import json
import math
import os
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle, pairwise
from typing import Any
from unittest import mock

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.environment_rows import vector_rate
from benchmarks.table import Case, Extent, Row, UnavailableError, fresh_process, one_row, rate
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium, simulate
from hydro_env.plant import equations, kernel
from hydro_env.plant.arrays import coefficient_array, derivative_array
from hydro_env.plant.states import TYPICAL_SIZE, State
from hydro_env.types import Floats

VOLTAGE = 1.0  # V; the square wave that drives the plants
HALF_WAVE = 20  # control periods


class BareKernel:
    """N plants drawn as in the environment, advanced by the integrator alone.

    The plants follow a square wave of ±1 V with a period of 0.2 s.
    """

    def __init__(self, count: int, threads: int) -> None:
        env = ServoHydraulicVectorEnv(count, info=False, threads=1)
        env.reset(seed=0)
        config = env.config
        self._first = env.axes.state.copy()
        self._coefficients = env.axes.coefficient.copy()
        self._durations = np.tile([config.command_latency, config.control_period - config.command_latency], (count, 1))
        self._accuracy = kernel.Accuracy(float(config.maximum_step), float(config.tolerance))
        self._voltage = np.full((count, 2), VOLTAGE)
        self._peaks = np.zeros((count, kernel.N_PEAKS))
        self._bounds = [count * part // threads for part in range(threads + 1)]
        self._pool = ThreadPoolExecutor(threads)
        self.restart()

    def restart(self) -> None:
        """Return to the initial state."""
        self.state = self._first.copy()
        self._voltage[:] = VOLTAGE
        self._periods = 0

    def advance(self) -> int:
        """One control period of all plants; returns the number of plants."""
        waiting = [self._pool.submit(self._integrate, first, last) for first, last in pairwise(self._bounds[1:])]
        self._integrate(self._bounds[0], self._bounds[1])
        for future in waiting:
            future.result()
        self._periods += 1
        if self._periods % HALF_WAVE == 0:
            self._voltage *= -1.0
        return len(self.state)

    def _integrate(self, first: int, last: int) -> None:
        plants = kernel.Plants(self.state, self._coefficients, self._voltage, self._durations, self._peaks)
        kernel.integrate(plants, self._accuracy, first, last)

    def steps(self) -> float:
        """Inner steps in the last control period, mean over the plants."""
        return float(self._peaks[:, kernel.STEPS].mean())

    def close(self) -> None:
        """Stop the worker threads."""
        self._pool.shutdown()


def counted_work() -> tuple[dict[str, int], float]:
    """Arithmetic of the integrator, counted without compiling in a fresh process.

    Returns:
        Operations of one right-hand side by kind, and right-hand sides per plant and control period, including idle
        lanes.
    """
    code = (
        "import json; from benchmarks import kernel_rows as counted; "
        "print(json.dumps([counted.count_evaluations(), counted.count_operations()]))"
    )
    evaluations, kinds = json.loads(fresh_process(code, {"NUMBA_DISABLE_JIT": "1"})[1])
    return kinds, evaluations


def count_operations() -> Counter[str]:
    """Operations of one right-hand side by kind: it runs uncompiled, on numbers that count the operations."""
    counts: Counter[str] = Counter()

    def counting(function: Callable[..., Any], kind: str) -> Callable[..., Any]:
        def operation(*values: float) -> Any:
            counts[kind] += 1
            result = function(*values)
            return counted(result) if type(result) is float else result

        return operation

    kinds = {"additions": ("add", "sub"), "multiplications": ("mul",), "divisions": ("truediv",)}
    names = {f"__{r}{name}__": kind for kind, group in kinds.items() for name in group for r in ("", "r")}
    names |= {"__neg__": "additions"} | {f"__{name}__": "comparisons" for name in ("lt", "le", "gt", "ge")}
    counted: Any = type("", (float,), {name: counting(getattr(float, name), kind) for name, kind in names.items()})
    rest, voltage = equilibrium(PlantParameters())
    state = State(**{name: counted(value) for name, value in rest.items()})
    coefficients = equations.Coefficients(*map(counted, coefficient_array(PlantParameters())))
    with mock.patch.object(math, "sqrt", counting(math.sqrt, "square roots")):
        equations.derivatives(state, coefficients, counted(voltage))
    return counts


def count_evaluations(plants: int = 32, periods: int = 5) -> float:
    """Right-hand sides per plant and control period, uncompiled, from the start of the square wave on."""
    bare = BareKernel(plants, 1)
    with mock.patch.object(kernel, "derivatives", side_effect=equations.derivatives) as derivatives:
        for _ in range(periods):
            bare.advance()
    return derivatives.call_count / (plants * periods)


PEAK_SIZE = 1024  # rows and columns of the matrices
SHARE_SIZE = 4096  # plants for which the share of the peak is reported
_PEAK_CODE = f"""
import time, numpy as np
from hydro_env.types import Floats
n = {PEAK_SIZE}
a, b = np.random.default_rng(0).random((2, n, n))
out, best = a @ b, 1e9
for _ in range(10):
    began = time.perf_counter()
    np.matmul(a, b, out=out)
    best = min(best, time.perf_counter() - began)
print(2e-9 * n**3 / best)
"""


def kernel_cases(extent: Extent) -> list[Case]:
    """The integrator alone."""
    kinds, evaluations = counted_work()
    operations = sum(count for kind, count in kinds.items() if kind != "comparisons")
    peaks: dict[int, float] = {}

    def peak(threads: int) -> float:
        """Rate of a matrix product (GFLOP/s), the best of ten in a fresh process."""
        variables = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        peaks[threads] = float(fresh_process(_PEAK_CODE, dict.fromkeys(variables, str(threads)))[1])
        return peaks[threads]

    def speed(count: int, threads: int) -> Case:
        name = f"{_counted(count, 'plant')}, {_counted(threads, 'thread')}"
        rows = [Row(name, "plant periods/s", f"{_counted(count, 'plant')}, 1 thread" if threads > 1 else "")]
        if count == SHARE_SIZE:
            rows.append(Row(f"{name}: share of the peak", "%", note="right-hand sides alone; a DGEMM has no division"))
        if count == SHARE_SIZE and threads == 1:
            rows.append(Row(f"{name}: inner steps of a period", "1", note="mean of all plants and 40 periods, counted"))

        def measure(run: int) -> Sequence[float]:
            bare = BareKernel(count, threads)
            periods = rate(bare.advance, extent.seconds)
            values = [periods]
            if len(rows) > 1:
                values.append(100.0 * periods * operations * evaluations / (1e9 * peaks[threads]))
            if len(rows) > 2:
                values.append(statistics.fmean(bare.steps() for _ in range(2 * HALF_WAVE) if bare.advance()))
            bare.close()
            return values

        return Case(tuple(rows), measure, extent.runs)

    thread_counts = [1, 2] if (os.cpu_count() or 1) > 1 else [1]
    note = f"NumPy's BLAS, {PEAK_SIZE} × {PEAK_SIZE}, best of 10: counts as the machine's peak"
    cases = [
        one_row(f"DGEMM, {_counted(n, 'thread')}", "GFLOP/s", lambda n=n: peak(n), extent.runs, note=note)  # type: ignore[misc]
        for n in thread_counts
    ]
    for threads in thread_counts:
        cases += [speed(count, threads) for count in extent.kernel_sizes if threads == 1 or count >= 16 * threads]
    spelled = ", ".join(f"{number} {kind}" for kind, number in sorted(kinds.items(), key=lambda item: -item[1]))
    remark = "mean of 32 drawn plants in the first 25 ms under 1 V, counted"
    rows = (
        Row("operations of a right-hand side", "1", note=spelled),
        Row("right-hand sides of a control period", "1", note=remark),
    )
    return [*cases, Case(rows, lambda run: (operations, evaluations), 1)]


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}{'s' if count > 1 else ''}"


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

    def derivative(time: float, state: Floats, volts: float) -> Floats:
        return np.asarray(derivative_array(state, coefficients, volts))

    def solver(method: str) -> Case:
        tolerances: list[float] = []  # found in the first run

        def states(tolerance: float) -> Floats:
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


def held_random_commands(count: int) -> Iterator[Floats]:
    """Actions (count, 1) like the solvers' voltages: normally distributed, each held for eight control periods."""
    generator = np.random.default_rng(0)
    return cycle([held for _ in range(16) for held in [generator.normal(0.0, 0.15, (count, 1)).clip(-0.5, 0.5)] * 8])


def error_of(states: Floats, exact: Floats) -> float:
    """Largest difference of any state at any sample, as a fraction of that state's range along the run."""
    spread = np.maximum(np.ptp(exact, axis=0), 1e-12)
    return float(np.max(np.abs(states - exact) / spread))


def matching_tolerance(run: Callable[[float], Floats], exact: Floats, allowed: float) -> float:
    """The loosest relative tolerance whose error is at most the allowed one.

    Raises:
        UnavailableError: none of :data:`TOLERANCES` is accurate enough.
    """
    for tolerance in TOLERANCES:
        if error_of(run(tolerance), exact) <= allowed:
            return tolerance
    raise UnavailableError(f"no tolerance down to {TOLERANCES[-1]:.0e} is as accurate")
