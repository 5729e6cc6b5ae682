"""A trained policy as a controller: NumPy inference from safetensors, and conversion from and to stable-baselines3."""

from __future__ import annotations

from copy import copy, deepcopy
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from hydro_agents.controllers.base import Observation, as_batch
from hydro_agents.learning.features import (
    FEATURE_LIMIT,
    AnyAxisFeatures,
    FeatureState,
    Normalisation,
    PolicyFeatures,
    StoredFeatures,
)
from hydro_agents.running.weights import Tensors, load_weights, require, save_weights
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, validate

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv

KIND = "policy"
LARGEST_LAYER = 4096
Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class _StoredPolicy(Group):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    features: StoredFeatures
    layer_sizes: tuple[int, ...] = Field(min_length=2, max_length=33)
    critic_layer_sizes: tuple[int, ...] | None = Field(None, min_length=2, max_length=33)
    log_standard_deviation: float = Field(ge=-20.0, le=5.0)
    activation: Literal["tanh", "relu"] = "tanh"
    output: Literal["linear", "tanh"] = "linear"
    lstm_cells: int | None = Field(None, ge=1, le=LARGEST_LAYER)
    training: dict[str, Any] = {}


class LSTM(NamedTuple):
    """A recurrent layer with H cells, long short-term memory (Hochreiter & Schmidhuber, 1997).

    Its gates are input, forget, cell and output, as in torch.
    """

    inputs: NDArray[np.float32]  # (4 H, inputs)
    recurrent: NDArray[np.float32]  # (4 H, H)
    bias: NDArray[np.float32]  # (4 H,)

    def __call__(
        self,
        values: NDArray[np.float32],
        memory: NDArray[np.float32] | None,
        episode_start: NDArray[np.bool_] | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Output (N, H) for inputs (N, inputs), and the next memory (N, 2 H): output and cells.

        The memory is zero at the start of an episode.
        """
        size = self.recurrent.shape[1]
        if memory is None:
            memory = np.zeros((len(values), 2 * size), dtype=np.float32)
        elif episode_start is not None and np.any(episode_start):
            memory = np.where(np.asarray(episode_start)[:, None], np.float32(0.0), memory)
        output, cells = memory[:, :size], memory[:, size:]
        gates = values @ self.inputs.T + output @ self.recurrent.T + self.bias
        entry, kept, new, shown = np.split(gates, 4, axis=1)
        cells = _sigmoid(kept) * cells + _sigmoid(entry) * np.tanh(new)
        output = _sigmoid(shown) * np.tanh(cells)
        return output, np.concatenate([output, cells], axis=1)

    @classmethod
    def from_torch(cls, layer: Any) -> LSTM:
        """The weights of a ``torch.nn.LSTM`` with one layer."""
        weights = {name: _array(value) for name, value in layer.named_parameters()}
        bias = weights["bias_ih_l0"] + weights["bias_hh_l0"]
        return cls(weights["weight_ih_l0"], weights["weight_hh_l0"], bias)


def _sigmoid(x: NDArray[np.float32]) -> NDArray[np.float32]:
    value: NDArray[np.float32] = np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * x)
    return value


class PolicyController:
    """An actor network from features to a command: dense layers, with a recurrent layer before them if trained so.

    It has the interface of every controller; see :class:`~hydro_agents.controllers.base.Controller`.
    ``deterministic=False`` adds Gaussian exploration noise of the trained size. Its generator is part of the state; a
    new one begins with seed 0, and ``state._replace(noise=np.random.default_rng(7))`` gives it another.

    Args:
        features: map observations to policy inputs, and outputs to commands.
        layers: (weight (out, in), bias (out,)) of each layer of the actor.
        log_standard_deviation: logarithm of the standard deviation of the exploration noise.
        activation: activation of the hidden layers, ``tanh`` or ``relu``.
        training: record of the training (JSON).
        critic: layers of the value network, which may have more inputs; ``None`` if unknown.
        output: ``linear`` (limited to ±1, as PPO's) or ``tanh`` (as SAC's).
        lstm: recurrent layer between features and ``layers``; its memory is part of the state.

    Example:
        >>> from hydro_agents.learning.policy import PolicyController
        >>> from hydro_agents.running.folders import pretrained_folder
        >>> from hydro_env import ServoHydraulicVectorEnv
        >>> policy = PolicyController.load(pretrained_folder() / "policy")
        >>> env = ServoHydraulicVectorEnv(2, policy.features.config)  # the task of its training
        >>> observation, _ = env.reset(seed=0)
        >>> command, memory = policy.predict(observation)
        >>> command.shape
        (2, 1)
    """

    def __init__(
        self,
        features: PolicyFeatures,
        layers: Layers,
        log_standard_deviation: float = -3.0,
        training: dict[str, Any] | None = None,
        activation: str = "tanh",
        critic: Layers | None = None,
        output: str = "linear",
        lstm: LSTM | None = None,
    ) -> None:
        self.features = features
        self.layers = layers
        self.log_standard_deviation = log_standard_deviation
        self.training = training or {}
        self.activation = activation
        self.critic = critic
        self.output = output
        self.lstm = lstm

    def predict(
        self,
        observation: Observation,
        state: FeatureState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], FeatureState]:
        """Commands for the observations, and the memory for the next call."""
        batch, single = as_batch(observation)
        inputs, state = self.features(batch, state, episode_start)
        values = np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)
        if self.lstm is not None:
            values, hidden = self.lstm(values, state.hidden, episode_start)
            state = state._replace(hidden=hidden)
        for weight, bias in self.layers[:-1]:
            values = values @ weight.T + bias
            values = np.tanh(values, out=values) if self.activation == "tanh" else np.maximum(values, 0.0, out=values)
        weight, bias = self.layers[-1]
        output = values @ weight.T + bias
        if not deterministic:
            generator = deepcopy(state.noise) or np.random.default_rng(0)
            output = output + np.exp(self.log_standard_deviation) * generator.standard_normal(output.shape)
            state = state._replace(noise=generator)
        command = self.features.command(np.tanh(output) if self.output == "tanh" else output, state)
        return (command[0] if single else command), state

    @classmethod
    def from_sb3(
        cls, model: Any, features: PolicyFeatures | None = None, training: dict[str, Any] | None = None
    ) -> PolicyController:
        """Copy the actor of a model that was trained on ``AxisVecEnv``, and the critic of PPO or A2C.

        Args:
            model: of PPO, A2C, SAC or TQC with an ``MlpPolicy``, or of RecurrentPPO with an ``MlpLstmPolicy``; its
                dense layers are of tanh or relu.
            features: map observations to the model's inputs; default: those of the model's environment.
            training: record of the training.

        Raises:
            ConfigurationError: the model has another kind of network, or its inputs are not policy features.
        """
        policy = model.policy
        features = features or getattr(model.get_env(), "features", None)
        activation = getattr(getattr(policy, "activation_fn", None), "__name__", "none").lower()
        off_policy = hasattr(getattr(policy, "actor", None), "latent_pi")  # of SAC and TQC
        if not (off_policy or hasattr(policy, "action_net")) or activation not in ("tanh", "relu"):
            raise ConfigurationError(f"from_sb3: {type(policy).__name__}: must be an MlpPolicy of tanh or relu layers")
        if off_policy:
            layers = _layers([*policy.actor.latent_pi, policy.actor.mu])
        else:
            layers = _layers([*policy.mlp_extractor.policy_net, policy.action_net])
        lstm = LSTM.from_torch(policy.lstm_actor) if hasattr(policy, "lstm_actor") else None
        inputs = (layers[0][0] if lstm is None else lstm.inputs).shape[1]
        if features is None or inputs != features.size or len(layers[-1][1]) != 1:
            raise ConfigurationError(
                "from_sb3: the model's inputs must be PolicyFeatures: train it on AxisVecEnv(..., features=...)"
            )
        if off_policy:
            return cls(features, layers, training=training, activation=activation, output="tanh")
        # The critic of a recurrent policy has a recurrent layer of its own, and is of no use here.
        critic = _layers([*policy.mlp_extractor.value_net, policy.value_net]) if lstm is None else None
        spread = float(policy.log_std.detach().mean())
        return cls(features, layers, spread, training, activation, critic, lstm=lstm)

    def to_sb3(self, env: VecEnv, **keywords: Any) -> PPO:
        """A PPO model of stable-baselines3 with these weights, for further training.

        A policy without a critic (the shipped one has none) gets an untrained critic; the actor cannot improve before
        the critic has learned.

        Args:
            env: ``AxisVecEnv(config, count, features=policy.features)``.
            keywords: keywords of ``PPO``, such as ``n_steps`` and ``learning_rate``.

        Raises:
            ConfigurationError: the environment's inputs are not those of this policy.
        """
        if self.output != "linear" or self.lstm is not None:
            raise ConfigurationError("to_sb3: must be a policy of PPO or A2C")
        import torch
        from stable_baselines3 import PPO

        from hydro_agents.learning.privileged import ACTIVATIONS, AsymmetricPolicy

        inputs = (env.observation_space.shape or (0,))[0]
        needed = self.features.size if self.critic is None else self.critic[0][0].shape[1]
        privileged = getattr(env, "told_critic", False)
        if inputs != needed and not (self.critic is None and privileged):
            more = ", told_critic=True" if needed > self.features.size else ""
            raise ConfigurationError(
                f"to_sb3: the environment gives inputs of shape ({inputs},), the policy needs ({needed},): "
                f"AxisVecEnv(config, count, features=policy.features{more}) gives them"
            )
        network: dict[str, Any] = {
            "net_arch": {"pi": _sizes(self.layers)[1:-1], "vf": _sizes(self.critic or self.layers)[1:-1]},
            "activation_fn": ACTIVATIONS[self.activation],
            "log_std_init": self.log_standard_deviation,
        }
        if privileged:
            network["actor_inputs"] = self.features.size
        policy: Any = AsymmetricPolicy if privileged else "MlpPolicy"
        model = PPO(policy, env, policy_kwargs=network, **{"device": "cpu", **keywords})
        networks = [([*model.policy.mlp_extractor.policy_net, model.policy.action_net], self.layers)]
        if self.critic is not None:
            networks.append(([*model.policy.mlp_extractor.value_net, model.policy.value_net], self.critic))
        with torch.no_grad():
            for modules, layers in networks:
                for module, (weight, bias) in zip(_dense(modules), layers, strict=True):
                    module.weight.copy_(torch.from_numpy(weight.copy()))
                    module.bias.copy_(torch.from_numpy(bias.copy()))
        return model

    def moved_to(self, config: TaskConfig) -> PolicyController:
        """A policy for any axis on the rig of another task.

        Raises:
            ConfigurationError: the policy serves the rig of its training alone, or the rig lacks a sensor.
        """
        if not isinstance(self.features, AnyAxisFeatures):
            raise ConfigurationError("moved_to: must be a policy for any axis")
        moved = copy(self)
        moved.features = self.features.moved_to(config)
        return moved

    def save(self, path: str | Path) -> Path:
        """Write weights and settings; see :func:`hydro_agents.running.weights.save_weights`."""
        tensors = _named(self.layers, "layer") | _named(self.critic or [], "critic")
        settings = {
            "features": self.features.describe(),
            "layer_sizes": _sizes(self.layers),
            "critic_layer_sizes": None if self.critic is None else _sizes(self.critic),
            "log_standard_deviation": self.log_standard_deviation,
            "activation": self.activation,
            "output": self.output,
        }
        if self.features.normalisation is not None:
            tensors |= _prefixed("normalisation", self.features.normalisation)
        if self.lstm is not None:
            tensors |= _prefixed("lstm", self.lstm)
            settings["lstm_cells"] = self.lstm.recurrent.shape[1]
        return save_weights(path, KIND, tensors, {**settings, "training": self.training})

    @classmethod
    def load(cls, path: str | Path) -> PolicyController:
        """Read what ``save`` wrote.

        Raises:
            ConfigurationError: missing, damaged or foreign files.
        """
        tensors, settings = load_weights(path, KIND)
        stored = validate(_StoredPolicy, settings, str(path))
        try:
            features = stored.features.features()
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from None
        first = stored.lstm_cells or features.size
        critic_sizes = stored.critic_layer_sizes or stored.layer_sizes
        for name, sizes in (("layer_sizes", stored.layer_sizes), ("critic_layer_sizes", critic_sizes)):
            fits = sizes[0] == first or (name == "critic_layer_sizes" and sizes[0] > first)
            if not fits or sizes[-1] != 1 or not all(1 <= size <= LARGEST_LAYER for size in sizes):
                raise ConfigurationError(
                    f"{path}: {name} = {list(sizes)}: must begin with {first}, end with 1 and stay within 4096"
                )
        if stored.features.normalised:
            like = Normalisation(_empty(features.moving), _empty(features.moving))
            features.normalisation = _stored(tensors, "normalisation", like, path)
            if not (features.normalisation.unit > 0.0).all():
                raise ConfigurationError(f"{path}: tensor 'normalisation.unit' must be positive")
        critic = lstm = None
        if stored.critic_layer_sizes is not None or any(name.startswith("critic") for name in tensors):
            critic = _stored_layers(tensors, "critic", critic_sizes, path)
        if (cells := stored.lstm_cells) is not None:
            empty = LSTM(_empty(4 * cells, features.size), _empty(4 * cells, cells), _empty(4 * cells))
            lstm = _stored(tensors, "lstm", empty, path)
        return cls(
            features,
            _stored_layers(tensors, "layer", stored.layer_sizes, path),
            stored.log_standard_deviation,
            stored.training,
            stored.activation,
            critic,
            stored.output,
            lstm,
        )


Part = TypeVar("Part", Normalisation, LSTM)


def _prefixed(name: str, part: Part) -> dict[str, NDArray[Any]]:
    return {f"{name}.{field}": value for field, value in part._asdict().items()}


def _stored(tensors: Tensors, name: str, like: Part, path: str | Path) -> Part:
    """The arrays of a part with the shapes of ``like``."""
    wanted = _prefixed(name, like)
    require(tensors, wanted, path)
    return type(like)(*(tensors[key] for key in wanted))


def _empty(*shape: int) -> NDArray[np.float32]:
    return np.empty(shape, dtype=np.float32)


def _sizes(layers: Layers) -> list[int]:
    return [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]


def _dense(modules: list[Any]) -> list[Any]:
    return [module for module in modules if hasattr(module, "weight")]  # the others are activations


def _layers(modules: list[Any]) -> Layers:
    return [(_array(module.weight), _array(module.bias)) for module in _dense(modules)]


def _array(tensor: Any) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().numpy().copy()
    return array


def _named(layers: Layers, name: str) -> dict[str, NDArray[Any]]:
    weights = {f"{name}{number}.weight": weight for number, (weight, _) in enumerate(layers)}
    return weights | {f"{name}{number}.bias": bias for number, (_, bias) in enumerate(layers)}


def _stored_layers(tensors: Tensors, name: str, sizes: tuple[int, ...], path: str | Path) -> Layers:
    shapes = [(_empty(after, before), _empty(after)) for before, after in pairwise(sizes)]
    require(tensors, _named(shapes, name), path)
    return [(tensors[f"{name}{n}.weight"], tensors[f"{name}{n}.bias"]) for n in range(len(shapes))]
