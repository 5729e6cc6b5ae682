"""The whole state of PPO's training between two rollouts, and when it is written, logged and checked.

A resumed training continues from a checkpoint bit for bit.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from hydro_agents.learning.progress import Progress
from hydro_agents.learning.settings import PPOSettings, TrainingSettings
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.weights import (
    Tensors,
    load_checkpoint,
    optimiser_tensors,
    require,
    restore_optimiser,
    save_checkpoint,
)
from hydro_env import ConfigurationError

CHECKPOINT_FILE = "checkpoint.safetensors"
KIND = "training checkpoint"


class Checkpoint(NamedTuple):
    """A training at the start of a rollout."""

    tensors: dict[str, NDArray[Any]]  # networks, optimiser, environment, generators and the last observation
    steps: int
    updates: int
    seconds: float  # duration of training, all sessions together


def take(model: OnPolicyAlgorithm, env: AxisVecEnv, seconds: float) -> Checkpoint:
    """Copy the state of a training at the start of a rollout."""
    generator: Any = np.random.get_state(legacy=False)
    episodes = [(episode["r"], episode["l"]) for episode in model.ep_info_buffer or ()]
    tensors: dict[str, NDArray[Any]] = {
        **{f"policy.{name}": value.detach().cpu().numpy().copy() for name, value in model.policy.state_dict().items()},
        **optimiser_tensors(model.policy.optimizer),
        **{f"axes.{name}": _plain(value) for name, value in env.get_state().items()},
        "observation": np.array(model._last_obs),
        "episode_start": np.array(model._last_episode_starts),
        "episodes": np.array(episodes, dtype=np.float64).reshape(-1, 2),
        "torch_generator": torch.get_rng_state().numpy().copy(),
        "numpy_generator": generator["state"]["key"].copy(),
        "numpy_generator_position": np.array(generator["state"]["pos"]),
        **{name: value.detach().numpy().copy() for name, value in _recurrent(model).items()},
    }
    return Checkpoint(tensors, int(model.num_timesteps), int(getattr(model, "_n_updates", 0)), seconds)


def save(checkpoint: Checkpoint, folder: Path, made_with: Mapping[str, Any]) -> None:
    """Write a checkpoint and its conditions ``made_with`` (JSON) atomically.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    counters = {"steps": checkpoint.steps, "updates": checkpoint.updates, "seconds": checkpoint.seconds}
    save_checkpoint(folder / CHECKPOINT_FILE, KIND, checkpoint.tensors, {**counters, "made_with": dict(made_with)})


def load(folder: Path, made_with: Mapping[str, Any]) -> Checkpoint:
    """Read the checkpoint of a folder, which must have been made under the conditions ``made_with``.

    Raises:
        ConfigurationError: the checkpoint is missing, damaged, or was made under other conditions.
    """
    path = folder / CHECKPOINT_FILE
    tensors, stored = load_checkpoint(path, KIND)
    before = stored.get("made_with")
    if not isinstance(before, dict):
        raise ConfigurationError(f"{path}: damaged: its conditions (made_with) are missing")
    for what, now in made_with.items():
        _refuse_another(path, what, before.get(what), now)
    counters: list[Any] = [stored.get(name) for name in ("steps", "updates", "seconds")]
    if not all(type(value) in (int, float) and 0 <= value < 1e15 for value in counters):
        raise ConfigurationError(f"{path}: damaged: steps, updates, seconds = {str(counters)[:60]}")
    steps, updates, seconds = counters
    return Checkpoint(dict(tensors), int(steps), int(updates), float(seconds))


def _refuse_another(path: Path, what: str, before: object, now: object) -> None:
    """Raise an error if a condition has changed; it names the first part of a group that differs."""
    if before == now:
        return
    changed = ""
    if isinstance(before, dict) and isinstance(now, dict):
        changed = next((f" ('{key}' differs)" for key in {**now, **before} if before.get(key) != now.get(key)), "")
    other = "other" if what.endswith("s") else "another"
    raise ConfigurationError(f"{path}: was made with {other} {what}{changed}; cannot resume")


def restore(model: OnPolicyAlgorithm, env: AxisVecEnv, checkpoint: Checkpoint, where: str | Path) -> None:
    """Restore the state that :func:`take` copied into a new ``model`` and ``env`` of the same settings.

    Raises:
        ConfigurationError: the checkpoint does not fit the model; ``where`` names its file.
    """
    tensors, observation = checkpoint.tensors, env.reset()
    policy = model.policy.state_dict()
    require(tensors, {f"policy.{name}": value.numpy() for name, value in policy.items()}, where)
    state = env.get_state()
    require(tensors, {f"axes.{name}": _plain(value) for name, value in state.items()}, where, finite=False)
    episodes = tensors.get("episodes", np.zeros(0))
    generator: Any = np.random.get_state(legacy=False)  # stable-baselines3 shuffles minibatches with the global one
    wanted: Tensors = {
        "observation": np.asarray(observation),
        "episode_start": np.zeros(env.num_envs, dtype=np.bool_),
        "episodes": np.zeros((min(len(episodes), 100), 2)),
        "torch_generator": torch.get_rng_state().numpy(),
        "numpy_generator": generator["state"]["key"],
        "numpy_generator_position": np.array(generator["state"]["pos"]),
    }
    recurrent = _recurrent(model)
    require(tensors, {**wanted, **{name: value.numpy() for name, value in recurrent.items()}}, where)
    try:
        env.set_state({name: _shaped(tensors[f"axes.{name}"], like) for name, like in state.items()})
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}") from None
    restore_optimiser(model.policy.optimizer, tensors, str(where))
    model.policy.load_state_dict({name: torch.from_numpy(tensors[f"policy.{name}"].copy()) for name in policy})
    for name, value in recurrent.items():
        value.copy_(torch.from_numpy(tensors[name].copy()))
    model._last_obs = tensors["observation"].copy()
    model._last_episode_starts = tensors["episode_start"].copy()
    model.ep_info_buffer = deque(({"r": r, "l": int(n), "t": 0.0} for r, n in episodes.tolist()), maxlen=100)
    model.ep_success_buffer = deque(maxlen=100)
    model.num_timesteps = checkpoint.steps
    model._n_updates = checkpoint.updates
    generator["state"] = {"key": tensors["numpy_generator"], "pos": int(tensors["numpy_generator_position"])}
    try:
        if not 0 <= generator["state"]["pos"] <= 624:  # otherwise NumPy reads beyond its array
            raise ValueError
        np.random.set_state(generator)
        torch.set_rng_state(torch.from_numpy(tensors["torch_generator"].copy()))
    except (ValueError, RuntimeError):
        raise ConfigurationError(f"{where}: numpy_generator or torch_generator holds no state of a generator") from None


def _recurrent(model: OnPolicyAlgorithm) -> dict[str, torch.Tensor]:
    """The memory of the recurrent layers of actor and critic; empty for a policy without."""
    states = getattr(model, "_last_lstm_states", None)
    if states is None:
        return {}
    return {f"recurrent.{name}.{n}": value for name in ("pi", "vf") for n, value in enumerate(getattr(states, name))}


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """An array that safetensors can hold: the bytes of an array with named fields, any other array unchanged."""
    return array if array.dtype.names is None else np.frombuffer(array.tobytes(), dtype=np.uint8)


def _shaped(array: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    return array if like.dtype.names is None else array.view(like.dtype).reshape(like.shape)


class SessionCallback(BaseCallback):
    """What every training reports: its progress and its log; a subclass may write checkpoints.

    ``seconds`` is the duration of the earlier sessions of a resumed training.
    """

    def __init__(self, settings: TrainingSettings, seconds: float, progress: Callable[[Progress], None] | None) -> None:
        super().__init__()
        self._total, self._every = settings.total_steps, settings.validation_every
        self._progress = progress
        self._began = time.monotonic() - seconds

    @property
    def seconds(self) -> float:
        """Duration of training, all sessions together, without the caller's checks."""
        return time.monotonic() - self._began

    def mean_reward(self) -> float:
        """Mean reward per control period over the last episodes; NaN before the first one has ended."""
        episodes = self.model.ep_info_buffer or ()
        return float(np.mean([episode["r"] / episode["l"] for episode in episodes])) if episodes else math.nan

    def report(self) -> None:
        """Tell the caller how far the training is."""
        if self._progress is not None:
            self._progress(Progress(self.num_timesteps, self._total, self.seconds, self.mean_reward()))

    def log(self, steps: int, validation: Mapping[str, float]) -> None:
        """Write a row of the log."""
        for name, value in validation.items():
            self.logger.record(f"validation/{name}", value)
        self.logger.record("rollout/mean_reward", self.mean_reward())
        self.logger.record("time/time_elapsed", self.seconds)
        self.logger.dump(steps)

    def validates(self, steps: int, since: int) -> bool:
        """Whether a validation is due in the last ``since`` of these steps."""
        return bool(self._every) and steps // self._every > (steps - since) // self._every

    def write_checkpoint(self) -> None:
        """Write the last state from which the training can be resumed, if there is one."""


@contextmanager
def session(model: BaseAlgorithm, env: AxisVecEnv, callback: SessionCallback) -> Iterator[None]:
    """A block that trains: Ctrl-C in it writes a checkpoint, and its end closes the log and the axes."""
    try:
        yield
    except KeyboardInterrupt:
        callback.write_checkpoint()
        raise
    finally:
        model.logger.close()
        env.close()


class TrainingCallback(SessionCallback):
    """Logs, writes checkpoints and calls ``check`` between rollouts of PPO; sets the exploration of each."""

    model: OnPolicyAlgorithm

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
        super().__init__(settings, seconds, progress)
        self._settings = settings
        self._write = write
        self._checkpoint_seconds = checkpoint_seconds
        self._check = check
        self._validate = validate
        self._written: float | None = None
        self._checkpoint: Checkpoint | None = None
        self._logged = -1
        self._ended = False

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
        self.report()

    def _on_training_end(self) -> None:
        if not self._ended:
            self._between_rollouts()
        self.write_checkpoint()

    def _between_rollouts(self) -> None:
        """Log the last rollout and its update, set the exploration of the next, and copy the state at its start.

        A rollout and its update share one exploration; otherwise the ratio of PPO would not begin at 1.
        """
        settings, steps = self._settings, self.num_timesteps
        share = min(steps / settings.total_steps, 1.0)
        with torch.no_grad():
            self.model.policy.get_parameter("log_std").fill_(settings.log_standard_deviation_at(share))
        if steps > self._logged:
            due = self.validates(steps, steps - self._logged) or (self._every and steps >= self._total)
            self._log(steps, self._validate() if due else {})
            self._logged = steps
        if self._write is not None:
            env = self.model.get_env()
            assert isinstance(env, AxisVecEnv)
            self._checkpoint = take(self.model, env, self.seconds)
            if self._written is None or time.monotonic() - self._written > self._checkpoint_seconds:
                self.write_checkpoint()

    def _log(self, steps: int, validation: Mapping[str, float]) -> None:
        env = self.model.get_env()
        assert isinstance(env, AxisVecEnv)
        for name, value in env.mean_rewards().items():
            self.logger.record(f"reward/{name}", value)
        lengths = [episode["l"] for episode in self.model.ep_info_buffer or ()]
        self.logger.record("rollout/ep_len_mean", float(np.mean(lengths)) if lengths else math.nan)
        self.log(steps, validation)

    def write_checkpoint(self) -> None:
        """Write the state at the start of the present rollout, or of the next rollout if none is in progress."""
        if self._write is not None and self._checkpoint is not None:
            self._write(self._checkpoint)
            self._written = time.monotonic()
