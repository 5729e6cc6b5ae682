"""Rows of training with stable-baselines3: speed of PPO and shares of its time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from benchmarks.environment_rows import single_axis
from benchmarks.table import Case, Extent, Row, time_in
from hydro_agents.controllers.base import ClassicalController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.study.settings import default_study as read_default_study
from hydro_env import TaskConfig

TRAININGS = 3  # runs of each row of the training
SINGLE_AXES = 16  # that stable-baselines3's own vector environments run
NATIVE_ROW = "PPO, native vector environment"
PARTS = ("environment", "policy inputs and controllers", "inference", "update", "rest")
"""Parts of a training: steps and restarts of the axes; work of the adaptor; networks; stable-baselines3."""


class DefaultStudy(NamedTuple):
    """Settings of the policy of ``make study``, and the controller that it corrects."""

    task: TaskConfig
    base: ClassicalController
    ppo: PPOSettings


def default_study() -> DefaultStudy:
    """The study of ``make study``."""
    study = read_default_study()
    name = study.trained[0]
    base: Any = study.make(study.controllers[name].corrects or "")
    ppo = study.training_settings(name)
    assert isinstance(ppo, PPOSettings)
    return DefaultStudy(study.task, base, ppo)


def native_model(settings: DefaultStudy, ppo: PPOSettings) -> tuple[OnPolicyAlgorithm, AxisVecEnv]:
    """PPO as the study trains it, on the native vector environment."""
    torch.set_num_threads(ppo.torch_threads)
    features = make_features(settings.task, ppo, settings.base)
    env = make_env(settings.task, ppo, features, 0)
    return make_model(env, ppo, 0), env


def training_cases(extent: Extent) -> list[Case]:
    """Speed of PPO on the native vector environment, and on stable-baselines3's own over single axes."""
    settings = default_study()
    ppo, steps = settings.ppo, extent.training_steps

    def native(threads: int, steps: int, run: int) -> Sequence[float]:
        model, env = native_model(settings, ppo.model_copy(update={"torch_threads": threads}))
        model.learn(ppo.axes * ppo.steps_per_rollout)  # warm
        return _speed_and_shares(model, env, steps)

    def single(kind: type[VecEnv], run: int) -> Sequence[float]:
        model, env = _single_model(kind, ppo, steps // 16)
        return _speed_and_shares(model, env, steps // 16)

    def case(name: str, measure: Any, note: str) -> Case:
        rows = [Row(name, "steps/s", NATIVE_ROW if name != NATIVE_ROW else "", note)]
        rows += [Row(f"{name}: {part}", "% of time") for part in PARTS]
        return Case(tuple(rows), measure, TRAININGS)

    paired = ", each with its twin under the corrected controller" if ppo.residual and ppo.paired else ""
    size = f"{ppo.axes} axes{paired}, torch threads: {ppo.torch_threads}"
    other = 2 if ppo.torch_threads == 1 else 1
    waiting = "fewer steps: if another process uses a core, torch's threads wait for each other"
    alone = f"{SINGLE_AXES} single axes, plain observation, same updates per step"
    return [
        case(NATIVE_ROW, partial(native, ppo.torch_threads, steps), size),
        case(f"{NATIVE_ROW}, torch threads: {other}", partial(native, other, steps // 8), waiting),
        case("PPO, DummyVecEnv", partial(single, DummyVecEnv), alone),
        case("PPO, SubprocVecEnv", partial(single, SubprocVecEnv), alone),
    ]


def _speed_and_shares(model: OnPolicyAlgorithm, env: VecEnv, steps: int) -> Sequence[float]:
    """Steps per second of a training, and the share of each of :data:`PARTS` in %."""
    adapted = isinstance(env, AxisVecEnv)
    axes = [(env.env, name, "environment") for name in ("step", "reset")] if adapted else []  # type: ignore[attr-defined]
    networks = [(model.policy, "forward", "inference"), (model, "train", "update")]
    with time_in((env, "step", "collecting"), *axes, *networks) as seconds:
        began = time.perf_counter()
        model.learn(steps)
        total = time.perf_counter() - began
    env.close()
    environment = seconds["environment" if adapted else "collecting"]
    parts = [environment, seconds["collecting"] - environment, seconds["inference"], seconds["update"]]
    parts.append(total - sum(parts))
    return model.num_timesteps / total, *(100.0 * part / total for part in parts)  # ``learn`` counts anew


def _single_model(kind: type[VecEnv], ppo: PPOSettings, steps: int) -> tuple[PPO, VecEnv]:
    torch.set_num_threads(ppo.torch_threads)
    options = {"start_method": "spawn"} if kind is SubprocVecEnv else {}
    env = kind([single_axis] * SINGLE_AXES, **options)  # type: ignore[arg-type]
    rollout = min(ppo.axes * ppo.steps_per_rollout, steps)
    sizes: dict[str, Any] = {
        "n_steps": rollout // SINGLE_AXES,
        "batch_size": rollout // ppo.minibatches,
        "n_epochs": ppo.epochs,
    }
    networks = {"net_arch": {"pi": list(ppo.hidden_sizes), "vf": list(ppo.hidden_sizes)}}
    return PPO("MlpPolicy", env, policy_kwargs=networks, seed=0, device="cpu", **sizes), env
