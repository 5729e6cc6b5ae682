"""Rows of the environments through ``gym.make`` and ``gym.make_vec``, beside Gymnasium's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.table import Case, Extent, one_row, rate
from hydro_env import ENVIRONMENT_ID

MODES = ("NextStep", "SameStep", "Disabled")


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


def cost_cases(extent: Extent) -> list[Case]:
    """Cost of a step of one axis against N."""

    def cost(count: int) -> float:
        return 1e9 / vector_rate(gym.make_vec(ENVIRONMENT_ID, num_envs=count), extent.seconds)

    names = [f"N = {count:,}" for count in extent.cost_sizes]
    return [
        one_row(name, "ns per axis step", partial(cost, count), extent.runs, "" if name == names[0] else names[0])
        for name, count in zip(names, extent.cost_sizes, strict=True)
    ]
