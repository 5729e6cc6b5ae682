"""What happens between the rollouts of a training: log, validation, checkpoints and the exploration of PPO.

The log goes to ``progress.csv``, and to TensorBoard if it is installed.
"""

import math
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat, filter_excluded_keys

from hydro_agents.controllers.base import Controller
from hydro_agents.learning.any_axis import AnyAxisFeatures
from hydro_agents.learning.checkpoint import Checkpoints
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.imitation import ACTOR
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.vec_env import RigsVecEnv
from hydro_agents.running.cases import family_errors
from hydro_env import TaskConfig, task_config
from hydro_env.files import write_text
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.types import Floats

PROGRESS_FILE = "progress.csv"
STEPS = "time/total_timesteps"
VALIDATION_RIGS, VALIDATION_PLANTS = 8, 8


class Progress(NamedTuple):
    """Progress of a training."""

    steps: int
    total_steps: int
    mean_reward: float  # per control period, over the last episodes; NaN before the first one has ended


class ProgressFile(KVWriter):
    """``progress.csv``: one row per update, written immediately; a resumed training continues the file.

    Rows after the ``steps`` of the checkpoint are dropped: that training was killed before its next checkpoint.

    Raises:
        ConfigurationError: the file cannot be written; told before the training.
    """

    def __init__(self, path: Path, steps: int = 0) -> None:
        self._path = path
        self._rows = read_progress(path, steps) if steps > 0 and path.exists() else []
        self._write()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row."""
        values = filter_excluded_keys(key_values, key_excluded, "csv")
        self._rows.append({STEPS: step, **{key: float(values[key]) for key in sorted(values) if key != STEPS}})
        self._write()

    def _write(self) -> None:
        table = pd.DataFrame(self._rows).convert_dtypes()  # whole numbers without a decimal point
        write_text(self._path, table.to_csv(index=False, lineterminator="\n"))

    def close(self) -> None:
        """Do nothing: the file is closed after each row."""


def read_progress(path: str | Path, steps: float = math.inf) -> list[dict[str, float]]:
    """The rows of ``progress.csv`` up to a number of steps; an empty field is NaN.

    A damaged file is left out with a warning: no result depends on the log.
    """
    try:
        table = pd.read_csv(path, index_col=False, dtype=str).astype(float)
        return table[table[STEPS] <= steps].to_dict("records")
    except pd.errors.EmptyDataError:
        return []
    except (OSError, ValueError, KeyError) as error:
        warnings.warn(f"{path}: is no log of a training ({type(error).__name__}): left out", stacklevel=2)
        return []


def training_logger(folder: str | Path | None, steps: int = 0) -> Logger:
    """A logger for ``model.set_logger`` that writes to a folder, or nowhere, after the ``steps`` that are done."""
    writers: list[KVWriter] = []
    if folder is not None:
        writers.append(ProgressFile(Path(folder) / PROGRESS_FILE, steps))
        with suppress(AssertionError):  # TensorBoard may not be installed
            writers.append(TensorBoardOutputFormat(str(folder)))
    return Logger(None, writers)


def renew_rigs(model: Any, settings: PPOSettings, share: float) -> None:
    """Give a model the rigs of a share of its training; the discount per control period is that of each axis."""
    env: RigsVecEnv = model.get_env()
    for part, inputs in env.renew(settings.first_rig_at(share)):
        model._last_obs[part], model._last_episode_starts[part] = inputs, True
    periods = env.periods_per_step()
    model.rollout_buffer.gamma = settings.discount ** (1.0 / periods)
    model.rollout_buffer.gae_lambda = settings.advantage_decay ** (1.0 / periods)


class TrainingCallback(BaseCallback):
    """Logs, validates and keeps checkpoints between rollouts; sets the exploration of PPO.

    Its arguments are those of :func:`~hydro_agents.learning.training.train_policy`.
    """

    model: Any
    seconds_before = 0.0  # duration of the earlier sessions

    def __init__(
        self,
        config: TaskConfig,
        settings: PPOSettings,
        features: PolicyFeatures,
        checkpoints: Checkpoints,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        super().__init__()
        self._config, self._settings, self._features = config, settings, features
        self._checkpoints, self._progress = checkpoints, progress
        self._began = time.monotonic()
        self._logged = -1  # steps; -1: not begun

        self._rigs: list[tuple[PolicyFeatures, Floats]] = []  # for validation, with the errors of what is corrected

    @property
    def seconds(self) -> float:
        """Duration of training, all sessions together."""
        return self.seconds_before + time.monotonic() - self._began

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._on_rollout_start()
        self._checkpoints.write()

    def _on_rollout_start(self) -> None:
        """Log the last rollout and its update, set the exploration of the next, and copy the state at its start.

        A rollout and its update share one exploration; otherwise the ratio of PPO would not begin at 1.
        """
        share = min(self.num_timesteps / self._settings.total_steps, 1.0)
        with torch.no_grad():
            self.model.policy.log_std.fill_(self._settings.log_standard_deviation_at(share))
        for name, weights in self.model.policy.named_parameters():
            if name.startswith(ACTOR):
                weights.requires_grad_(share >= self._settings.critic_first)
        if self._logged >= 0:
            self._log()
        if self._settings.law:
            renew_rigs(self.model, self._settings, share)
        self._checkpoints.keep(self.model, self.model.get_env(), self.seconds)
        self._logged = self.num_timesteps

    def _log(self) -> None:
        """Report, and write a row of the log, with a validation if one is due."""
        steps, every, total = self.num_timesteps, self._settings.validation_every, self._settings.total_steps
        reward, length = math.nan, math.nan  # before the first episode has ended
        if self.model.ep_info_buffer:
            episodes = np.array([(episode["r"], episode["l"]) for episode in self.model.ep_info_buffer])
            reward, length = float(np.mean(episodes[:, 0] / episodes[:, 1])), float(np.mean(episodes[:, 1]))
        if self._progress is not None:
            self._progress(Progress(steps, total, reward))
        if every and (steps // every > self._logged // every or steps >= total):
            for name, value in self._validation().items():
                self.logger.record(f"validation/{name}", value)
        self.logger.record("rollout/ep_len_mean", length)
        self.logger.record("rollout/mean_reward", reward)
        self.logger.record("time/time_elapsed", self.seconds)
        self.logger.dump(steps)

    def _validation(self) -> dict[str, float]:
        """Error on training plants of the rig, or of validation rigs, and relative to the corrected controller's.

        Where the policy corrects none, that is the untuned one's on drawn rigs, and NaN on one rig.
        """
        if not self._rigs:
            own = self._features
            if isinstance(own, AnyAxisFeatures):
                law = {"split": "validation", "count": VALIDATION_RIGS}
                moved = [own.moved_to(task) for task in rig_tasks(task_config(self._config, law=law))]
                self._rigs = [(each, _errors(each, each.leader)) for each in moved]
            else:
                self._rigs = [(own, np.array(math.nan) if own.base is None else _errors(own, own.base))]
        errors = [_errors(own, PolicyController.from_sb3(self.model, own)) for own, _ in self._rigs]
        ratios = [np.exp(np.mean(np.log(now / base))) for now, (_, base) in zip(errors, self._rigs, strict=True)]
        return {
            "mean_error_mm": 1e3 * float(np.mean(errors)),
            "error_to_corrected": float(np.median(ratios)),
            "worst_error_to_corrected": float(max(ratios)),
        }


def _errors(features: PolicyFeatures, controller: Controller) -> Floats:
    """Error of a controller in each family of references, (families,), m, in the frame of the sensor."""
    found = family_errors(features.config, controller, VALIDATION_PLANTS, sensor_frame=True)
    return np.array([*found.values()])
