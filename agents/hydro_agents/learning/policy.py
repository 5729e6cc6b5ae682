"""A trained policy as a controller: NumPy inference from safetensors, and conversion from and to stable-baselines3."""

from __future__ import annotations

from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from hydro_agents.controllers.base import Observation, as_batch
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.learning.features import FEATURE_LIMIT, FeatureState, Normalisation, PolicyFeatures
from hydro_agents.learning.lstm import LSTM
from hydro_agents.running.weights import load_weights, require, save_weights
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, validate

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv

KIND = "policy"
LONGEST_LAG = 10_000  # control periods; more must be a mistake
Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class _StoredBase(Group):
    kind: str
    settings: dict[str, Any]


class _StoredFeatures(Group):
    task: TaskConfig
    base: _StoredBase | None
    residual_scale: float = Field(gt=0.0, le=2.0)
    see_correction: bool = False
    full_preview: bool = False
    see_estimates: bool = False
    normalised: bool = False
    history_signals: tuple[str, ...]
    history_lags: tuple[Annotated[int, Field(ge=1, le=LONGEST_LAG)], ...] = Field(min_length=1, max_length=100)


class _StoredPolicy(Group):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    features: _StoredFeatures
    layer_sizes: tuple[int, ...] = Field(min_length=2, max_length=33)
    critic_layer_sizes: tuple[int, ...] | None = Field(None, min_length=2, max_length=33)
    log_standard_deviation: float = Field(ge=-20.0, le=5.0)
    activation: Literal["tanh", "relu"] = "tanh"
    output: Literal["linear", "tanh"] = "linear"
    lstm_cells: int | None = Field(None, ge=1, le=4096)
    training: dict[str, Any] = {}


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
        policy, env = model.policy, model.get_env()
        features = features or getattr(env, "features", None)
        activation = getattr(getattr(policy, "activation_fn", None), "__name__", "none").lower()
        off_policy = hasattr(getattr(policy, "actor", None), "latent_pi")  # of SAC and TQC
        if not (off_policy or hasattr(policy, "action_net")) or activation not in ("tanh", "relu"):
            raise ConfigurationError(f"from_sb3: {type(policy).__name__}: must be an MlpPolicy of tanh or relu layers")
        body = (
            [*policy.actor.latent_pi, policy.actor.mu]
            if off_policy
            else [*policy.mlp_extractor.policy_net, policy.action_net]
        )
        actor = _layers(body)
        recurrent = getattr(policy, "lstm_actor", None)
        lstm = LSTM.from_torch(recurrent) if recurrent is not None else None
        inputs = (actor[0][0] if lstm is None else lstm.inputs).shape[1]
        if features is None or inputs != features.size or len(actor[-1][1]) != 1:
            raise ConfigurationError(
                "from_sb3: the model's inputs must be PolicyFeatures: train it on AxisVecEnv(..., features=...)"
            )
        if off_policy:
            return cls(features, actor, training=training, activation=activation, output="tanh")
        # The critic of a recurrent policy has a recurrent layer of its own, and is of no use here.
        critic = _layers([*policy.mlp_extractor.value_net, policy.value_net]) if lstm is None else None
        spread = float(policy.log_std.detach().mean())
        return cls(features, actor, spread, training, activation, critic, lstm=lstm)

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

        from hydro_agents.learning.privileged import AsymmetricPolicy

        inputs = (env.observation_space.shape or (0,))[0]
        needed = self.features.size if self.critic is None else self.critic[0][0].shape[1]
        told = getattr(env, "told_critic", False)
        if inputs != needed and not (self.critic is None and told):
            more = ", told_critic=True" if needed > self.features.size else ""
            raise ConfigurationError(
                f"to_sb3: the environment gives inputs of shape ({inputs},), the policy needs ({needed},): "
                f"AxisVecEnv(config, count, features=policy.features{more}) gives them"
            )

        def hidden(layers: Layers) -> list[int]:
            return [len(bias) for _, bias in layers[:-1]]

        model = PPO(
            AsymmetricPolicy if told else "MlpPolicy",
            env,
            policy_kwargs={
                "net_arch": {"pi": hidden(self.layers), "vf": hidden(self.critic or self.layers)},
                "activation_fn": torch.nn.Tanh if self.activation == "tanh" else torch.nn.ReLU,
                "log_std_init": self.log_standard_deviation,
                **({"actor_inputs": self.features.size} if told else {}),
            },
            **{"device": "cpu", **keywords},
        )
        networks: list[tuple[Any, Any, Layers]] = [
            (model.policy.mlp_extractor.policy_net, model.policy.action_net, self.layers)
        ]
        if self.critic is not None:
            networks.append((model.policy.mlp_extractor.value_net, model.policy.value_net, self.critic))
        with torch.no_grad():
            for body, last, layers in networks:
                modules = [*(module for module in body if hasattr(module, "weight")), last]
                for module, (weight, bias) in zip(modules, layers, strict=True):
                    module.weight.copy_(torch.from_numpy(weight.copy()))
                    module.bias.copy_(torch.from_numpy(bias.copy()))
        return model

    def save(self, path: str | Path) -> Path:
        """Write weights and settings; see :func:`hydro_agents.running.weights.save_weights`."""
        tensors = _named(self.layers, "layer") | _named(self.critic or [], "critic")
        if self.features.normalisation is not None:
            tensors |= {f"normalisation.{name}": array for name, array in self.features.normalisation._asdict().items()}
        tensors |= self.lstm.tensors() if self.lstm is not None else {}
        settings = {
            "features": self.features.describe(),
            "layer_sizes": _sizes(self.layers),
            "critic_layer_sizes": None if self.critic is None else _sizes(self.critic),
            "log_standard_deviation": self.log_standard_deviation,
            "activation": self.activation,
            "output": self.output,
            **({"lstm_cells": self.lstm.cells} if self.lstm is not None else {}),
            "training": self.training,
        }
        return save_weights(path, KIND, tensors, settings)

    @classmethod
    def load(cls, path: str | Path) -> PolicyController:
        """Read what ``save`` wrote.

        Raises:
            ConfigurationError: missing, damaged or foreign files.
        """
        tensors, settings = load_weights(path, KIND)
        stored = validate(_StoredPolicy, settings, str(path))
        described, sizes = stored.features, stored.layer_sizes
        try:
            base: Any = described.base
            if base is not None:
                if base.kind not in CONTROLLERS:
                    raise ConfigurationError(f"features.base.kind = '{base.kind}': unknown to this version")
                base = make_controller(base.kind, described.task, base.settings)
            features = PolicyFeatures(
                described.task,
                base,
                described.residual_scale,
                described.see_correction,
                described.full_preview,
                described.see_estimates,
                lags=described.history_lags,
            )
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from None
        if described.history_signals != features.history:
            raise ConfigurationError(f"{path}: was trained on another history of signals than this version computes")
        critic_sizes = stored.critic_layer_sizes or sizes
        first = stored.lstm_cells or features.size
        for name, found in (("layer_sizes", sizes), ("critic_layer_sizes", critic_sizes)):
            fits = found[0] == first or (name[0] == "c" and found[0] > first)
            if not fits or found[-1] != 1 or not all(1 <= size <= 4096 for size in found):
                raise ConfigurationError(
                    f"{path}: {name} = {list(found)}: must begin with {first}, end with 1 and stay within 4096"
                )
        if described.normalised:
            features.normalisation = _stored_normalisation(tensors, features.size, path)
        layers = _stored_layers(tensors, "layer", sizes, path)
        has_critic = stored.critic_layer_sizes is not None or any(name.startswith("critic") for name in tensors)
        critic = _stored_layers(tensors, "critic", critic_sizes, path) if has_critic else None
        lstm = LSTM.stored(tensors, stored.lstm_cells, features.size, path) if stored.lstm_cells else None
        spread, record = stored.log_standard_deviation, stored.training
        return cls(features, layers, spread, record, stored.activation, critic, stored.output, lstm)


def _stored_normalisation(tensors: dict[str, NDArray[Any]], size: int, path: str | Path) -> Normalisation:
    ones = np.ones(size, dtype=np.float32)
    require(tensors, {f"normalisation.{name}": ones for name in Normalisation._fields}, path)
    found = Normalisation(*(tensors[f"normalisation.{name}"] for name in Normalisation._fields))
    if not (found.unit > 0.0).all():
        raise ConfigurationError(f"{path}: tensor 'normalisation.unit' must be positive")
    return found


def _sizes(layers: Layers) -> list[int]:
    return [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]


def _layers(modules: list[Any]) -> Layers:
    return [
        (module.weight.detach().cpu().numpy().copy(), module.bias.detach().cpu().numpy().copy())
        for module in modules
        if hasattr(module, "weight")
    ]


def _named(layers: Layers, name: str) -> dict[str, NDArray[Any]]:
    weights = {f"{name}{number}.weight": weight for number, (weight, _) in enumerate(layers)}
    return weights | {f"{name}{number}.bias": bias for number, (_, bias) in enumerate(layers)}


def _stored_layers(tensors: dict[str, NDArray[Any]], name: str, sizes: tuple[int, ...], path: str | Path) -> Layers:
    shapes: Layers = [
        (np.empty((outputs, inputs), dtype=np.float32), np.empty(outputs, dtype=np.float32))
        for inputs, outputs in pairwise(sizes)
    ]
    require(tensors, _named(shapes, name), path)
    return [(tensors[f"{name}{n}.weight"], tensors[f"{name}{n}.bias"]) for n in range(len(shapes))]
