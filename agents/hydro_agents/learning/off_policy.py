"""SAC of stable-baselines3, and TQC where sb3-contrib is installed, on the native vector environment."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from pydantic import Field
from stable_baselines3 import SAC

from hydro_agents.controllers.base import Controller
from hydro_agents.learning.checkpoint import CHECKPOINT_FILE, SessionCallback, load_made_with, read_counters, session
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import Progress, training_logger, validation_errors
from hydro_agents.learning.settings import TrainingSettings
from hydro_agents.learning.training import PolicyTrainer, make_env, make_features, training_record
from hydro_agents.running.seeds import LEARNING
from hydro_agents.running.weights import Tensors, require, save_checkpoint
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group

KIND = "off-policy checkpoint"


class SACSettings(TrainingSettings):
    """Settings of SAC and TQC."""

    paired: bool = Field(False, description="reward relative to a twin under the corrected controller")
    total_steps: int = Field(500_000, ge=1, le=10**12, description="control periods, all axes together")
    axes: int = Field(64, ge=1, le=65_536)
    learning_rate: float = Field(5e-4, gt=0.0, le=1.0)
    gradient_steps: int = Field(8, ge=1, le=10_000, description="after each control period of all axes")
    batch_size: int = Field(512, ge=2, le=1_000_000)
    buffer_size: int = Field(500_000, ge=100, le=10_000_000, description="samples in the buffer")
    learning_starts: int = Field(10_000, ge=1, le=10_000_000, description="samples before the first gradient step")
    initial_entropy_weight: float = Field(0.01, gt=0.0, le=10.0, description="of the exploration; adapts in training")
    log_every: int = Field(20_000, ge=1, description="steps between rows of the log")


class OffPolicyTrainer(PolicyTrainer):
    """A trainer that learns from a buffer of past samples.

    A checkpoint holds the networks, the weight of the entropy and the number of steps. A resumed training fills a new
    buffer with the present policy and restarts its optimiser; its result therefore differs from that of an
    uninterrupted training.

    Args:
        name: of the algorithm.
        module: that holds its class.
        package: to install if the module is missing.
    """

    settings: type[Group] = SACSettings

    def __init__(self, name: str, module: str, package: str) -> None:
        self._name, self._module, self._package = name, module, package

    def train(
        self,
        config: TaskConfig,
        settings: Group,
        *,
        seed: int,
        folder: Path,
        resume: bool,
        base: Controller | None,
        progress: Callable[[Progress], None] | None,
    ) -> PolicyController:
        """Train a policy; see :class:`~hydro_agents.learning.trainers.Trainer`."""
        assert isinstance(settings, SACSettings)
        algorithm = self._algorithm()
        torch.set_num_threads(settings.torch_threads)
        features = make_features(config, settings, base)
        path = folder / CHECKPOINT_FILE
        made_with = {
            "algorithm": self._name,
            "seed": seed,
            "settings": {**settings.model_dump(mode="json"), "total_steps": 0},
            "features": features.describe(),
        }
        stored = load_made_with(path, KIND, made_with) if resume else None
        env = make_env(config, settings, features, LEARNING.training(seed, settings.axes).start)
        model = algorithm(
            "MlpPolicy",
            env,
            learning_rate=settings.learning_rate,
            buffer_size=settings.buffer_size,
            learning_starts=settings.learning_starts,
            batch_size=settings.batch_size,
            gamma=settings.discount,
            train_freq=1,
            gradient_steps=settings.gradient_steps,
            ent_coef=f"auto_{settings.initial_entropy_weight}",
            policy_kwargs={
                "net_arch": list(settings.hidden_sizes),
                "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[settings.activation],
            },
            seed=seed,
            device="cpu",
        )
        with torch.no_grad():
            model.actor.mu.weight.mul_(0.1)
        before = 0.0
        if stored is not None:
            before = _restore(model, *stored, path)
        model.set_logger(training_logger(folder, int(model.num_timesteps)))
        callback = _Callback(settings, features, path, made_with, before, progress)
        with session(model, env, callback):
            if model.num_timesteps < settings.total_steps:
                left = settings.total_steps - int(model.num_timesteps)
                model.learning_starts = int(model.num_timesteps) + settings.learning_starts
                model.learn(left, callback, log_interval=10**9, reset_num_timesteps=False)
                callback.write_checkpoint()
        record = training_record(self._name, env, seed, int(model.num_timesteps), callback.seconds, settings)
        return PolicyController.from_sb3(model, features, record)

    def _algorithm(self) -> Any:
        try:
            return getattr(importlib.import_module(self._module), self._name)
        except ImportError:
            raise ConfigurationError(
                f"trainer '{self._name.lower()}': needs the package {self._package}, which is not installed"
            ) from None


class _Callback(SessionCallback):
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
        save_checkpoint(self._path, KIND, _tensors(self.model), counters)


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
