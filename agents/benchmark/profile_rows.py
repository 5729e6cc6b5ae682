"""Rows that say where the time of one step and of one PPO iteration goes.

Parts nest: each is measured alone, on the same environment, and set beside the whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.benchmark.kernel_access import BareKernel
from agents.benchmark.table import Case, Row
from agents.benchmark.timing import Extent, rate
from agents.benchmark.training_rows import Stopwatch, default_study, native_model
from agents.learning.features import PolicyFeatures
from hydro_env import ENVIRONMENT_ID, ServoHydraulicEnv, ServoHydraulicVectorEnv

VECTOR_SIZE = 1024


def profile_cases(extent: Extent) -> list[Case]:
    """A single step, a vector step, a PPO iteration."""
    return [*_single_cases(extent), *_vector_cases(extent), _iteration_case(extent)]


def _timed(name: str, make: Callable[[], Callable[[], Any]], extent: Extent, against: str, note: str = "") -> Case:
    def measure(run: int) -> Sequence[float]:
        call = make()

        def work() -> int:
            for _ in range(100):
                call()
            return 100

        return (1e6 / rate(work, extent.seconds),)

    return Case((Row(name, "µs", against, note),), measure, extent.runs)


def _single_cases(extent: Extent) -> list[Case]:
    whole = "single step, gym.make"

    def wrapped() -> Callable[[], Any]:
        env = gym.make(ENVIRONMENT_ID, episode_duration=3600.0, references={"weights": {"sine": 1.0}})
        env.reset(seed=0)
        action = np.zeros(1, dtype=np.float32)
        return lambda: env.step(action)

    def bare() -> ServoHydraulicEnv:
        env = ServoHydraulicEnv(episode_duration=3600.0, references={"weights": {"sine": 1.0}})
        env.reset(seed=0)
        return env

    def unwrapped() -> Callable[[], Any]:
        env, action = bare(), np.zeros(1, dtype=np.float32)
        return lambda: env.step(action)

    def compiled() -> Callable[[], Any]:
        axes, command = bare().axes, np.zeros(1)
        return lambda: axes.step(command)

    def info() -> Callable[[], Any]:
        env = bare()
        row = env.axes.numbers[0].tolist()
        return lambda: env._info(row)

    return [
        _timed(whole, wrapped, extent, ""),
        _timed("single step: without Gymnasium's wrappers", unwrapped, extent, whole),
        _timed("single step: compiled step and its call", compiled, extent, whole, "physics, sensors, reward"),
        _timed("single step: integrator and its call", lambda: BareKernel(1, 1).advance, extent, whole),
        _timed("single step: info", info, extent, whole),
    ]


def _vector_cases(extent: Extent) -> list[Case]:
    whole = f"vector step, N = {VECTOR_SIZE:,}, 1 thread"

    def env(info: bool, threads: int | None = 1) -> ServoHydraulicVectorEnv:
        made = ServoHydraulicVectorEnv(VECTOR_SIZE, info=info, threads=threads)
        made.reset(seed=0)
        return made

    def step(info: bool, threads: int | None = 1) -> Callable[[], Any]:
        made, actions = env(info, threads), np.zeros((VECTOR_SIZE, 1), dtype=np.float32)
        return lambda: made.step(actions)

    def compiled() -> Callable[[], Any]:
        axes = env(False).axes
        command, steps = np.zeros(VECTOR_SIZE), axes.column("step")

        def call() -> None:
            steps[:] = 0.0
            axes.step(command)

        return call

    return [
        _timed(whole, lambda: step(True), extent, "", "restarts of ended axes included"),
        _timed("vector step: with as many threads as cores", lambda: step(True, None), extent, whole),
        _timed("vector step: without info", lambda: step(False), extent, whole),
        _timed("vector step: compiled step", compiled, extent, whole, "physics, sensors, reward, observation"),
        _timed("vector step: integrator", lambda: BareKernel(VECTOR_SIZE, 1).advance, extent, whole),
    ]


PARTS = {
    "environment: compiled step": "of both: the axes and, with paired rewards, their twins",
    "environment: features and PIDs": "history, the PID below the policy, the twins' PID",
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
    whole = "PPO iteration"

    def measure(run: int) -> Sequence[float]:
        settings = default_study()
        ppo = settings.ppo
        model, env = native_model(settings, ppo)
        size = ppo.axes * ppo.steps_per_rollout
        model.learn(size)
        iterations = max(2, extent.training_steps // (4 * size))
        with Stopwatch() as watch:
            watch.wrap(env, "step", "environment")
            watch.wrap(env.env.axes, "step", "compiled step")
            watch.wrap(PolicyFeatures, "__call__", "features")
            watch.wrap(env, "_drive_twins", "features")
            watch.wrap(model.policy, "forward", "inference")
            watch.wrap(model, "train", "update")
            watch.wrap(model.rollout_buffer, "_get_samples", "minibatches")
            watch.wrap(model.policy, "evaluate_actions", "forward")
            watch.wrap(torch.Tensor, "backward", "backward")
            watch.wrap(torch.nn.utils, "clip_grad_norm_", "optimiser")
            watch.wrap(model.policy.optimizer, "step", "optimiser")
            began = time.perf_counter()
            model.learn(iterations * size)
            seconds = time.perf_counter() - began
        env.close()
        parts = watch.seconds
        update = [parts[name] for name in ("minibatches", "forward", "backward", "optimiser")]
        collection = seconds - parts["environment"] - parts["inference"] - parts["update"]
        values = [
            seconds,
            parts["compiled step"],
            parts["features"],
            parts["environment"] - parts["compiled step"] - parts["features"],
            parts["inference"],
            collection,
            *update,
            parts["update"] - sum(update),
        ]
        return [1e3 * value / iterations for value in values]

    ppo = default_study().ppo
    note = f"{ppo.axes} axes × {ppo.steps_per_rollout} steps, {ppo.minibatches} minibatches, {ppo.epochs} epochs"
    rows = [Row(whole, "ms", note=note)]
    rows += [Row(f"{whole}: {part}", "ms", whole, remark) for part, remark in PARTS.items()]
    return Case(tuple(rows), measure, extent.training_runs)
