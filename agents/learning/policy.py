"""A trained policy as a controller: NumPy inference from safetensors, no learning library needed."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Floats, ObservationLayout, as_batch
from agents.controllers.pid import PIDGains
from agents.learning.features import HISTORY_LAGS, HISTORY_SIGNALS, FeatureState, PolicyFeatures
from agents.learning.vec_env import FEATURE_LIMIT
from agents.running.weights import load_weights, require, save_weights
from hydro_env import ConfigurationError
from hydro_env.files import validate

KIND = "policy"


class PolicyController:
    """The deterministic policy of PPO: a network of dense layers from features to a command.

    Same interface as every controller; see :class:`~agents.controllers.base.Controller`. With
    ``deterministic=False`` Gaussian exploration noise of the trained size is added.

    Args:
        features: from observation to policy input, from output to command.
        layers: (weight (out, in), bias (out,)) of each layer.
        log_standard_deviation: of the exploration noise.
        activation: of the hidden layers, ``tanh`` or ``relu``.
        training: how the weights came about (JSON), for the record.
    """

    def __init__(
        self,
        features: PolicyFeatures,
        layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
        log_standard_deviation: float = -3.0,
        training: dict[str, Any] | None = None,
        activation: str = "tanh",
    ) -> None:
        self.features = features
        self.layers = layers
        self.log_standard_deviation = log_standard_deviation
        self.training = training or {}
        self.activation = activation
        self._generator = np.random.default_rng(0)

    def predict(
        self,
        observation: Floats,
        state: FeatureState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], FeatureState]:
        """Commands for the observations, and the memory for the next call."""
        batch, single = as_batch(observation)
        inputs, state = self.features(batch, state, episode_start)
        values = np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)
        for weight, bias in self.layers[:-1]:
            values = values @ weight.T + bias
            values = np.tanh(values, out=values) if self.activation == "tanh" else np.maximum(values, 0.0, out=values)
        weight, bias = self.layers[-1]
        output = values @ weight.T + bias
        if not deterministic:
            output = output + np.exp(self.log_standard_deviation) * self._generator.standard_normal(output.shape)
        command = self.features.command(output, state)
        return (command[0] if single else command), state

    @classmethod
    def from_model(cls, model: Any, features: PolicyFeatures, training: dict[str, Any]) -> PolicyController:
        """Take the actor out of a stable-baselines3 PPO model."""
        modules = [module for module in model.policy.mlp_extractor.policy_net if hasattr(module, "weight")]
        layers = [
            (module.weight.detach().cpu().numpy().copy(), module.bias.detach().cpu().numpy().copy())
            for module in [*modules, model.policy.action_net]
        ]
        activation = model.policy.activation_fn.__name__.lower()
        return cls(features, layers, float(model.policy.log_std.detach().mean()), training, activation)

    def save(self, path: str | Path) -> Path:
        """Write weights and settings; see :func:`agents.running.weights.save_weights`."""
        tensors: dict[str, NDArray[Any]] = {}
        for number, (weight, bias) in enumerate(self.layers):
            tensors[f"layer{number}.weight"] = weight
            tensors[f"layer{number}.bias"] = bias
        settings = {
            "features": self.features.describe(),
            "layer_sizes": [self.features.size, *(len(bias) for _, bias in self.layers)],
            "log_standard_deviation": self.log_standard_deviation,
            "activation": self.activation,
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
        try:
            described = settings["features"]
            layout = ObservationLayout(
                tuple(described["observation_names"]),
                tuple(described["observation_scale"]),
                float(described["control_period"]),
            )
            gains = described["pid_gains"]
            scale = float(described["residual_scale"])
            sizes = [int(size) for size in settings["layer_sizes"]]
            deviation = float(settings["log_standard_deviation"])
            history = described["history_signals"], described["history_lags"]
            activation = settings.get("activation", "tanh")
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(f"{path}: its JSON lacks or mistypes {error}") from None
        if history != (list(HISTORY_SIGNALS), list(HISTORY_LAGS)):
            raise ConfigurationError(f"{path}: was trained on another history of signals than this version computes")
        features = PolicyFeatures(layout, validate(PIDGains, gains, str(path)) if gains is not None else None, scale)
        shapes: dict[str, tuple[int, ...]] = {}
        for number, (inputs, outputs) in enumerate(pairwise(sizes)):
            shapes[f"layer{number}.weight"] = (outputs, inputs)
            shapes[f"layer{number}.bias"] = (outputs,)
        if activation not in ("tanh", "relu"):
            raise ConfigurationError(f"{path}: activation = {activation!r}: must be 'tanh' or 'relu'")
        if sizes[0] != features.size or sizes[-1] != 1:
            raise ConfigurationError(f"{path}: layer_sizes = {sizes}: must begin with {features.size} and end with 1")
        require(tensors, shapes, path)
        layers = [(tensors[f"layer{n}.weight"], tensors[f"layer{n}.bias"]) for n in range(len(sizes) - 1)]
        return cls(features, layers, deviation, settings.get("training"), activation)
