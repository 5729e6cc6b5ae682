"""The whole state of a training of PPO between two rollouts, as a file from which it continues bit for bit."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from hydro_agents.learning.vec_env import AxisVecEnv, RigsVecEnv
from hydro_agents.running.weights import (
    Tensors,
    load_checkpoint,
    optimiser_tensors,
    restore_optimiser,
    save_checkpoint,
)
from hydro_env import ConfigurationError

CHECKPOINT_FILE, KIND = "checkpoint.safetensors", "training checkpoint"
LAST_EPISODES = 100  # whose mean reward the log holds


class Checkpoint(NamedTuple):
    """A training at the start of a rollout, which continues bit for bit."""

    tensors: Tensors  # networks, optimiser, environment, generators and the last observation
    steps: int
    updates: int
    seconds: float  # duration of training, all sessions together
    made_with: Mapping[str, Any]  # conditions under which the training runs (JSON)


class Checkpoints:
    """The checkpoints of a training in a folder; ``None`` keeps none.

    Args:
        folder: the folder.
        made_with: conditions of the training (JSON); only under the same ones it continues.
        interval: s, between two files.
    """

    def __init__(self, folder: str | Path | None, made_with: Mapping[str, Any], interval: float) -> None:
        self.file = None if folder is None else Path(folder) / CHECKPOINT_FILE
        self.made_with, self._interval = made_with, interval
        self._latest: Checkpoint | None = None
        self._written = -math.inf  # when the last file was written

    def earlier(self, resume: bool) -> Checkpoint | None:
        """The checkpoint from which a training continues; one that begins anew drops it.

        Raises:
            ConfigurationError: it is missing, damaged, or was made under other conditions.
        """
        if self.file is None:
            return None
        if not resume:
            self.file.unlink(missing_ok=True)
            return None
        tensors, described = load_checkpoint(self.file, KIND)
        for what, now in self.made_with.items():
            before = described["made_with"].get(what)
            if before != now:
                difference = _difference(before, now)
                raise ConfigurationError(f"{self.file}: was made with other {what}{difference}; cannot resume")
        return Checkpoint(tensors, *(described[name] for name in Checkpoint._fields[1:]))

    def keep(self, model: Any, env: AxisVecEnv | RigsVecEnv, seconds: float) -> None:
        """Copy the state at the start of a rollout; write it if the last file is old."""
        if self.file is not None:
            self._latest = take(model, env, seconds, self.made_with)
            if time.monotonic() - self._written > self._interval:
                self.write()

    def write(self) -> None:
        """Write the state at the start of the present rollout, or of the next one if none is in progress.

        Raises:
            ConfigurationError: the folder cannot be written.
        """
        if self.file is not None and self._latest is not None:
            described = self._latest._asdict()
            save_checkpoint(self.file, KIND, described.pop("tensors"), described)
            self._written = time.monotonic()


def _difference(before: Any, now: Any) -> str:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**now, **before}:
            if before.get(key) != now.get(key):
                return f" ('{key}' differs)"
    return ""


def take(model: Any, env: AxisVecEnv | RigsVecEnv, seconds: float, made_with: Mapping[str, Any]) -> Checkpoint:
    """Copy the state of a training at the start of a rollout.

    Args:
        model: PPO or RecurrentPPO.
        env: its environment.
        seconds: duration of training.
        made_with: conditions under which it runs (JSON).
    """
    episodes = [(episode["r"], episode["l"]) for episode in model.ep_info_buffer or ()]
    generator: Any = np.random.get_state(legacy=False)["state"]  # stable-baselines3 shuffles minibatches with it
    tensors = optimiser_tensors(model.policy.optimizer) | {
        "torch_generator": torch.get_rng_state().numpy().copy(),
        "numpy_generator": generator["key"].copy(),
        "numpy_generator_position": np.array(generator["pos"]),
        "observation": np.array(model._last_obs),
        "episode_start": np.array(model._last_episode_starts),
        "episodes": np.array(episodes, dtype=np.float64).reshape(-1, 2),
    }
    for name, value in _networks(model).items():
        tensors[name] = value.detach().cpu().numpy().copy()
    for name, array in env.get_state().items():
        tensors[f"axes.{name}"] = array if array.dtype.names is None else np.frombuffer(array.tobytes(), np.uint8)
    return Checkpoint(tensors, int(model.num_timesteps), int(model._n_updates), seconds, made_with)


def restore(model: Any, env: AxisVecEnv | RigsVecEnv, checkpoint: Checkpoint) -> None:
    """Restore the state that :func:`take` copied into a new ``model`` and ``env`` of the same settings."""
    tensors = checkpoint.tensors
    env.reset()
    env.set_state({name: _shaped(tensors[f"axes.{name}"], like) for name, like in env.get_state().items()})
    restore_optimiser(model.policy.optimizer, tensors, CHECKPOINT_FILE)
    model._last_obs, model._last_episode_starts = tensors["observation"].copy(), tensors["episode_start"].copy()
    episodes = [{"r": reward, "l": int(length), "t": 0.0} for reward, length in tensors["episodes"].tolist()]
    model.ep_info_buffer, model.ep_success_buffer = deque(episodes, maxlen=LAST_EPISODES), deque(maxlen=LAST_EPISODES)
    generator: Any = np.random.get_state(legacy=False)
    generator["state"] = {"key": tensors["numpy_generator"], "pos": int(tensors["numpy_generator_position"])}
    np.random.set_state(generator)
    torch.set_rng_state(torch.from_numpy(tensors["torch_generator"].copy()))
    with torch.no_grad():
        for name, value in _networks(model).items():
            value.copy_(torch.from_numpy(tensors[name].copy()))
    model.num_timesteps, model._n_updates = checkpoint.steps, checkpoint.updates


def _networks(model: Any) -> dict[str, torch.Tensor]:
    """What a training changes in torch, without the optimiser; the tensors are the model's own."""
    own = {f"policy.{name}": value for name, value in model.policy.state_dict().items()}
    memories = getattr(model, "_last_lstm_states", None)  # of the recurrent layers of actor and critic
    if memories is not None:
        for network in ("pi", "vf"):
            for number, value in enumerate(getattr(memories, network)):
                own[f"recurrent.{network}.{number}"] = value
    return own


def _shaped(array: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    """An array with named fields, which safetensors holds as bytes; any other array as it is."""
    return array if like.dtype.names is None else array.view(like.dtype).reshape(like.shape)
