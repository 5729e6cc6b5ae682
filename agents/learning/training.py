"""Trains PPO of stable-baselines3 on the native vector environment, with checkpoints for resuming."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import ConfigDict, Field, model_validator
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents.controllers.base import ClassicalController, ObservationLayout
from agents.learning.checkpoint import CHECKPOINT_FILE, Checkpoint, load, restore, save, take
from agents.learning.features import PolicyFeatures
from agents.learning.policy import PolicyController
from agents.learning.progress import Progress, training_logger
from agents.learning.validation import validation_errors
from agents.learning.vec_env import AxisVecEnv
from agents.running.seeds import TRAINING_SEEDS
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import task_config

LARGEST_ROLLOUT = 10_000_000
"""Largest number of samples of a rollout; it takes some gigabytes of memory."""


class PPOSettings(Group):
    """Settings of the training; ``configs/agents/ppo.yaml`` holds those of the studies."""

    model_config = ConfigDict(allow_inf_nan=False)

    residual: bool = Field(True, description="true: the policy corrects the PID; false: it acts on its own")
    residual_scale: float = Field(0.25, gt=0.0, le=2.0, description="command per 1 of the policy's output")
    paired: bool = Field(True, description="reward against a twin under the PID (residual form only)")
    practice: dict[str, Any] = Field(
        default_factory=dict, description="fields of the task that differ in training, such as the share of leaks"
    )
    total_steps: int = Field(8_000_000, ge=1, le=10**12, description="control periods, all axes together")
    axes: int = Field(256, ge=1, le=65_536)
    steps_per_rollout: int = Field(64, ge=2, le=1_000_000, description="control periods per axis between updates")
    minibatches: int = Field(4, ge=1)
    epochs: int = Field(4, ge=1, le=1000)
    learning_rate: float = Field(1e-3, gt=0.0, le=1.0, description="at the start; falls to a tenth along a cosine")
    discount: float = Field(0.98, gt=0.0, lt=1.0)
    advantage_decay: float = Field(0.95, gt=0.0, le=1.0, description="λ of generalised advantage estimation")
    clip_range: float = Field(0.2, gt=0.0, le=10.0)
    entropy_weight: float = Field(0.0, ge=0.0, le=10.0)
    initial_log_standard_deviation: float = Field(-1.5, ge=-10.0, le=2.0, description="of the exploration")
    final_log_standard_deviation: float = Field(
        -3.0, ge=-10.0, le=2.0, description="linear schedule; the gradient alone would reduce it too early"
    )
    hidden_sizes: tuple[Annotated[int, Field(ge=1, le=4096)], ...] = Field((64, 64), min_length=1, max_length=16)
    activation: Literal["tanh", "relu"] = Field(
        "tanh", description="of the hidden layers; relu takes a third less time"
    )
    reward_scale: float = Field(0.2, gt=0.0, le=1e6)
    validation_every: int = Field(1_000_000, ge=0, description="steps between errors on validation plants; 0: none")
    torch_threads: int = Field(1, ge=1, le=256)

    @model_validator(mode="after")
    def _batches(self) -> PPOSettings:
        rollout = self.axes * self.steps_per_rollout
        if rollout > LARGEST_ROLLOUT:
            raise ValueError(f"axes × steps_per_rollout = {rollout} must not exceed {LARGEST_ROLLOUT}")
        if rollout % self.minibatches or rollout // self.minibatches < 2:
            raise ValueError(
                f"minibatches = {self.minibatches} must divide axes × steps_per_rollout = {rollout} "
                "into parts of at least 2"
            )
        return self

    def learning_rate_at(self, remaining: float) -> float:
        """Learning rate when the share ``remaining`` of the training (1 to 0) is left."""
        share = min(1.0 - remaining, 1.0)  # the last rollout may go past the end
        return self.learning_rate * (0.1 + 0.9 * 0.5 * (1.0 + math.cos(math.pi * share)))

    def log_standard_deviation_at(self, share: float) -> float:
        """Logarithm of the exploration's standard deviation when a share (0 to 1) of the training is done."""
        first, last = self.initial_log_standard_deviation, self.final_log_standard_deviation
        return first + (last - first) * share


def make_features(config: TaskConfig, settings: PPOSettings, base: ClassicalController | None) -> PolicyFeatures:
    """The features that a training uses.

    Raises:
        ConfigurationError: the residual form without a controller to correct.
    """
    if settings.residual and base is None:
        raise ConfigurationError("the residual form needs a controller that the policy corrects")
    return PolicyFeatures(config, base if settings.residual else None, settings.residual_scale)


def make_env(config: TaskConfig, settings: PPOSettings, features: PolicyFeatures, seed: int) -> AxisVecEnv:
    """The axes of a training; ``practice`` may change their episodes, but not the observations.

    Raises:
        ConfigurationError: ``practice`` is no part of a task, or changes the observations or the control period.
    """
    try:
        practised = task_config(config, **settings.practice)
    except ConfigurationError as error:
        raise ConfigurationError(f"ppo.practice: {error}") from None
    if ObservationLayout.of(practised) != ObservationLayout.of(config):
        raise ConfigurationError(
            f"ppo.practice = {settings.practice}: must leave the control period and the names and scales of "
            "observations as they are in the task, because the policy must work there"
        )
    paired = settings.residual and settings.paired
    return AxisVecEnv(practised, settings.axes, features, seed, settings.reward_scale, paired, stagger=True)


def make_model(env: AxisVecEnv, settings: PPOSettings, seed: int) -> PPO:
    """A PPO model whose policy starts at (nearly) zero output: the residual form starts as the PID."""
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=settings.learning_rate_at,
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
    with torch.no_grad():
        model.policy.get_parameter("action_net.weight").mul_(0.1 if settings.residual else 1.0)
    return model


class _Callback(BaseCallback):
    """Logs, writes checkpoints and calls ``check`` between rollouts; sets the exploration after each."""

    model: PPO

    def __init__(
        self,
        settings: PPOSettings,
        seconds: float,
        progress: Callable[[Progress], None] | None,
        write: Callable[[Checkpoint], None] | None,
        checkpoint_seconds: float,
        check: Callable[[float], bool],
        validate: Callable[[], dict[str, float]],
    ) -> None:
        super().__init__()
        self._settings = settings
        self._progress = progress
        self._write = write
        self._every = checkpoint_seconds
        self._check = check
        self._validate = validate
        self._began = time.monotonic() - seconds
        self._written: float | None = None
        self._checkpoint: Checkpoint | None = None
        self._logged = -1
        self._ended = False

    @property
    def seconds(self) -> float:
        """Duration of training, all sessions together, without the caller's checks."""
        return time.monotonic() - self._began

    def _on_training_start(self) -> None:
        self._logged = self.num_timesteps

    def _on_rollout_start(self) -> None:
        self._between_rollouts()
        before = time.monotonic()
        self._ended = self._check(self.seconds)
        self._began += time.monotonic() - before

    def _on_step(self) -> bool:
        return not self._ended

    def _on_rollout_end(self) -> None:
        settings, steps = self._settings, self.num_timesteps
        share = min(steps / settings.total_steps, 1.0)
        with torch.no_grad():
            self.model.policy.get_parameter("log_std").fill_(settings.log_standard_deviation_at(share))
        if self._progress is not None:
            self._progress(Progress(steps, settings.total_steps, self.seconds, self._mean_reward()))

    def _on_training_end(self) -> None:
        if not self._ended:
            self._between_rollouts()
        self.write_checkpoint()

    def _mean_reward(self) -> float:
        episodes = self.model.ep_info_buffer or ()
        return float(np.mean([episode["r"] / episode["l"] for episode in episodes])) if episodes else math.nan

    def _between_rollouts(self) -> None:
        """Log the last rollout and its update, and copy the state at the start of the next one."""
        steps = self.num_timesteps
        if steps > self._logged:
            self._log(steps, steps - self._logged)
            self._logged = steps
        if self._write is not None:
            env = self.model.get_env()
            assert isinstance(env, AxisVecEnv)
            self._checkpoint = take(self.model, env, self.seconds)
            if self._written is None or time.monotonic() - self._written > self._every:
                self.write_checkpoint()

    def _log(self, steps: int, rollout: int) -> None:
        every = self._settings.validation_every
        if every and (steps // every > (steps - rollout) // every or steps >= self._settings.total_steps):
            for name, value in self._validate().items():
                self.logger.record(f"validation/{name}", value)
        lengths = [episode["l"] for episode in self.model.ep_info_buffer or ()]
        self.logger.record("rollout/mean_reward", self._mean_reward())
        self.logger.record("rollout/ep_len_mean", float(np.mean(lengths)) if lengths else math.nan)
        self.logger.record("time/time_elapsed", self.seconds)
        self.logger.dump(steps)

    def write_checkpoint(self) -> None:
        """Write the state at the start of the present rollout, or of the next one between rollouts."""
        if self._write is not None and self._checkpoint is not None:
            self._write(self._checkpoint)
            self._written = time.monotonic()


def train_ppo(
    config: TaskConfig,
    settings: PPOSettings,
    base: ClassicalController | None,
    seed: int = 0,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    checkpoint_seconds: float = 20.0,
    check: Callable[[PolicyController, int, float], bool] | None = None,
) -> PolicyController:
    """Train a new policy, or continue from a checkpoint as if there had been no interruption.

    Args:
        config: the task.
        settings: settings of the training.
        base: the controller that the residual form corrects.
        seed: seed of networks, exploration, plants, references and noise.
        folder: for ``checkpoint.safetensors``, ``progress.csv`` and logs of TensorBoard; ``None`` writes nothing.
        resume: continue from the checkpoint in ``folder``.
        progress: called after every rollout.
        checkpoint_seconds: time between checkpoints; the first is written before the first rollout.
        check: called between rollouts with the present policy, the number of steps and the seconds of training
            (without its own); true ends the training early.

    Returns:
        The trained policy.

    Raises:
        ConfigurationError: impossible settings, or a checkpoint that is missing, damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the checkpoint holds the start of the interrupted rollout.
    """
    torch.set_num_threads(settings.torch_threads)
    features = make_features(config, settings, base)
    described = settings.model_dump(mode="json")
    made_with = {
        "seed": seed,
        "settings": {**described, "total_steps": 0},  # a resumed training may be longer
        "task": config.model_dump(mode="json"),
        "features": features.describe(),
    }
    place = Path(folder) if folder is not None else None
    if resume and place is None:
        raise ConfigurationError("resume: a folder with a checkpoint is needed")
    checkpoint = None
    if place is not None and resume:
        checkpoint = load(place, made_with)
    elif place is not None:
        (place / CHECKPOINT_FILE).unlink(missing_ok=True)
    done = checkpoint.steps if checkpoint is not None else 0

    first = TRAINING_SEEDS.start + (seed * settings.axes) % (len(TRAINING_SEEDS) - settings.axes)
    env = make_env(config, settings, features, first)
    model = make_model(env, settings, seed)
    model.set_logger(training_logger(place, done))

    def current() -> PolicyController:
        return PolicyController.from_sb3(model, features)

    base_error = math.nan  # of the corrected PID; computed once

    def validation() -> dict[str, float]:
        nonlocal base_error
        if settings.residual and base is not None and math.isnan(base_error):
            base_error = validation_errors(config, base)[0]
        mean, worst, failures = validation_errors(config, current())
        return {"mean_error_mm": mean, "worst_error_mm": worst, "failures": failures, "base_mean_error_mm": base_error}

    callback = _Callback(
        settings,
        checkpoint.seconds if checkpoint is not None else 0.0,
        progress,
        None if place is None else lambda taken: save(taken, place, made_with),
        checkpoint_seconds,
        lambda seconds: check is not None and check(current(), int(model.num_timesteps), seconds),
        validation,
    )
    try:
        if checkpoint is not None and place is not None:
            restore(model, env, checkpoint, place / CHECKPOINT_FILE)
        if done < settings.total_steps:
            never = settings.total_steps  # the callback writes the log after the update
            model.learn(settings.total_steps - done, callback, log_interval=never, reset_num_timesteps=False)
    except KeyboardInterrupt:
        callback.write_checkpoint()
        raise
    finally:
        model.logger.close()
        env.close()
    record = {
        "algorithm": "PPO (stable-baselines3)",
        "seed": seed,
        "steps": int(model.num_timesteps),
        "seconds": round(callback.seconds, 1),
        "settings": described,
    }
    return PolicyController.from_sb3(model, features, record)
