"""The whole state of a training of PPO between two rollouts, as a file from which it continues bit for bit."""

import math
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from hydro_agents.learning.vec_env import AxisVecEnv, RigsVecEnv
from hydro_agents.running.weights import Tensors, flat, load_checkpoint, restore_optimiser, restored, save_checkpoint
from hydro_env import ConfigurationError

CHECKPOINT_FILE, KIND = "checkpoint.safetensors", "training checkpoint"
LAST_EPISODES = 100  # whose mean reward the log holds


class Checkpoint(NamedTuple):
    """A training at the start of a rollout."""

    tensors: Tensors  # networks, optimiser, environment, generators and the last observation
    steps: int
    updates: int
    seconds: float  # duration of training, all sessions together


class Checkpoints:
    """The checkpoints of a training in a folder, written every ``interval`` seconds; ``None`` keeps none.

    A training continues only under the conditions (JSON) that it was ``made_with``.
    """

    def __init__(self, folder: str | Path | None, made_with: Mapping[str, Any], interval: float) -> None:
        self.file = None if folder is None else Path(folder) / CHECKPOINT_FILE
        self._made_with, self._interval = made_with, interval
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
        for what, now in self._made_with.items():
            if described["made_with"].get(what) != now:
                raise ConfigurationError(f"{self.file}: was made with other {what}; cannot resume")
        return Checkpoint(tensors, described["steps"], described["updates"], described["seconds"])

    def keep(self, model: Any, env: AxisVecEnv | RigsVecEnv, seconds: float) -> None:
        """Copy the state at the start of a rollout; write it if the last file is old."""
        if self.file is not None:
            self._latest = take(model, env, seconds)
            if time.monotonic() - self._written > self._interval:
                self.write()

    def write(self) -> None:
        """Write the state at the start of the present rollout, or of the next one if none is in progress.

        Raises:
            ConfigurationError: the folder cannot be written.
        """
        if self.file is not None and self._latest is not None:
            described = {**self._latest._asdict(), "made_with": self._made_with}
            save_checkpoint(self.file, KIND, described.pop("tensors"), described)
            self._written = time.monotonic()


def take(model: Any, env: AxisVecEnv | RigsVecEnv, seconds: float) -> Checkpoint:
    """Copy the state of a training with PPO or RecurrentPPO at the start of a rollout."""
    _, key, position, *_ = np.random.get_state()  # stable-baselines3 shuffles minibatches with it
    state = {
        "policy": model.policy.state_dict(),
        "recurrent": getattr(model, "_last_lstm_states", None),
        "optimiser": model.policy.optimizer.state_dict()["state"],
        "axes": env.get_state(),
        "torch_generator": torch.get_rng_state(),
        "numpy_generator": {"key": key, "position": position},
        "observation": model._last_obs,
        "episode_start": model._last_episode_starts,
        "episodes": np.array([(one["r"], one["l"]) for one in model.ep_info_buffer or ()]).reshape(-1, 2),
    }
    tensors: dict[str, Any] = {}
    for name, part in state.items():
        tensors |= flat(part, name)
    return Checkpoint(tensors, int(model.num_timesteps), int(model._n_updates), seconds)


def restore(model: Any, env: AxisVecEnv | RigsVecEnv, checkpoint: Checkpoint) -> None:
    """Restore the state that :func:`take` copied into a new ``model`` and ``env`` of the same settings."""
    tensors = checkpoint.tensors
    env.reset()
    if isinstance(env, RigsVecEnv):
        env.renew(int(tensors["axes.first"]))
    env.set_state(restored(env.get_state(), tensors, "axes"))
    model.policy.load_state_dict(restored(model.policy.state_dict(), tensors, "policy"))
    if hasattr(model, "_last_lstm_states"):
        model._last_lstm_states = restored(model._last_lstm_states, tensors, "recurrent")
    restore_optimiser(model.policy.optimizer, tensors, "optimiser")
    model._last_obs, model._last_episode_starts = tensors["observation"].copy(), tensors["episode_start"].copy()
    episodes = [{"r": reward, "l": int(length), "t": 0.0} for reward, length in tensors["episodes"].tolist()]
    model.ep_info_buffer, model.ep_success_buffer = deque(episodes, maxlen=LAST_EPISODES), deque(maxlen=LAST_EPISODES)
    generator: Any = "MT19937", tensors["numpy_generator.key"], int(tensors["numpy_generator.position"])
    np.random.set_state(generator)
    torch.set_rng_state(torch.from_numpy(tensors["torch_generator"].copy()))
    model.num_timesteps, model._n_updates = checkpoint.steps, checkpoint.updates
