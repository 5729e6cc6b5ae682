"""Rows of the profile: shares of the time of one step and of one PPO iteration.

Parts nest: each is measured alone, on the same environment, and compared with the whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from hydro_agents.benchmark.kernel_access import BareKernel
from hydro_agents.benchmark.table import Case, Row, one_row
from hydro_agents.benchmark.timing import Extent, rate, time_in
from hydro_agents.benchmark.training_rows import TRAININGS, default_study, native_model
from hydro_env import ENVIRONMENT_ID, ServoHydraulicEnv, ServoHydraulicVectorEnv

VECTOR_SIZE = 1024
ENDLESS: dict[str, Any] = {"episode_duration": 3600.0, "references": {"weights": {"sine": 1.0}}}


def profile_cases(extent: Extent) -> list[Case]:
    """A single step, a vector step, a PPO iteration."""
    return [*_single_cases(extent), *_vector_cases(extent), _iteration_case(extent)]


def _timed(extent: Extent, whole: str, *parts: tuple[str, Callable[[], Callable[[], Any]], str]) -> list[Case]:
    """Time in µs of calls (name, function that prepares the call, note); the later ones are parts of the first."""

    def measure(make: Callable[[], Callable[[], Any]]) -> float:
        call = make()

        def work() -> int:
            for _ in range(100):
                call()
            return 100

        return 1e6 / rate(work, extent.seconds)

    names = [f"{whole.partition(',')[0]}: {part}" if part else whole for part, _, _ in parts]
    return [
        one_row(name, "µs", partial(measure, make), extent.runs, whole if part else "", note)
        for name, (part, make, note) in zip(names, parts, strict=True)
    ]


def _step(env: Any) -> Callable[[], Any]:
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    return lambda: env.step(action)


def _compiled_step(axes: Any, count: int) -> Callable[[], Any]:
    """The compiled step of started axes; their clock is stopped, so no episode ends."""
    command, clock = np.zeros(count), axes.column("step")

    def call() -> None:
        clock[:] = 0.0
        axes.step(command)

    return call


def _single_cases(extent: Extent) -> list[Case]:
    def begun() -> ServoHydraulicEnv:
        env = ServoHydraulicEnv(**ENDLESS)
        env.reset(seed=0)
        return env

    def info() -> Callable[[], Any]:
        env = begun()
        return partial(env._info, env.axes.numbers[0].tolist())

    return _timed(
        extent,
        "single step, gym.make",
        ("", lambda: _step(gym.make(ENVIRONMENT_ID, **ENDLESS)), ""),
        ("without Gymnasium's wrappers", lambda: _step(begun()), ""),
        ("compiled step and its call", lambda: _compiled_step(begun().axes, 1), "physics, sensors, reward"),
        ("integrator and its call", lambda: BareKernel(1, 1).advance, ""),
        ("info", info, ""),
    )


def _vector_cases(extent: Extent) -> list[Case]:
    def env(info: bool, threads: int | None = 1) -> ServoHydraulicVectorEnv:
        return ServoHydraulicVectorEnv(VECTOR_SIZE, info=info, threads=threads)

    def compiled() -> Callable[[], Any]:
        bare = env(False)
        bare.reset(seed=0)
        return _compiled_step(bare.axes, VECTOR_SIZE)

    return _timed(
        extent,
        f"vector step, N = {VECTOR_SIZE:,}, 1 thread",
        ("", lambda: _step(env(True)), "restarts of ended axes included"),
        ("with as many threads as cores", lambda: _step(env(True, None)), ""),
        ("without info", lambda: _step(env(False)), ""),
        ("compiled step", compiled, "physics, sensors, reward, observation"),
        ("integrator", lambda: BareKernel(VECTOR_SIZE, 1).advance, ""),
    )


PARTS = {
    "environment: compiled step": "of both: the axes and, with paired rewards, their twins",
    "environment: features and controllers": "history, the controller below the policy, the twins' controller",
    "environment: rest": "restarts, infos, copies",
    "inference": "actor and critic on one observation per axis",
    "collection: rest": "rollout buffer, advantages, bookkeeping of stable-baselines3",
    "update: minibatches": "gathering samples from the buffer",
    "update: forward": "actor and critic",
    "update: backward": "",
    "update: optimiser": "Adam and the limit of the gradient's norm",
    "update: rest": "losses, logging",
}


def _iteration_case(extent: Extent) -> Case:
    settings = default_study()
    ppo = settings.ppo
    size = ppo.axes * ppo.steps_per_rollout

    def measure(run: int) -> Sequence[float]:
        model, env = native_model(settings, ppo)
        model.learn(size)
        iterations = max(2, extent.training_steps // (4 * size))
        functions = (
            (env, "step", "environment"),
            (env.env.axes, "step", "compiled step"),
            (env, "_inputs", "features"),
            (model.policy, "forward", "inference"),
            (model, "train", "update"),
            (model.rollout_buffer, "_get_samples", "minibatches"),
            (model.policy, "evaluate_actions", "forward"),
            (torch.Tensor, "backward", "backward"),
            (torch.nn.utils, "clip_grad_norm_", "optimiser"),
            (model.policy.optimizer, "step", "optimiser"),
        )
        with time_in(*functions) as seconds:
            began = time.perf_counter()
            model.learn(iterations * size)
            total = time.perf_counter() - began
        env.close()
        inside = [seconds["compiled step"], seconds["features"]]
        update = [seconds[name] for name in ("minibatches", "forward", "backward", "optimiser")]
        collecting, updating = seconds["environment"], seconds["update"]
        values = [total, *inside, collecting - sum(inside), seconds["inference"]]
        values += [total - collecting - seconds["inference"] - updating, *update, updating - sum(update)]
        return [1e3 * value / iterations for value in values]

    whole = "PPO iteration"
    note = f"{ppo.axes} axes × {ppo.steps_per_rollout} steps, {ppo.minibatches} minibatches, {ppo.epochs} epochs"
    rows = [Row(whole, "ms", note=note)]
    rows += [Row(f"{whole}: {part}", "ms", whole, remark) for part, remark in PARTS.items()]
    return Case(tuple(rows), measure, TRAININGS)
