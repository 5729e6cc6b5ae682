"""The whole state of an on-policy training between two rollouts; a resumed training continues from it bit for bit."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.optimiser import optimiser_tensors, restore_optimiser
from hydro_agents.running.weights import Tensors, load_checkpoint, require, save_checkpoint
from hydro_env import ConfigurationError

CHECKPOINT_FILE = "checkpoint.safetensors"
KIND = "training checkpoint"


class Checkpoint(NamedTuple):
    """A training at the start of a rollout."""

    tensors: dict[str, NDArray[Any]]
    """Networks, optimiser, environment, generators and the last observation."""

    steps: int
    updates: int
    seconds: float
    """Duration of training, all sessions together."""


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
    """Read the checkpoint of a folder.

    Args:
        folder: folder of the checkpoint.
        made_with: conditions that must equal those of the checkpoint, each a dictionary or a single value.

    Raises:
        ConfigurationError: the checkpoint is missing, damaged, or was made under other conditions.
    """
    path = folder / CHECKPOINT_FILE
    tensors, stored = load_checkpoint(path, KIND)
    before = stored.get("made_with")
    if not isinstance(before, dict):
        raise ConfigurationError(f"{path}: damaged: its conditions (made_with) are missing")
    for what, now in made_with.items():
        old = before.get(what)
        if old != now:
            changed = ""
            if isinstance(old, dict) and isinstance(now, dict):
                changed = next((f" ('{key}' differs)" for key in {**now, **old} if old.get(key) != now.get(key)), "")
            raise ConfigurationError(f"{path}: was made with another {what}{changed}; cannot resume")
    steps, updates, seconds = read_counters(stored, ("steps", "updates", "seconds"), path)
    return Checkpoint(tensors, int(steps), int(updates), float(seconds))


def read_counters(stored: Mapping[str, Any], names: Sequence[str], path: Path) -> list[float]:
    """Numbers of a checkpoint, by name.

    Raises:
        ConfigurationError: one is missing, negative or no number.
    """
    counters: list[Any] = [stored.get(name) for name in names]
    if not all(type(value) in (int, float) and 0 <= value < 1e15 for value in counters):
        raise ConfigurationError(f"{path}: damaged: {', '.join(names)} = {str(counters)[:60]}")
    return counters


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
    require(tensors, wanted, where)
    try:
        env.set_state({name: _shaped(tensors[f"axes.{name}"], like) for name, like in state.items()})
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}") from None
    restore_optimiser(model.policy.optimizer, tensors, str(where))
    model.policy.load_state_dict({name: torch.from_numpy(tensors[f"policy.{name}"].copy()) for name in policy})
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


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """An array that safetensors can hold: the bytes of an array with named fields, any other array unchanged."""
    return array if array.dtype.names is None else np.frombuffer(array.tobytes(), dtype=np.uint8)


def _shaped(array: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    """The inverse of :func:`_plain`."""
    return array if like.dtype.names is None else array.view(like.dtype).reshape(like.shape)
