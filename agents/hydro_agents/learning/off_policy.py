"""Trains SAC of stable-baselines3 and TQC of sb3-contrib, which learn from a buffer of past samples.

They write no checkpoint: the buffer would take gigabytes. An interrupted training begins again.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from sb3_contrib import TQC
from stable_baselines3 import SAC

from hydro_agents.controllers.base import Controller
from hydro_agents.learning.checkpoint import SessionCallback, session
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import Progress, training_logger
from hydro_agents.learning.settings import SACSettings
from hydro_agents.learning.training import ACTIVATIONS, discount, make_env, make_features, training_record
from hydro_agents.running.cases import validation_errors
from hydro_agents.running.seeds import LEARNING
from hydro_env import TaskConfig

ALGORITHMS: dict[str, Any] = {"SAC": SAC, "TQC": TQC}


def train_off_policy(
    name: str,
    config: TaskConfig,
    settings: SACSettings,
    base: Controller | None,
    seed: int,
    folder: Path,
    progress: Callable[[Progress], None] | None,
) -> PolicyController:
    """Train a policy with an algorithm of :data:`ALGORITHMS`.

    The arguments are those of :func:`~hydro_agents.learning.training.train_ppo`.

    Raises:
        ConfigurationError: as :meth:`~hydro_agents.learning.trainers.Trainer.train`.
    """
    torch.set_num_threads(settings.torch_threads)
    features = make_features(config, settings, base)
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
    model.set_logger(training_logger(folder, 0))
    callback = _OffPolicyCallback(settings, features, progress)
    with session(model, env, callback):
        model.learn(settings.total_steps, callback, log_interval=10**9)
    record = training_record(name, env, seed, int(model.num_timesteps), callback.seconds, settings)
    return PolicyController.from_sb3(model, features, record)


class _OffPolicyCallback(SessionCallback):
    """Logs, validates and reports every ``log_every`` steps."""

    def __init__(
        self, settings: SACSettings, features: PolicyFeatures, progress: Callable[[Progress], None] | None
    ) -> None:
        super().__init__(settings, 0.0, progress)
        self._settings, self._features = settings, features

    def _on_step(self) -> bool:
        every, steps = self._settings.log_every, self.num_timesteps
        if steps // every > (steps - self._settings.axes) // every:
            errors = {}
            if self.validates(steps, every):
                policy = PolicyController.from_sb3(self.model, self._features)
                errors = {"mean_error_mm": validation_errors(self._features.config, policy)[0]}
            self.log(steps, errors)
            self.report()
        return True
