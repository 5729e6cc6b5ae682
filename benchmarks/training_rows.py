"""Rows of training with stable-baselines3: speed of PPO and shares of its time."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest import mock

import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from benchmarks.table import Case, Extent, Row
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.study.settings import default_study

TRAININGS = 3  # runs of each row of the training
NATIVE_ROW = "PPO, native vector environment"
PARTS = ("environment", "policy inputs and controllers", "inference", "update", "rest")
"""Parts of a training: steps and restarts of the axes; work of the adaptor; networks; stable-baselines3."""


def native_model() -> tuple[OnPolicyAlgorithm, AxisVecEnv, PPOSettings]:
    """PPO as ``make study`` trains it, on the native vector environment; its settings."""
    study = default_study()
    name = study.trained[0]
    base: Any = study.make(study.controllers[name].corrects or "")
    ppo = study.training_settings(name)
    assert isinstance(ppo, PPOSettings)
    torch.set_num_threads(1)
    env = make_env(study.task, ppo, make_features(study.task, ppo, base), 0)
    return make_model(env, ppo, 0), env, ppo


def training_cases(extent: Extent) -> list[Case]:
    """Speed of PPO on the native vector environment, and the shares of its time."""
    _, env, ppo = native_model()
    env.close()

    def measure(run: int) -> Sequence[float]:
        model, env, _ = native_model()
        model.learn(ppo.axes * ppo.steps_per_rollout)  # warm
        return _speed_and_shares(model, env, extent.training_steps)

    note = f"{ppo.axes} axes, each with its twin under the corrected controller; one thread of torch"
    rows = [Row(NATIVE_ROW, "steps/s", "", note)] + [Row(f"{NATIVE_ROW}: {part}", "% of time") for part in PARTS]
    return [Case(rows, measure, TRAININGS)]


def _speed_and_shares(model: OnPolicyAlgorithm, env: AxisVecEnv, steps: int) -> Sequence[float]:
    """Steps per second of a training, and the share of each of :data:`PARTS` in %."""
    axes = [(env.env, name, "environment") for name in ("step", "reset")]
    networks = [(model.policy, "forward", "inference"), (model, "train", "update")]
    with time_in((env, "step", "collecting"), *axes, *networks) as seconds:
        began = time.perf_counter()
        model.learn(steps)
        total = time.perf_counter() - began
    env.close()
    environment = seconds["environment"]
    parts = [environment, seconds["collecting"] - environment, seconds["inference"], seconds["update"]]
    parts.append(total - sum(parts))
    return model.num_timesteps / total, *(100.0 * part / total for part in parts)  # ``learn`` counts anew


@contextmanager
def time_in(*functions: tuple[Any, str, str]) -> Iterator[Mapping[str, float]]:
    """Seconds spent in functions (owner, attribute, name), by name; a nested call counts in both functions."""
    seconds: defaultdict[str, float] = defaultdict(float)

    def timed(plain: Callable[..., Any], name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return plain(*args, **kwargs)
            finally:
                seconds[name] += time.perf_counter() - began

        return call

    with ExitStack() as stack:
        for owner, attribute, name in functions:
            stack.enter_context(mock.patch.object(owner, attribute, timed(getattr(owner, attribute), name)))
        yield seconds
