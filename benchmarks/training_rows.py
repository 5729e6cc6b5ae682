"""Rows of training with stable-baselines3: speed of PPO, shares of its time, and time until it beats the PID."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from benchmarks.environment_rows import single_axis
from benchmarks.table import Case, Extent, Row, time_in
from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.evaluation.evaluate import ProtocolSettings
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.learning.opponents import shipped
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model, train_ppo
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import THRESHOLDS
from hydro_agents.study.settings import default_study as read_default_study
from hydro_env import TaskConfig

TRAININGS = 3  # runs of each row of the training
PLANTS = 4  # per leak level and kind of reference, for the comparison with the PID
SINGLE_AXES = 16  # that stable-baselines3's own vector environments run
NATIVE_ROW = "PPO, native vector environment"
PARTS = ("environment", "policy inputs and controllers", "inference", "update", "rest")
"""Parts of a training: steps and restarts of the axes; work of the adaptor; networks; stable-baselines3."""

CHECK_EVERY = 50_000  # steps
MARGIN = 0.01
"""Required reduction of the PID's error; an untrained correction differs from the PID by less."""

IN_A_ROW = 3
"""Required number of successive checks below the PID; a single lucky check does not count."""


class DefaultStudy(NamedTuple):
    """Settings of the policy of ``make study``, and the controller that it corrects."""

    task: TaskConfig
    base: ClassicalController
    ppo: PPOSettings
    evaluation: ProtocolSettings


def default_study() -> DefaultStudy:
    """The study of ``make study``."""
    study = read_default_study()
    name = study.trained[0]
    base: Any = study.make(study.controllers[name].corrects or "")
    ppo = study.training_settings(name)
    assert isinstance(ppo, PPOSettings)
    return DefaultStudy(study.task, base, ppo, study.evaluation)


def study_of_the_pid() -> DefaultStudy:
    """The same training as a correction of the tuned PID, which estimates nothing."""
    study = default_study()
    pid: Any = shipped("pid", study.task)
    return study._replace(base=pid, ppo=study.ppo.model_copy(update={"see_estimates": False}))


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


# Time until PPO beats the PID ---------------------------------------------------------------------------------------


def validation_error(settings: DefaultStudy, controller: Controller, plants: int) -> float:
    """Mean absolute error in mm over all leak levels and kinds of reference, on validation plants."""
    levels, families = settings.evaluation.leak_levels, settings.evaluation.families
    grid = [(level, family, plant) for level in levels for family in families for plant in range(plants)]
    own = {family: THRESHOLDS.take(plants, 1000 * number) for number, family in enumerate(families)}
    seeds = np.array([own[family][plant] for _, family, plant in grid])
    cases = Cases(seeds, np.array([level for level, _, _ in grid]), np.array([family for _, family, _ in grid]))
    rollout = run_cases(settings.task, controller, cases)
    assert cases.families is not None
    return float(rollout_metrics(rollout, cases.families, settings.task.control_period)["mean_error_mm"].mean())


def time_to_beat_pid(settings: DefaultStudy, seed: int, plants: int) -> tuple[float, int, float]:
    """Train until the policy's validation error is 1 % below the PID's at three checks in a row.

    Returns:
        Training time (s, without checks) and steps at the first of these checks, and the time of the checks (s).

    Raises:
        RuntimeError: a whole training did not reach this error.
    """
    pid = settings.base
    bar = (1.0 - MARGIN) * validation_error(settings, pid, plants)
    below: list[tuple[float, int]] = []
    checking, next_check = 0.0, 0

    def check(policy: PolicyController, steps: int, seconds: float) -> bool:
        nonlocal checking, next_check
        if steps < next_check:
            return False
        next_check = steps + CHECK_EVERY
        began = time.perf_counter()
        if validation_error(settings, policy, plants) < bar:
            below.append((seconds, steps))
        else:
            below.clear()
        checking += time.perf_counter() - began
        return len(below) >= IN_A_ROW

    train_ppo(settings.task, settings.ppo, settings.base, seed, check=check)
    if not below:
        raise RuntimeError("PPO did not reach the PID's error")
    return *below[0], checking


def beating_cases(extent: Extent) -> list[Case]:
    """Time until PPO's mean error is below the tuned PID's."""
    settings = study_of_the_pid()
    cases = len(settings.evaluation.leak_levels) * len(settings.evaluation.families) * PLANTS
    note = f"mean error 1 % lower on {cases} validation cases; checked every {CHECK_EVERY:,} steps, checks not counted"
    rows = (
        Row("time until PPO on PID beats the tuned PID", "s", note=f"a run is a seed; {note}"),
        Row("steps until then", "steps"),
        Row("time of the checks, not counted", "s"),
    )
    return [Case(rows, lambda seed: time_to_beat_pid(settings, seed, PLANTS), extent.runs)]
