"""Rows of the integrator: its speed alone."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise

import numpy as np

from benchmarks.table import Case, Extent, one_row, rate
from hydro_env import ServoHydraulicVectorEnv
from hydro_env.plant import kernel

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
        self.state = env.axes.state.copy()
        self._coefficients = env.axes.coefficient.copy()
        self._durations = np.tile([config.command_latency, config.control_period - config.command_latency], (count, 1))
        self._accuracy = kernel.Accuracy(float(config.maximum_step), float(config.tolerance))
        self._voltage = np.full((count, 2), VOLTAGE)
        self._peaks = np.zeros((count, kernel.N_PEAKS))
        self._bounds = [count * part // threads for part in range(threads + 1)]
        self._pool = ThreadPoolExecutor(threads)
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

    def close(self) -> None:
        """Stop the worker threads."""
        self._pool.shutdown()


def kernel_cases(extent: Extent) -> list[Case]:
    """The integrator alone."""

    def speed(count: int, threads: int) -> float:
        bare = BareKernel(count, threads)
        periods = rate(bare.advance, extent.seconds)
        bare.close()
        return periods

    cases = []
    for threads in [1, 2] if (os.cpu_count() or 1) > 1 else [1]:
        for count in (count for count in extent.kernel_sizes if threads == 1 or count >= 16 * threads):
            plants = _counted(count, "plant")
            name, against = f"{plants}, {_counted(threads, 'thread')}", f"{plants}, 1 thread" if threads > 1 else ""
            cases.append(one_row(name, "plant periods/s", partial(speed, count, threads), extent.runs, against))
    return cases


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}{'s' if count > 1 else ''}"
