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
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from agents.benchmark.timing import fresh_process
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium
from hydro_env.plant import equations, kernel
from hydro_env.plant.arrays import coefficient_array
from hydro_env.plant.parts import chambers, friction, load, valve
from hydro_env.plant.states import State

VOLTAGE = 1.0  # V; the square wave that drives the plants
HALF_WAVE = 20  # control periods


class BareKernel:
    """N plants drawn as the environment draws them, advanced by nothing but the integrator.

    The plants follow a square wave of ±1 V with a period of 0.2 s.
    """

    def __init__(self, count: int, threads: int) -> None:
        env = ServoHydraulicVectorEnv(count, info=False, threads=1)
        env.reset(seed=0)
        config = env.config
        self.count, self.threads = count, threads
        self._first = env.axes.state.copy()
        self.coefficients = env.axes.coefficient.copy()
        self._durations = np.array([config.command_latency, config.control_period - config.command_latency])
        self._accuracy = kernel.Accuracy(float(config.maximum_step), float(config.tolerance))
        self._voltage = np.full((count, 2), VOLTAGE)
        self._peaks = np.zeros((count, kernel.N_PEAKS))
        self._bounds = [count * part // threads for part in range(threads + 1)]
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
        plants = kernel.Plants(self.state, self.coefficients, self._voltage, self._peaks)
        kernel.integrate(plants, self._durations, self._accuracy, first, last)

    def mean_steps(self, periods: int) -> float:
        """Inner steps per plant and control period over the coming periods."""
        counts = []
        for _ in range(periods):
            self.advance()
            counts.append(self._peaks[:, kernel.STEPS].mean())
        return float(np.mean(counts))

    def close(self) -> None:
        """Stop the worker threads."""
        if self._pool is not None:
            self._pool.shutdown()


class Work(NamedTuple):
    """Arithmetic of the integrator."""

    kinds: dict[str, int]  # of one right-hand side, by kind of operation
    evaluations: float  # of right-hand sides per plant and control period, those of idle lanes included


def counted_work() -> Work:
    """Operations of a right-hand side and how often it is evaluated, counted in a process of its own."""
    code = "from agents.benchmark.kernel_access import print_work; print_work()"
    _, text = fresh_process(code, {"NUMBA_DISABLE_JIT": "1"})
    return Work(**json.loads(text))


def total(kinds: dict[str, int]) -> int:
    """Additions, multiplications, divisions and square roots; comparisons and selections are not counted."""
    return sum(number for kind, number in kinds.items() if kind != "comparisons")


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


def print_work() -> None:
    """Print, as JSON, what :func:`counted_work` returns; needs ``NUMBA_DISABLE_JIT=1``."""
    evaluations = _count_evaluations()
    kinds = {"add": "additions", "sub": "additions", "mul": "multiplications", "truediv": "divisions"}
    for name, kind in kinds.items():
        setattr(_Counted, f"__{name}__", _counting(f"__{name}__", kind))
        setattr(_Counted, f"__r{name}__", _counting(f"__r{name}__", kind))
    setattr(_Counted, "__neg__", _counting("__neg__", "additions"))  # noqa: B010
    for name in ("lt", "le", "gt", "ge"):
        setattr(_Counted, f"__{name}__", _counting(f"__{name}__", "comparisons"))
    rest, voltage = equilibrium(PlantParameters(), 0.0)
    state = State(*(_Counted(value) for value in rest.values()))
    coefficients = equations.Coefficients(*(_Counted(value) for value in coefficient_array(PlantParameters())))
    for module in (chambers, friction, load, valve):
        setattr(module, "math", _CountingMath())  # noqa: B010
    _Counted.counts = {}
    equations.derivatives(state, coefficients, _Counted(voltage))
    print(json.dumps({"kinds": _Counted.counts, "evaluations": evaluations}))


def _count_evaluations(plants: int = 32, periods: int = 5) -> float:
    """Right-hand sides per plant and control period, from the start of the square wave on."""
    plain: Callable[..., Any] = equations.derivatives
    calls = 0

    def derivatives(s: Any, c: Any, voltage: float) -> Any:
        nonlocal calls
        calls += 1
        return plain(s, c, voltage)

    with mock.patch.object(kernel, "derivatives", derivatives):
        run = BareKernel(plants, 1)
        calls = 0
        for _ in range(periods):
            run.advance()
    return calls / (plants * periods)
