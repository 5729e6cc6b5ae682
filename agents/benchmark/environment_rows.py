"""Rows of the environments through ``gym.make`` and ``gym.make_vec``, with Gymnasium's own in turn."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import repeat
from typing import Any

import gymnasium as gym
import numpy as np

from agents.benchmark.table import Case, Row, UnavailableError
from agents.benchmark.timing import Extent, rate
from hydro_env import ENVIRONMENT_ID

MODES = ("NextStep", "SameStep", "Disabled")
NATIVE_PEER = "CartPole-v1"


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


def vector_rate(env: Any, seconds: float, commands: Iterator[Any] | None = None) -> float:
    """Environment steps per second of a vector environment, restarts included.

    Under the actions that ``commands`` gives step by step; without it under fixed small random ones.
    """
    count: int = env.num_envs
    env.reset(seed=0)
    if commands is None:
        env.action_space.seed(0)
        actions = env.action_space.sample()
        commands = repeat((0.1 * actions).astype(np.float32) if actions.dtype.kind == "f" else actions)
    disabled = str(getattr(env.metadata.get("autoreset_mode"), "value", "")) == "Disabled"
    batch: int = max(1, 1024 // count)

    def work() -> int:
        for _ in range(batch):
            _, _, terminated, truncated, _ = env.step(next(commands))
            if disabled:
                ended = terminated | truncated
                if ended.any():
                    env.reset(options={"reset_mask": ended})
        return batch * count

    result = rate(work, seconds)
    env.close()
    return result


def motor_environment() -> gym.Env[Any, Any]:
    """gym-electric-motor's current control of a permanent magnet synchronous motor.

    Raises:
        UnavailableError: it is not installed, or does not work with the packages beside it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            gym_electric_motor = importlib.import_module("gym_electric_motor")

            env: gym.Env[Any, Any] = gym_electric_motor.make("Cont-CC-PMSM-v0")
            return env
    except ImportError as error:
        raise UnavailableError(f"not installed: {error}") from None
    except Exception as error:  # whatever an unfitting version raises
        raise UnavailableError(f"does not run here: {type(error).__name__}: {' '.join(str(error).split())}") from None


def single_cases(extent: Extent) -> list[Case]:
    """One axis beside Gymnasium's classic control and an electric drive."""

    def case(name: str, make: Callable[[], gym.Env[Any, Any]], against: str = "", note: str = "") -> Case:
        return Case(
            (Row(name, "steps/s", against, note),), lambda run: (single_rate(make(), extent.seconds),), extent.runs
        )

    own = "one axis, gym.make"
    return [
        case("Pendulum-v1", lambda: gym.make("Pendulum-v1")),
        case(own, lambda: gym.make(ENVIRONMENT_ID), "Pendulum-v1", "ServoHydraulic-v0, 5 ms per step"),
        case("CartPole-v1", lambda: gym.make("CartPole-v1")),
        case("one axis, no wrappers", lambda: gym.make(ENVIRONMENT_ID).unwrapped, "CartPole-v1"),
        case("Cont-CC-PMSM-v0", motor_environment, own, "gym-electric-motor, 0.1 ms per step"),
    ]


def vector_cases(extent: Extent) -> list[Case]:
    """N axes, every autoreset mode, beside the native vector CartPole and beside loops over single axes."""
    cases = []
    for count in extent.vector_sizes:
        peer = f"CartPole-v1, N = {count:,}"
        cases.append(_vector_case(peer, "", NATIVE_PEER, count, extent))
        for mode in MODES:
            cases.append(
                _vector_case(f"{mode}, N = {count:,}", peer, ENVIRONMENT_ID, count, extent, autoreset_mode=mode)
            )
    count = extent.vector_sizes[0]
    native = f"NextStep, N = {count:,}"
    for name, make in (("SyncVectorEnv", _sync), ("AsyncVectorEnv", _async)):
        cases.append(
            Case(
                (Row(f"{name} of single axes, N = {count:,}", "axis steps/s", native),),
                lambda run, make=make: (vector_rate(make(count), extent.seconds),),  # type: ignore[misc]
                extent.runs,
            )
        )
    return cases


def _sync(count: int) -> Any:
    return gym.vector.SyncVectorEnv([_axis] * count)


def _async(count: int) -> Any:
    return gym.vector.AsyncVectorEnv([_axis] * count, context="spawn")


def _axis() -> gym.Env[Any, Any]:
    import hydro_env  # noqa: F401  (registers, in a process of its own)

    return gym.make(ENVIRONMENT_ID)


def _vector_case(name: str, against: str, env_id: str, count: int, extent: Extent, **options: Any) -> Case:
    def measure(run: int) -> Sequence[float]:
        return (vector_rate(gym.make_vec(env_id, num_envs=count, **options), extent.seconds),)

    return Case((Row(name, "axis steps/s", against),), measure, extent.runs)


def cost_cases(extent: Extent) -> list[Case]:
    """Cost of a step of one axis against N."""
    cases = []
    first = f"N = {extent.cost_sizes[0]:,}"
    for count in extent.cost_sizes:
        name = f"N = {count:,}"

        def measure(run: int, count: int = count) -> Sequence[float]:
            return (1e9 / vector_rate(gym.make_vec(ENVIRONMENT_ID, num_envs=count), extent.seconds),)

        cases.append(Case((Row(name, "ns per axis step", first if name != first else ""),), measure, extent.runs))
    return cases
