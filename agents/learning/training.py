"""Trains PPO of stable-baselines3 on the native vector environment, with checkpoints that can be resumed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field, model_validator
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents.controllers.base import ObservationLayout
from agents.controllers.pid import PIDGains
from agents.learning.features import PolicyFeatures
from agents.learning.policy import PolicyController
from agents.learning.vec_env import AxisVecEnv
from agents.running.optimiser import optimiser_tensors, restore_optimiser
from agents.running.seeds import TRAINING_SEEDS
from agents.running.weights import load_weights, require, save_weights
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import task_config

CHECKPOINT_KIND = "PPO checkpoint"


class PPOSettings(Group):
    """Settings of the training; ``configs/agents/ppo.yaml`` holds the ones that are used."""

    residual: bool = Field(True, description="true: the policy corrects the PID; false: it acts on its own")
    residual_scale: float = Field(0.25, gt=0.0, le=2.0, description="command per 1 of the policy's output")
    paired: bool = Field(True, description="reward against a twin under the PID (residual form only)")
    practice: dict[str, Any] = Field(
        default_factory=dict, description="fields of the task that differ in training, such as what occurs more often"
    )
    total_steps: int = Field(8_000_000, ge=1, description="control periods, all axes together")
    axes: int = Field(256, ge=1, le=65_536)
    steps_per_rollout: int = Field(64, ge=2, description="control periods per axis between updates")
    minibatches: int = Field(4, ge=1)
    epochs: int = Field(4, ge=1)
    learning_rate: float = Field(1e-3, gt=0.0, le=1.0, description="at the start; falls to a tenth along a cosine")
    discount: float = Field(0.98, gt=0.0, lt=1.0)
    advantage_decay: float = Field(0.95, gt=0.0, le=1.0, description="λ of generalised advantage estimation")
    clip_range: float = Field(0.2, gt=0.0)
    entropy_weight: float = Field(0.0, ge=0.0)
    initial_log_standard_deviation: float = Field(-1.5, ge=-10.0, le=2.0, description="of the exploration")
    final_log_standard_deviation: float = Field(
        -3.0, ge=-10.0, le=2.0, description="reached linearly; left to the gradient it collapses too early"
    )
    hidden_sizes: tuple[Annotated[int, Field(ge=1, le=4096)], ...] = Field((64, 64), min_length=1)
    activation: Literal["tanh", "relu"] = Field(
        "tanh", description="of the hidden layers; relu takes a third less time"
    )
    reward_scale: float = Field(0.2, gt=0.0)
    torch_threads: int = Field(1, ge=1, le=256)

    @model_validator(mode="after")
    def _batches(self) -> PPOSettings:
        if self.axes * self.steps_per_rollout % self.minibatches:
            raise ValueError(
                f"minibatches = {self.minibatches} must divide axes × steps_per_rollout = "
                f"{self.axes * self.steps_per_rollout}"
            )
        return self


@dataclass(frozen=True)
class Progress:
    """Where a training stands."""

    steps: int
    total_steps: int
    seconds: float
    mean_reward: float  # per control period, of the episodes that ended lately


def make_features(config: TaskConfig, settings: PPOSettings, gains: PIDGains | None) -> PolicyFeatures:
    """The features that a training uses.

    Raises:
        ConfigurationError: the residual form without gains.
    """
    if settings.residual and gains is None:
        raise ConfigurationError("the residual form needs the gains of a PID")
    return PolicyFeatures(ObservationLayout.of(config), gains if settings.residual else None, settings.residual_scale)


def make_model(env: AxisVecEnv, settings: PPOSettings, seed: int) -> PPO:
    """A PPO model whose policy starts at (nearly) zero output: the residual form starts as the PID."""
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=settings.learning_rate,
        n_steps=settings.steps_per_rollout,
        batch_size=settings.axes * settings.steps_per_rollout // settings.minibatches,
        n_epochs=settings.epochs,
        gamma=settings.discount,
        gae_lambda=settings.advantage_decay,
        clip_range=settings.clip_range,
        ent_coef=settings.entropy_weight,
        policy_kwargs={
            "net_arch": {"pi": list(settings.hidden_sizes), "vf": list(settings.hidden_sizes)},
            "log_std_init": settings.initial_log_standard_deviation,
            "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[settings.activation],
        },
        seed=seed,
        device="cpu",
        verbose=0,
    )
    model.policy.get_parameter("log_std").requires_grad_(False)  # the exploration follows a schedule
    return model


class _Callback(BaseCallback):
    """Learning-rate schedule over the whole training, progress, checkpoints, stop on request."""

    def __init__(
        self,
        settings: PPOSettings,
        checkpoint: Callable[[PPO], None] | None,
        progress: Callable[[Progress], None] | None,
        checkpoint_seconds: float,
        stop: Callable[[], bool] | None,
        check: Callable[[PPO, float], bool] | None,
    ) -> None:
        super().__init__()
        self._settings = settings
        self._checkpoint = checkpoint
        self._report = progress
        self._every = checkpoint_seconds
        self._stop = stop
        self._check = check
        self._checking = 0.0
        self._ended = False
        self._begun = self._last = time.monotonic()

    def _on_step(self) -> bool:
        return not (self._ended or (self._stop is not None and self._stop()))

    def _on_rollout_start(self) -> None:
        if self._check is not None:
            assert isinstance(self.model, PPO)
            now = time.monotonic()
            self._ended = self._check(self.model, now - self._begun - self._checking)
            self._checking += time.monotonic() - now

    def _on_rollout_end(self) -> None:
        settings = self._settings
        share = min(self.num_timesteps / settings.total_steps, 1.0)
        rate = settings.learning_rate * (0.1 + 0.9 * 0.5 * (1.0 + math.cos(math.pi * share)))
        self.model.lr_schedule = lambda _: rate
        _set_exploration(self.model, settings, share)
        now = time.monotonic()
        if self._report is not None:
            episodes = list(self.model.ep_info_buffer or [])
            mean = float(np.mean([e["r"] / e["l"] for e in episodes])) if episodes else math.nan
            self._report(Progress(self.num_timesteps, settings.total_steps, now - self._begun, mean))
        if self._checkpoint is not None and now - self._last > self._every:
            self._last = now
            assert isinstance(self.model, PPO)
            self._checkpoint(self.model)


def train_ppo(
    config: TaskConfig,
    settings: PPOSettings,
    gains: PIDGains | None,
    seed: int = 0,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    checkpoint_seconds: float = 20.0,
    stop: Callable[[], bool] | None = None,
    check: Callable[[PolicyController, int, float], bool] | None = None,
) -> PolicyController:
    """Train a policy from nothing, or go on from a checkpoint.

    Args:
        config: the task.
        settings: of the training.
        gains: of the PID that the residual form corrects.
        seed: of networks, exploration, plants, references and noise.
        folder: where ``checkpoint.safetensors`` and ``.json`` go; ``None`` writes nothing.
        resume: go on from the checkpoint in ``folder``.
        progress: called after every rollout.
        checkpoint_seconds: time between checkpoints.
        stop: asked at every step; true ends the training early.
        check: called between rollouts with the policy as it stands, the steps done and the seconds that they took
            (its own not counted); true ends the training early.

    Returns:
        The trained policy.

    Raises:
        ConfigurationError: impossible settings, or a checkpoint that is missing or of other settings.
        KeyboardInterrupt: Ctrl-C; the last state has been written as a checkpoint.
    """
    torch.set_num_threads(settings.torch_threads)
    features = make_features(config, settings, gains)
    first = TRAINING_SEEDS.start + (seed * settings.axes) % (len(TRAINING_SEEDS) - settings.axes)
    checkpoint = Path(folder) / "checkpoint" if folder is not None else None
    done = 0
    if resume:
        if checkpoint is None:
            raise ConfigurationError("resume: a folder with a checkpoint is needed")
        tensors, stored = load_weights(checkpoint, CHECKPOINT_KIND)
        done = _checked_checkpoint(stored, settings, config, seed, checkpoint)
    # A resumed training meets new episodes, not those of its beginning again.
    practised = task_config(config, **settings.practice)
    env = AxisVecEnv(
        practised,
        settings.axes,
        features,
        first + done % 1000,
        settings.reward_scale,
        settings.residual and settings.paired,
        stagger=True,
    )
    model = make_model(env, settings, seed)
    with torch.no_grad():
        model.policy.get_parameter("action_net.weight").mul_(0.1 if settings.residual else 1.0)
    if resume:
        _restore(model, tensors, checkpoint)
        model.num_timesteps = done

    def save_checkpoint(current: PPO) -> None:
        if checkpoint is not None:
            _save_checkpoint(current, checkpoint, settings, config, seed)

    _set_exploration(model, settings, min(done / settings.total_steps, 1.0))

    def check_policy(current: PPO, seconds: float) -> bool:
        assert check is not None
        return check(PolicyController.from_sb3(current, features), int(current.num_timesteps), seconds)

    watching = check_policy if check is not None else None
    callback = _Callback(settings, save_checkpoint, progress, checkpoint_seconds, stop, watching)
    began = time.monotonic()
    try:
        if done < settings.total_steps:
            model.learn(settings.total_steps - done, callback=callback, reset_num_timesteps=False)
    except KeyboardInterrupt:
        save_checkpoint(model)
        raise
    finally:
        env.close()
    save_checkpoint(model)
    record = {
        "algorithm": "PPO (stable-baselines3)",
        "seed": seed,
        "steps": int(model.num_timesteps),
        "seconds": round(time.monotonic() - began, 1),
        "settings": settings.model_dump(mode="json"),
    }
    return PolicyController.from_sb3(model, features, record)


def _set_exploration(model: Any, settings: PPOSettings, share: float) -> None:
    """Set the exploration noise on its straight way from the first to the last value."""
    first, last = settings.initial_log_standard_deviation, settings.final_log_standard_deviation
    with torch.no_grad():
        model.policy.log_std.fill_(first + (last - first) * share)


def _checked_checkpoint(
    stored: dict[str, Any], settings: PPOSettings, config: TaskConfig, seed: int, path: Path
) -> int:
    if stored.get("seed") != seed:
        raise ConfigurationError(f"{path}.json: was made with seed {stored.get('seed')}, not {seed}; cannot resume")
    same = {"settings": settings.model_dump(mode="json"), "task": config.model_dump(mode="json")}
    for what, now in same.items():
        before = dict(stored.get(what) or {})
        if what == "settings":  # a training may be made longer
            before, now = {**before, "total_steps": 0}, {**now, "total_steps": 0}
        if before != now:
            changed = next((key for key in now if before.get(key) != now[key]), "format")
            raise ConfigurationError(f"{path}.json: was made with another {what} ('{changed}' differs); cannot resume")
    return int(stored["steps"])


def _save_checkpoint(model: PPO, path: Path, settings: PPOSettings, config: TaskConfig, seed: int) -> None:
    tensors = {f"policy.{name}": value.detach().cpu().numpy() for name, value in model.policy.state_dict().items()}
    tensors |= optimiser_tensors(model.policy.optimizer)
    stored = {
        "steps": int(model.num_timesteps),
        "seed": seed,
        "settings": settings.model_dump(mode="json"),
        "task": config.model_dump(mode="json"),
    }
    save_weights(path, CHECKPOINT_KIND, tensors, stored)


def _restore(model: PPO, tensors: dict[str, Any], path: Path | None) -> None:
    policy = model.policy.state_dict()
    require(tensors, {f"policy.{name}": value.numpy() for name, value in policy.items()}, str(path))
    model.policy.load_state_dict({name: torch.from_numpy(tensors[f"policy.{name}"].copy()) for name in policy})
    restore_optimiser(model.policy.optimizer, tensors, str(path))
