"""The whole state of a training of PPO between two rollouts, as a file from which it continues bit for bit."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from hydro_agents.learning.vec_env import AxisVecEnv, RigsVecEnv
from hydro_agents.running.weights import (
    Tensors,
    load_checkpoint,
    optimiser_tensors,
    require,
    restore_optimiser,
    save_checkpoint,
)
from hydro_env import ConfigurationError
from hydro_env.files import Group, validate

CHECKPOINT_FILE, KIND = "checkpoint.safetensors", "training checkpoint"
LAST_EPISODES = 100  # whose mean reward the log holds


class Counters(Group):
    """How far a training is."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    steps: int = Field(ge=0)
    updates: int = Field(ge=0)
    seconds: float = Field(ge=0.0, description="duration of training, all sessions together")
    made_with: dict[str, Any] = Field(description="the conditions under which the training runs")


class Checkpoint(NamedTuple):
    """A training at the start of a rollout."""

    tensors: Tensors  # networks, optimiser, environment, generators and the last observation
    counters: Counters

    def write(self, path: Path) -> None:
        """Write the checkpoint atomically.

        Raises:
            ConfigurationError: the folder cannot be written.
        """
        save_checkpoint(path, KIND, self.tensors, self.counters.model_dump())

    @classmethod
    def read(cls, path: Path, made_with: Mapping[str, Any]) -> Checkpoint:
        """Read a checkpoint.

        Raises:
            ConfigurationError: it is missing, damaged, or was made under other conditions.
        """
        tensors, stored = load_checkpoint(path, KIND)
        counters = validate(Counters, stored, f"{path}: damaged")
        for what, now in made_with.items():
            before = counters.made_with.get(what)
            if before != now:
                other = "other" if what.endswith("s") else "another"
                raise ConfigurationError(
                    f"{path}: was made with {other} {what}{_difference(before, now)}; cannot resume"
                )
        return cls(tensors, counters)


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
    tensors = {name: value.detach().cpu().numpy().copy() for name, value in _networks(model).items()}
    episodes = [(episode["r"], episode["l"]) for episode in model.ep_info_buffer or ()]
    tensors |= {
        **optimiser_tensors(model.policy.optimizer),
        **_axes(env),
        **_generators(),
        "observation": np.array(model._last_obs),
        "episode_start": np.array(model._last_episode_starts),
        "episodes": np.array(episodes, dtype=np.float64).reshape(-1, 2),
    }
    counters = {"steps": model.num_timesteps, "updates": model._n_updates, "seconds": seconds}
    return Checkpoint(tensors, Counters(**counters, made_with=dict(made_with)))


def restore(model: Any, env: AxisVecEnv | RigsVecEnv, checkpoint: Checkpoint, where: str | Path) -> None:
    """Restore the state that :func:`take` copied into a new ``model`` and ``env`` of the same settings.

    Raises:
        ConfigurationError: the checkpoint does not fit the model; ``where`` names its file.
    """
    tensors, networks = checkpoint.tensors, _networks(model)
    wanted = {name: value.detach().numpy() for name, value in networks.items()} | _generators()
    wanted["observation"] = np.asarray(env.reset())
    wanted["episode_start"] = np.zeros(env.num_envs, dtype=np.bool_)
    wanted["episodes"] = np.zeros((min(len(tensors.get("episodes", ())), LAST_EPISODES), 2))
    require(tensors, wanted, where)
    require(tensors, _axes(env), where, finite=False)
    try:
        state = env.get_state()
        env.set_state({name: _shaped(tensors[f"axes.{name}"], like) for name, like in state.items()})
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}") from None
    restore_optimiser(model.policy.optimizer, tensors, str(where))
    model._last_obs, model._last_episode_starts = tensors["observation"].copy(), tensors["episode_start"].copy()
    episodes = [{"r": reward, "l": int(length), "t": 0.0} for reward, length in tensors["episodes"].tolist()]
    model.ep_info_buffer, model.ep_success_buffer = deque(episodes, maxlen=LAST_EPISODES), deque(maxlen=LAST_EPISODES)
    generator: Any = np.random.get_state(legacy=False)
    generator["state"] = {"key": tensors["numpy_generator"], "pos": int(tensors["numpy_generator_position"])}
    try:
        if not 0 <= generator["state"]["pos"] <= 624:  # otherwise NumPy reads beyond its array
            raise ValueError
        np.random.set_state(generator)
        torch.set_rng_state(torch.from_numpy(tensors["torch_generator"].copy()))
    except (ValueError, RuntimeError):
        raise ConfigurationError(f"{where}: numpy_generator or torch_generator holds no state of a generator") from None
    with torch.no_grad():
        for name, value in networks.items():
            value.copy_(torch.from_numpy(tensors[name].copy()))
    model.num_timesteps, model._n_updates = checkpoint.counters.steps, checkpoint.counters.updates


def _networks(model: Any) -> dict[str, torch.Tensor]:
    """What a training changes in torch, without the optimisers; the tensors are the model's own."""
    own = {f"policy.{name}": value for name, value in model.policy.state_dict().items()}
    memories = getattr(model, "_last_lstm_states", None)  # of the recurrent layers of actor and critic
    for network in ("pi", "vf") if memories is not None else ():
        own |= {f"recurrent.{network}.{n}": value for n, value in enumerate(getattr(memories, network))}
    return own


def _axes(env: AxisVecEnv | RigsVecEnv) -> dict[str, NDArray[Any]]:
    """The state of the axes; of an array with named fields, which safetensors cannot hold, the bytes."""
    return {
        f"axes.{name}": array if array.dtype.names is None else np.frombuffer(array.tobytes(), dtype=np.uint8)
        for name, array in env.get_state().items()
    }


def _shaped(array: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    return array if like.dtype.names is None else array.view(like.dtype).reshape(like.shape)


def _generators() -> dict[str, NDArray[Any]]:
    """The states of the global generators; stable-baselines3 shuffles minibatches with NumPy's."""
    state: Any = np.random.get_state(legacy=False)["state"]
    return {
        "torch_generator": torch.get_rng_state().numpy().copy(),
        "numpy_generator": state["key"].copy(),
        "numpy_generator_position": np.array(state["pos"]),
    }
