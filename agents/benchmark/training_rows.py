"""Rows of training with stable-baselines3: speed of PPO, where its time goes, and how soon it beats the PID."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple
from unittest import mock

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from agents.benchmark.table import Case, Row
from agents.benchmark.timing import Extent
from agents.controllers.base import Controller, ObservationLayout
from agents.controllers.pid import PID, PIDGains
from agents.evaluation.metrics import rollout_metrics
from agents.evaluation.protocol import ProtocolSettings
from agents.learning.policy import PolicyController
from agents.learning.training import PPOSettings, make_env, make_features, make_model, train_ppo
from agents.learning.vec_env import AxisVecEnv
from agents.running.cases import Cases, run_cases
from agents.running.seeds import VALIDATION_SEEDS
from agents.study.settings import default_study as read_default_study
from hydro_env import ENVIRONMENT_ID, TaskConfig

SINGLE_AXES = 16  # that stable-baselines3's own vector environments run
NATIVE_ROW = "PPO, native vector environment"
CHECK_EVERY = 50_000  # steps
MARGIN = 0.01
"""How far below the PID's error the policy's must be: an untrained correction differs from the PID by less."""

IN_A_ROW = 3
"""Checks in a row that must be below the PID, so that one lucky check does not count."""


class DefaultStudy(NamedTuple):
    """What ``make study`` trains, and the PID that it corrects."""

    task: TaskConfig
    pid: PIDGains
    ppo: PPOSettings
    evaluation: ProtocolSettings


def default_study() -> DefaultStudy:
    """The study of ``make study``."""
    study = read_default_study()
    name = study.trained[0]
    base, ppo = study.make(study.controllers[name].corrects or ""), study.training_settings(name)
    assert isinstance(base, PID)
    assert isinstance(ppo, PPOSettings)
    return DefaultStudy(study.task, base.gains, ppo, study.evaluation)


PARTS = ("environment", "policy inputs and PIDs", "inference", "update", "rest")
"""Parts of a training: the axes' steps and restarts; what the adaptor makes of them; networks; stable-baselines3."""


class Stopwatch:
    """Seconds that calls of some functions took, by name; puts the functions back at the end of its context."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Stopwatch:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def wrap(self, owner: Any, function: str, name: str) -> None:
        """Note the time of a function or method of ``owner`` under a name."""
        plain = getattr(owner, function)

        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return plain(*args, **kwargs)
            finally:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began

        self._stack.enter_context(mock.patch.object(owner, function, timed))


def native_model(settings: DefaultStudy, ppo: PPOSettings) -> tuple[PPO, AxisVecEnv]:
    """PPO as the study trains it, on the native vector environment."""
    torch.set_num_threads(ppo.torch_threads)
    features = make_features(settings.task, ppo, settings.pid)
    env = make_env(settings.task, ppo, features, 0)
    return make_model(env, ppo, 0), env


def watched_training(model: PPO, env: VecEnv, steps: int) -> tuple[float, dict[str, float]]:
    """Train for some steps; returns wall time (s), and of it the time in each of :data:`PARTS` but the rest."""
    with Stopwatch() as watch:
        watch.wrap(env, "step", "collecting")
        if isinstance(env, AxisVecEnv):
            for function in ("step", "reset"):
                watch.wrap(env.env, function, "environment")
        watch.wrap(model.policy, "forward", "inference")
        watch.wrap(model, "train", "update")
        began = time.perf_counter()
        model.learn(steps)
        seconds = time.perf_counter() - began
    parts = watch.seconds
    collecting = parts.pop("collecting")
    parts.setdefault("environment", collecting)
    parts["policy inputs and PIDs"] = collecting - parts["environment"]
    return seconds, parts


def training_cases(extent: Extent) -> list[Case]:
    """Speed of PPO on the native vector environment, and on stable-baselines3's own over single axes."""
    settings = default_study()
    ppo = settings.ppo

    def native(run: int, threads: int = ppo.torch_threads, share: int = 1) -> Sequence[float]:
        model, env = native_model(settings, ppo.model_copy(update={"torch_threads": threads}))
        model.learn(ppo.axes * ppo.steps_per_rollout)  # warm
        return _speed_and_shares(model, env, extent.training_steps // share)

    paired = ", each with its twin under the PID" if ppo.residual and ppo.paired else ""
    size = f"{ppo.axes} axes{paired}, torch threads: {ppo.torch_threads}"
    cases = [Case((Row(NATIVE_ROW, "steps/s", note=size), *_share_rows(NATIVE_ROW)), native, extent.training_runs)]
    other = 2 if ppo.torch_threads == 1 else 1
    waiting = "fewer steps: where another process holds a core, torch's threads wait for each other"
    row = Row(f"{NATIVE_ROW}, torch threads: {other}", "steps/s", NATIVE_ROW, waiting)
    cases.append(Case((row, *_share_rows(row.name)), lambda run: native(run, other, 8), extent.training_runs))
    for kind in (DummyVecEnv, SubprocVecEnv):
        name = f"PPO, {kind.__name__}"

        def single(run: int, kind: type[VecEnv] = kind) -> Sequence[float]:
            model, env = _single_model(kind, ppo, extent)
            return _speed_and_shares(model, env, extent.single_training_steps)

        row = Row(name, "steps/s", NATIVE_ROW, f"{SINGLE_AXES} single axes, plain observation, same updates per step")
        cases.append(Case((row, *_share_rows(name)), single, extent.training_runs))
    return cases


def _share_rows(name: str) -> list[Row]:
    return [Row(f"{name}: {part}", "% of time") for part in PARTS]


def _speed_and_shares(model: PPO, env: VecEnv, steps: int) -> Sequence[float]:
    seconds, parts = watched_training(model, env, steps)
    done = model.num_timesteps  # of this call: ``learn`` counts anew
    env.close()
    shares = [100.0 * parts[name] / seconds for name in PARTS[:-1]]
    return done / seconds, *shares, 100.0 - sum(shares)


def _single_model(kind: type[VecEnv], ppo: PPOSettings, extent: Extent) -> tuple[PPO, VecEnv]:
    torch.set_num_threads(ppo.torch_threads)
    makers = [_single_axis] * SINGLE_AXES
    env = SubprocVecEnv(makers, start_method="spawn") if kind is SubprocVecEnv else DummyVecEnv(makers)
    rollout = min(ppo.axes * ppo.steps_per_rollout, extent.single_training_steps)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=rollout // SINGLE_AXES,
        batch_size=rollout // ppo.minibatches,
        n_epochs=ppo.epochs,
        policy_kwargs={"net_arch": {"pi": list(ppo.hidden_sizes), "vf": list(ppo.hidden_sizes)}},
        seed=0,
        device="cpu",
    )
    return model, env


def _single_axis() -> gym.Env[Any, Any]:
    import hydro_env  # noqa: F401  (registers, in a process of its own)

    return gym.make(ENVIRONMENT_ID)


# Time until PPO beats the PID ---------------------------------------------------------------------------------------


def validation_error(settings: DefaultStudy, controller: Controller, plants: int) -> float:
    """Mean absolute error in mm over all leak levels and kinds of reference, on validation plants."""
    levels, families = settings.evaluation.leak_levels, settings.evaluation.families
    grid = [(level, family, plant) for level in levels for family in families for plant in range(plants)]
    seeds = np.array([VALIDATION_SEEDS.start + 1000 * families.index(family) + plant for _, family, plant in grid])
    cases = Cases(seeds, np.array([level for level, _, _ in grid]), np.array([family for _, family, _ in grid]))
    rollout = run_cases(settings.task, controller, cases)
    assert cases.families is not None
    return float(rollout_metrics(rollout, cases.families, settings.task.control_period)["mean_error_mm"].mean())


def time_to_beat_pid(settings: DefaultStudy, seed: int, plants: int) -> tuple[float, int, float]:
    """Train until the policy's validation error is 1 % below the PID's at three checks in a row.

    Returns:
        Training time (s, checks not counted) and steps at the first of these checks, and the time the checks took (s).

    Raises:
        RuntimeError: it never happened in a whole training.
    """
    layout = ObservationLayout.of(settings.task)
    bar = (1.0 - MARGIN) * validation_error(settings, PID(settings.pid, layout), plants)
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

    train_ppo(settings.task, settings.ppo, settings.pid, seed, check=check)
    if not below:
        raise RuntimeError("PPO did not get below the PID")
    return *below[0], checking


def beating_cases(extent: Extent) -> list[Case]:
    """How soon PPO's mean error is below the tuned PID's."""
    settings = default_study()
    cases = len(settings.evaluation.leak_levels) * len(settings.evaluation.families) * extent.plants
    note = f"mean error 1 % lower on {cases} validation cases; checked every {CHECK_EVERY:,} steps, checks not counted"

    def measure(run: int) -> Sequence[float]:
        return time_to_beat_pid(settings, run, extent.plants)

    rows = (
        Row("time until PPO beats the tuned PID", "s", note=f"a run is a seed; {note}"),
        Row("steps until then", "steps"),
        Row("time of the checks, not counted", "s"),
    )
    return [Case(rows, measure, extent.seeds)]
