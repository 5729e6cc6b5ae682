"""The benchmark's access to the integrator: its call, and its number of arithmetic operations."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any
from unittest import mock

import numpy as np

from hydro_agents.benchmark.timing import fresh_process
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium
from hydro_env.plant import equations, kernel
from hydro_env.plant.arrays import coefficient_array
from hydro_env.plant.states import State

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
        "import json; from hydro_agents.benchmark import kernel_access as counted; "
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
