"""All that the benchmark knows of the integrator: how to call it, and how much arithmetic it does.

Run as a module, ``NUMBA_DISABLE_JIT=1 python -m agents.benchmark.kernel_access``, it counts operations: the project's
own functions run once on numbers that count what is done to them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np

from agents.benchmark.timing import fresh_process
from hydro_env import ServoHydraulicVectorEnv
from hydro_env.plant import equations, kernel
from hydro_env.plant.simulate import coefficient_array, equilibrium

VOLTAGE = 1.0  # V; the square wave that drives the plants
HALF_WAVE = 20  # control periods


class BareKernel:
    """N plants drawn as the environment draws them, advanced by nothing but the integrator.

    The plants follow a square wave of ±1 V with a period of 0.2 s.
    """

    def __init__(self, count: int, threads: int) -> None:
        env = ServoHydraulicVectorEnv(count, info=False, threads=1)
        env.reset(seed=0)
        self.count, self.threads = count, threads
        self._first = env.axes.state.copy()
        self.coefficients = env.axes.coefficient.copy()
        latency, period = env.config.command_latency, env.config.control_period
        self._durations = np.array([latency, period - latency])
        self._maximum_step = env.config.maximum_step
        blocks = len(self._first)
        self._voltage = np.full((blocks, 2, kernel.LANES), VOLTAGE)
        self._peaks = np.zeros((blocks, kernel.N_PEAKS, kernel.LANES))
        self._bounds = [blocks * part // threads for part in range(threads + 1)]
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        self.restart()

    def restart(self) -> None:
        """Back to rest."""
        self.state = self._first.copy()
        self._voltage[:] = VOLTAGE
        self._periods = 0

    def advance(self) -> int:
        """One control period of all plants; returns how many plants that were."""
        waiting = []
        for first, last in pairwise(self._bounds[1:]):
            assert self._pool is not None
            waiting.append(self._pool.submit(self._integrate, first, last))
        self._integrate(self._bounds[0], self._bounds[1])
        for future in waiting:
            future.result()
        self._periods += 1
        if self._periods % HALF_WAVE == 0:
            self._voltage *= -1.0
        return self.count

    def _integrate(self, first: int, last: int) -> None:
        kernel.integrate(
            self.state,
            self.coefficients,
            self._voltage,
            self._durations,
            self._maximum_step,
            self._peaks,
            first,
            last,
        )

    def inner_steps(self, periods: int = 2 * HALF_WAVE) -> float:
        """Inner steps per plant and control period, mean over plants and one period of the square wave."""
        self.restart()
        total = 0.0
        for _ in range(periods):
            total += self._steps_now()
            self.advance()
        self.restart()
        return total / periods

    def _steps_now(self) -> float:
        steps = []
        for axis in range(min(self.count, 64)):
            block, lane = axis // kernel.LANES, axis % kernel.LANES
            state = equations.State(*self.state[block, :, lane])
            coefficients = equations.Coefficients(*self.coefficients[block, :, lane])
            fastest = equations.fastest_rate(state, coefficients)
            steps.append(
                sum(
                    max(
                        math.ceil(duration / self._maximum_step - 1e-9),
                        math.ceil(duration * fastest / kernel.STEP_LIMIT),
                    )
                    for duration in self._durations
                )
            )
        return float(np.mean(steps))

    def close(self) -> None:
        """Stop the worker threads."""
        if self._pool is not None:
            self._pool.shutdown()


def operations() -> dict[str, dict[str, int]]:
    """Floating-point operations by kind of a right-hand side and of an inner step, counted in a process of its own."""
    _, text = fresh_process(
        "from agents.benchmark.kernel_access import print_operations; print_operations()", {"NUMBA_DISABLE_JIT": "1"}
    )
    counted: dict[str, dict[str, int]] = json.loads(text)
    return counted


def total(counted: dict[str, int]) -> int:
    """Additions, multiplications, divisions and square roots; comparisons and selections are not counted."""
    return sum(number for kind, number in counted.items() if kind != "comparisons")


class _Counted(float):
    """A number that notes what is done to it."""

    counts: dict[str, int] = {}


def _counting(name: str, kind: str) -> Callable[..., Any]:
    plain = getattr(float, name)

    def operation(self: float, *others: float) -> Any:
        _Counted.counts[kind] = _Counted.counts.get(kind, 0) + 1
        result = plain(self, *others)
        return result if isinstance(result, bool) else _Counted(result)

    return operation


class _CountingMath:
    """Stands in for ``math`` in the equations."""

    @staticmethod
    def sqrt(value: float) -> _Counted:
        _Counted.counts["square roots"] = _Counted.counts.get("square roots", 0) + 1
        return _Counted(math.sqrt(value))


def print_operations() -> None:
    """Print, as JSON, what :func:`operations` returns; needs ``NUMBA_DISABLE_JIT=1``."""
    kinds = {"add": "additions", "sub": "additions", "mul": "multiplications", "truediv": "divisions"}
    for name, kind in kinds.items():
        setattr(_Counted, f"__{name}__", _counting(f"__{name}__", kind))
        setattr(_Counted, f"__r{name}__", _counting(f"__r{name}__", kind))
    setattr(_Counted, "__neg__", _counting("__neg__", "additions"))  # noqa: B010
    for name in ("lt", "le", "gt", "ge"):
        setattr(_Counted, f"__{name}__", _counting(f"__{name}__", "comparisons"))
    from hydro_env import PlantParameters

    rest, voltage = equilibrium(PlantParameters(), 0.0)
    state = equations.State(*(_Counted(value) for value in rest.values()))
    coefficients = equations.Coefficients(*(_Counted(value) for value in coefficient_array(PlantParameters())))
    setattr(equations, "math", _CountingMath())  # noqa: B010
    counted = {}
    _Counted.counts = {}
    equations.derivatives(state, coefficients, _Counted(voltage))
    counted["right-hand side"] = _Counted.counts
    _Counted.counts = {}
    kernel.runge_kutta_step(state, coefficients, _Counted(voltage), _Counted(1e-4))
    counted["inner step"] = _Counted.counts
    print(json.dumps(counted))
