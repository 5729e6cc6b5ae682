"""Rows of the integrator alone, and of the environments beside Gymnasium's own."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.table import Case, Extent, one_row, rate
from hydro_env import ENVIRONMENT_ID, ServoHydraulicVectorEnv
from hydro_env.plant import kernel

MODES = ("NextStep", "SameStep", "Disabled")


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


def single_rate(env: gym.Env[Any, Any], seconds: float, steps: int = 500) -> float:
    """Steps per second of one environment under its zero action, resets included."""
    env.reset(seed=0)
    action = env.action_space.sample() * 0

    def work() -> int:
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    result = rate(work, seconds)
    env.close()
    return result


def vector_rate(env: Any, seconds: float) -> float:
    """Environment steps per second of a vector environment under small random actions, restarts included."""
    count: int = env.num_envs
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = env.action_space.sample()
    if actions.dtype.kind == "f":
        actions = (0.1 * actions).astype(np.float32)
    disabled = str(getattr(env.metadata.get("autoreset_mode"), "value", "")) == "Disabled"
    batch: int = max(1, 1024 // count)

    def work() -> int:
        for _ in range(batch):
            _, _, terminated, truncated, _ = env.step(actions)
            if disabled:
                ended = terminated | truncated
                if ended.any():
                    env.reset(options={"reset_mask": ended})
        return batch * count

    result = rate(work, seconds)
    env.close()
    return result


def single_cases(extent: Extent) -> list[Case]:
    """One axis beside Gymnasium's classic control."""

    def case(name: str, make: Callable[[], gym.Env[Any, Any]], against: str = "", note: str = "") -> Case:
        return one_row(name, "steps/s", lambda: single_rate(make(), extent.seconds), extent.runs, against, note)

    own = "one axis, gym.make"
    return [
        case("Pendulum-v1", lambda: gym.make("Pendulum-v1")),
        case(own, single_axis, "Pendulum-v1", "ServoHydraulic-v0, 5 ms per step"),
        case("CartPole-v1", lambda: gym.make("CartPole-v1")),
        case("one axis, no wrappers", lambda: single_axis().unwrapped, "CartPole-v1"),
    ]


def vector_cases(extent: Extent) -> list[Case]:
    """N axes in every autoreset mode, beside Gymnasium's vector CartPole and its vectors of single axes."""

    def case(name: str, make: Callable[[], Any], against: str = "") -> Case:
        return one_row(name, "axis steps/s", lambda: vector_rate(make(), extent.seconds), extent.runs, against)

    cases = []
    for count in extent.vector_sizes:
        peer = f"CartPole-v1, N = {count:,}"
        cases.append(case(peer, partial(gym.make_vec, "CartPole-v1", num_envs=count)))
        for mode in MODES:
            make = partial(gym.make_vec, ENVIRONMENT_ID, num_envs=count, autoreset_mode=mode)
            cases.append(case(f"{mode}, N = {count:,}", make, peer))
    count = extent.vector_sizes[0]
    axes, native = [single_axis] * count, f"NextStep, N = {count:,}"
    in_processes = partial(gym.vector.AsyncVectorEnv, axes, context="spawn")
    cases.append(case(f"SyncVectorEnv of single axes, N = {count:,}", lambda: gym.vector.SyncVectorEnv(axes), native))
    cases.append(case(f"AsyncVectorEnv of single axes, N = {count:,}", in_processes, native))
    return cases


def single_axis() -> gym.Env[Any, Any]:
    """One axis through ``gym.make``, in a worker process too."""
    return gym.make(f"hydro_env:{ENVIRONMENT_ID}")
