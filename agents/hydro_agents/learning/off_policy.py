"""Trains SAC of stable-baselines3 and TQC of sb3-contrib, which learn from a buffer of past samples; resumable."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from sb3_contrib import TQC
from stable_baselines3 import SAC

from hydro_agents.controllers.base import Controller
from hydro_agents.learning.checkpoint import (
    CHECKPOINT_FILE,
    SessionCallback,
    load_made_with,
    read_counters,
    session,
)
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import Progress, training_logger
from hydro_agents.learning.settings import SACSettings
from hydro_agents.learning.training import ACTIVATIONS, discount, make_env, make_features, training_record
from hydro_agents.running.cases import validation_errors
from hydro_agents.running.seeds import LEARNING
from hydro_agents.running.weights import Tensors, require, save_checkpoint
from hydro_env import TaskConfig

OFF_POLICY = "off-policy checkpoint"
ALGORITHMS: dict[str, Any] = {"SAC": SAC, "TQC": TQC}


def train_off_policy(
    name: str,
    config: TaskConfig,
    settings: SACSettings,
    base: Controller | None,
    seed: int,
    folder: Path,
    resume: bool,
    progress: Callable[[Progress], None] | None,
) -> PolicyController:
    """Train a policy with an algorithm of :data:`ALGORITHMS`.

    The arguments are those of :func:`~hydro_agents.learning.training.train_ppo`.
    A checkpoint holds the networks, the weight of the entropy and the number of steps. A resumed training fills a new
    buffer with the present policy and restarts its optimiser; its result therefore differs from that of an
    uninterrupted training.

    Raises:
        ConfigurationError: as :meth:`~hydro_agents.learning.trainers.Trainer.train`.
    """
    torch.set_num_threads(settings.torch_threads)
    features = make_features(config, settings, base)
    path = folder / CHECKPOINT_FILE
    made_with = {
        "algorithm": name,
        "seed": seed,
        "settings": {**settings.model_dump(mode="json"), "total_steps": 0},
        "features": features.describe(),
    }
    stored = load_made_with(path, OFF_POLICY, made_with) if resume else None
    env = make_env(config, settings, features, LEARNING.training(seed, settings.axes).start)
    model = ALGORITHMS[name](
        "MlpPolicy",
        env,
        learning_rate=settings.learning_rate,
        buffer_size=settings.buffer_size,
        learning_starts=settings.learning_starts,
        batch_size=settings.batch_size,
        gamma=discount(features.config, settings),
        train_freq=1,
        gradient_steps=settings.gradient_steps,
        ent_coef=f"auto_{settings.initial_entropy_weight}",
        policy_kwargs={"net_arch": list(settings.hidden_sizes), "activation_fn": ACTIVATIONS[settings.activation]},
        seed=seed,
        device="cpu",
    )
    with torch.no_grad():
        model.actor.mu.weight.mul_(0.1)
    before = _restore(model, *stored, path) if stored is not None else 0.0
    model.set_logger(training_logger(folder, int(model.num_timesteps)))
    callback = _OffPolicyCallback(settings, features, path, made_with, before, progress)
    with session(model, env, callback):
        if model.num_timesteps < settings.total_steps:
            left = settings.total_steps - int(model.num_timesteps)
            model.learning_starts = int(model.num_timesteps) + settings.learning_starts
            model.learn(left, callback, log_interval=10**9, reset_num_timesteps=False)
            callback.write_checkpoint()
    record = training_record(name, env, seed, int(model.num_timesteps), callback.seconds, settings)
    return PolicyController.from_sb3(model, features, record)


class _OffPolicyCallback(SessionCallback):
    """Logs and writes checkpoints every ``log_every`` steps."""

    model: SAC

    def __init__(
        self,
        settings: SACSettings,
        features: Any,
        path: Path,
        made_with: dict[str, Any],
        seconds: float,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        super().__init__(settings, seconds, progress)
        self._settings, self._features, self._path, self._made_with = settings, features, path, made_with

    def _on_step(self) -> bool:
        settings, steps = self._settings, self.num_timesteps
        if steps // settings.log_every == (steps - settings.axes) // settings.log_every:
            return True
        found = {}
        if self.validates(steps, settings.log_every):
            policy = PolicyController.from_sb3(self.model, self._features)
            found = {"mean_error_mm": validation_errors(self._features.config, policy)[0]}
        self.log(steps, found)
        self.write_checkpoint()
        self.report()
        return True

    def write_checkpoint(self) -> None:
        """Write a checkpoint."""
        counters = {"steps": int(self.model.num_timesteps), "seconds": self.seconds, "made_with": self._made_with}
        save_checkpoint(self._path, OFF_POLICY, _tensors(self.model), counters)


def _tensors(model: SAC) -> Tensors:
    networks = {f"policy.{name}": value.detach().numpy().copy() for name, value in model.policy.state_dict().items()}
    assert model.log_ent_coef is not None
    return {**networks, "log_entropy_weight": model.log_ent_coef.detach().numpy().copy()}


def _restore(model: SAC, tensors: Tensors, stored: dict[str, Any], path: Path) -> float:
    """Set networks and number of steps; returns the seconds of the earlier sessions."""
    require(tensors, _tensors(model), path)
    steps, seconds = read_counters(stored, ("steps", "seconds"), path)
    names = model.policy.state_dict()
    model.policy.load_state_dict({name: torch.from_numpy(tensors[f"policy.{name}"].copy()) for name in names})
    assert model.log_ent_coef is not None
    with torch.no_grad():
        model.log_ent_coef.copy_(torch.from_numpy(tensors["log_entropy_weight"].copy()))
    model.num_timesteps = int(steps)
    return seconds
