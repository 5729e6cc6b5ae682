"""Work between the rollouts of PPO: log, checkpoints, schedule of the exploration."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from hydro_agents.learning.checkpoint import Checkpoint, take
from hydro_agents.learning.progress import Progress
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.vec_env import AxisVecEnv


class TrainingCallback(BaseCallback):
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
        """Log the last rollout and its update, and copy the state at the start of the next rollout."""
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
        env = self.model.get_env()
        assert isinstance(env, AxisVecEnv)
        for name, value in env.mean_rewards().items():
            self.logger.record(f"reward/{name}", value)
        lengths = [episode["l"] for episode in self.model.ep_info_buffer or ()]
        self.logger.record("rollout/mean_reward", self._mean_reward())
        self.logger.record("rollout/ep_len_mean", float(np.mean(lengths)) if lengths else math.nan)
        self.logger.record("time/time_elapsed", self.seconds)
        self.logger.dump(steps)

    def write_checkpoint(self) -> None:
        """Write the state at the start of the present rollout, or of the next rollout if none is in progress."""
        if self._write is not None and self._checkpoint is not None:
            self._write(self._checkpoint)
            self._written = time.monotonic()
