"""A trained policy as a controller: NumPy inference from safetensors, and conversion from stable-baselines3."""

from copy import copy
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium as gym
import numpy as np
from pydantic import ConfigDict, Field

from hydro_agents.controllers.base import Observation, as_batch
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.learning.any_axis import AnyAxisFeatures
from hydro_agents.learning.features import FEATURE_LIMIT, FeatureState, Normalisation, PolicyFeatures, Standardisation
from hydro_agents.learning.rig_gains import GainsFor, searched_gains
from hydro_agents.running.weights import load_weights, save_weights
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.errors import reason
from hydro_env.files import Group, validate
from hydro_env.types import ByName, Mask, Singles

KIND = "policy"
_NORMALISATION = ("normalisation.centre", "normalisation.unit", "normalisation.limit")  # the last: if standardised
_LSTM = ("lstm.inputs", "lstm.recurrent", "lstm.bias")
LONGEST_LAG = 10_000  # control periods; more must be a mistake
Layers = list[tuple[Singles, Singles]]


class _StoredBase(Group):
    kind: str
    settings: ByName


class _StoredFeatures(Group):
    """The part of a weights' JSON that describes features."""

    task: TaskConfig
    base: _StoredBase | None
    residual_scale: float = Field(gt=0.0, le=2.0)
    full_preview: bool = False
    see_estimates: bool = False
    normalised: bool = False
    history_signals: tuple[str, ...]
    history_lags: tuple[Annotated[int, Field(ge=1, le=LONGEST_LAG)], ...]
    any_axis: bool = False
    correction: float = Field(0.2, gt=0.0, le=2.0)
    error: float = Field(1.0, gt=0.0, le=1e6)

    def features(self) -> PolicyFeatures:
        """The features, not yet normalised.

        Raises:
            ConfigurationError: this version has no such controller or history.
        """
        base: Any = None
        if self.base is not None:
            if self.base.kind not in CONTROLLERS:  # no other one: weights run no code
                raise ConfigurationError(f"features.base.kind = '{self.base.kind}': unknown to this version")
            base = make_controller(self.base.kind, self.task, self.base.settings)
        if self.any_axis:
            return AnyAxisFeatures(self.task, base, self.correction, self.error, len(self.history_lags))
        features = PolicyFeatures(
            self.task, base, self.residual_scale, self.full_preview, self.see_estimates, lags=self.history_lags
        )
        if self.history_signals != features.history:
            raise ConfigurationError("was trained on another history of signals than this version computes")
        return features


class _StoredPolicy(Group):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    features: _StoredFeatures
    layer_sizes: tuple[int, ...] = Field(min_length=2)
    activation: Literal["tanh", "relu"] = "tanh"
    output: Literal["linear"] = "linear"  # limited to ±1
    lstm_cells: int | None = None
    training: ByName = {}


class LSTM(NamedTuple):
    """A recurrent layer with H cells, long short-term memory (Hochreiter & Schmidhuber, 1997).

    Its gates are input, forget, cell and output, as in torch.
    """

    inputs: Singles  # (4 H, inputs)
    recurrent: Singles  # (4 H, H)
    bias: Singles  # (4 H,)

    def __call__(self, values: Singles, memory: Singles | None, episode_start: Mask | None) -> tuple[Singles, Singles]:
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
        entry, kept, new, shown = (gates[:, gate * size : (gate + 1) * size] for gate in range(4))
        cells = _sigmoid(kept) * cells + _sigmoid(entry) * np.tanh(new)
        output = _sigmoid(shown) * np.tanh(cells)
        return output, np.concatenate([output, cells], axis=1)


def _sigmoid(x: Singles) -> Singles:
    half = np.float32(0.5)
    return half + half * np.tanh(half * x)


class PolicyController:
    """An actor network from features to a command: dense layers, with a recurrent layer before them if trained so.

    It has the interface of every controller; see :class:`~hydro_agents.controllers.base.Controller`. It never explores.

    Args:
        features: map observations to policy inputs, and outputs to commands.
        layers: (weight (out, in), bias (out,)) of each layer of the actor.
        activation: activation of the hidden layers, ``tanh`` or ``relu``.
        training: record of the training (JSON).
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
        training: ByName | None = None,
        activation: str = "tanh",
        lstm: LSTM | None = None,
    ) -> None:
        self.features, self.layers, self.training = features, layers, training or {}
        self.activation, self.lstm = activation, lstm

    def predict(
        self,
        observation: Observation,
        state: FeatureState | None = None,
        episode_start: Mask | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, FeatureState]:
        """Commands for the observations, and the memory for the next call."""
        del deterministic
        batch, single = as_batch(observation, state)
        inputs, state = self.features(batch, state, episode_start)
        values = np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)
        if self.lstm is not None:
            values, hidden = self.lstm(values, state.hidden, episode_start)
            state = state._replace(hidden=hidden)
        *dense, (weight, bias) = self.layers
        for weights, biases in dense:
            values = values @ weights.T + biases
            if self.activation == "tanh":
                values = np.tanh(values, out=values)
            else:
                values = np.maximum(values, 0.0, out=values)
        output = values @ weight.T + bias
        command = self.features.command(output, state)
        return (command[0] if single else command), state

    @classmethod
    def from_sb3(
        cls, model: Any, features: PolicyFeatures | None = None, training: ByName | None = None
    ) -> "PolicyController":
        """Copy the actor of a model of stable-baselines3.

        Args:
            model: of PPO or A2C with an ``MlpPolicy``, or of RecurrentPPO with an ``MlpLstmPolicy``; its dense layers
                are of tanh or relu.
            features: map observations to the model's inputs; default: those of the model's environment. Where that has
                none, the inputs are the observation, standardised where ``VecNormalize`` does it.
            training: record of the training.

        Raises:
            ConfigurationError: the model has another kind of network or other inputs, or no environment.
        """
        policy: Any = getattr(model, "policy", None)
        activation = getattr(getattr(policy, "activation_fn", None), "__name__", "none").lower()
        if not hasattr(policy, "action_net") or activation not in ("tanh", "relu"):
            raise ConfigurationError(f"from_sb3: {type(policy).__name__}: must be an MlpPolicy of tanh or relu layers")
        unknown = {
            "a features extractor of its own": type(policy.features_extractor).__name__ != "FlattenExtractor",
            "squash_output": policy.squash_output,
            "several recurrent layers": getattr(getattr(policy, "lstm_actor", None), "num_layers", 1) > 1,
            "a policy of its own": _foreign(policy) or _foreign(policy.mlp_extractor),
        }
        for what, present in unknown.items():
            if present:
                raise ConfigurationError(f"from_sb3: the model has {what}: must have none")
        features = features or _features_of(model)
        layers = []
        for module in (*policy.mlp_extractor.policy_net, policy.action_net):
            if hasattr(module, "weight"):  # the others are activations
                layers.append((_array(module.weight), _array(module.bias)))
        lstm, inputs = None, layers[0][0].shape[1]
        if hasattr(policy, "lstm_actor"):
            layer = policy.lstm_actor
            bias = _array(layer.bias_ih_l0) + _array(layer.bias_hh_l0)
            lstm = LSTM(_array(layer.weight_ih_l0), _array(layer.weight_hh_l0), bias)
            inputs = lstm.inputs.shape[1]
        if inputs != features.size or len(layers[-1][1]) != 1:
            must = "those of the observation, or of features of AxisVecEnv"
            raise ConfigurationError(f"from_sb3: the model has {inputs} inputs: must be {features.size}, {must}")
        return cls(features, layers, training, activation, lstm)

    def into(self, model: Any) -> None:
        """Copy this actor into a model of stable-baselines3, the reverse of :meth:`from_sb3`.

        Raises:
            ConfigurationError: the model has other layers.
        """
        import torch

        policy = model.policy
        modules = [module for module in policy.mlp_extractor.policy_net if hasattr(module, "weight")]
        pairs = []
        for module, (weight, bias) in zip([*modules, policy.action_net], self.layers, strict=False):
            pairs += [(module.weight, weight), (module.bias, bias)]
        if self.lstm is not None and hasattr(policy, "lstm_actor"):
            layer, own = policy.lstm_actor, self.lstm
            pairs += [(layer.weight_ih_l0, own.inputs), (layer.weight_hh_l0, own.recurrent)]
            pairs += [(layer.bias_ih_l0, own.bias), (layer.bias_hh_l0, 0.0 * own.bias)]
        sizes = [tuple(mine.shape) for mine, _ in pairs]
        same = len(modules) + 1 == len(self.layers) and (self.lstm is None) != hasattr(policy, "lstm_actor")
        if not same or sizes != [given.shape for _, given in pairs]:
            raise ConfigurationError("start: its weights have other inputs or layers than the settings")
        with torch.no_grad():
            for mine, given in pairs:
                mine.copy_(torch.from_numpy(given.copy()))

    def moved_to(self, config: TaskConfig, gains: GainsFor = searched_gains) -> "PolicyController":
        """A policy for any axis on the rig of another task; ``gains`` finds those of the controller that it corrects.

        Raises:
            ConfigurationError: the policy serves the rig of its training alone, or the rig lacks a sensor.
        """
        if not isinstance(self.features, AnyAxisFeatures):
            raise ConfigurationError("moved_to: must be a policy for any axis")
        moved = copy(self)
        moved.features = self.features.moved_to(config, gains)
        return moved

    def save(self, path: str | Path) -> Path:
        """Write weights and settings; see :func:`hydro_agents.running.weights.save_weights`."""
        settings = {
            "features": self.features.describe(),
            "layer_sizes": [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)],
            "activation": self.activation,
            "output": "linear",
        }
        tensors = {}
        for number, (weight, bias) in enumerate(self.layers):
            tensors[f"layer{number}.weight"], tensors[f"layer{number}.bias"] = weight, bias
        if self.features.normalisation is not None:
            tensors |= dict(zip(_NORMALISATION, self.features.normalisation, strict=False))
        if self.lstm is not None:
            settings["lstm_cells"] = self.lstm.recurrent.shape[1]
            tensors |= dict(zip(_LSTM, self.lstm, strict=True))
        return save_weights(path, KIND, tensors, {**settings, "training": self.training})

    @classmethod
    def load(cls, path: str | Path) -> "PolicyController":
        """Read what ``save`` wrote.

        Raises:
            ConfigurationError: missing, damaged or foreign files.
        """
        tensors, settings = load_weights(path, KIND)
        stored = validate(_StoredPolicy, settings, path)
        layers, lstm = [], None
        try:
            features = stored.features.features()
            if stored.features.normalised:
                parts = [tensors[name] for name in _NORMALISATION if name in tensors]
                features.normalisation = (Normalisation if len(parts) == 2 else Standardisation)(*parts)
            if stored.lstm_cells is not None:
                lstm = LSTM(*(tensors[name] for name in _LSTM))
            for number in range(len(stored.layer_sizes) - 1):
                layers.append((tensors[f"layer{number}.weight"], tensors[f"layer{number}.bias"]))
            policy = cls(features, layers, stored.training, stored.activation, lstm)
            command, _ = policy.predict(np.zeros((1, len(features.layout.names)), np.float32))
        except Exception as error:  # damaged weights with a digest of their own may raise anything
            raise ConfigurationError(f"{path}: {reason(error)}") from None
        if command.shape != (1, 1) or not np.isfinite(command).all():
            raise ConfigurationError(f"{path}: gives no finite command")
        return policy


def _foreign(thing: Any) -> bool:
    """Whether the class of a thing may do what a copy of weights does not."""
    return type(thing).__module__.partition(".")[0] not in ("stable_baselines3", "sb3_contrib", "gymnasium")


def _features_of(model: Any) -> PolicyFeatures:
    """What maps observations to the inputs of a model, from its environment.

    Raises:
        ConfigurationError: it has no environment of this project, or one that scales features twice.
    """
    env, scaling = model.get_env(), None
    wrappers = []
    while hasattr(env, "venv"):
        wrappers.append(env)
        if getattr(env, "norm_obs", False):
            if scaling is not None:
                raise ConfigurationError("from_sb3: VecNormalize scales observations twice: one must be absent")
            scaling = env
        env = env.venv
    for each in getattr(env, "envs", ()):
        while isinstance(each, gym.Wrapper):
            wrappers.append(each)
            each = each.env
    for each in wrappers:
        if _foreign(each):
            raise ConfigurationError(f"from_sb3: {type(each).__name__} may change the environment: must be absent")
    for wrapper in (gym.ObservationWrapper, gym.ActionWrapper):
        if env is not None and any(env.env_is_wrapped(wrapper)):
            raise ConfigurationError(
                f"from_sb3: a gymnasium.{wrapper.__name__} changes the environment: must be absent"
            )
    try:
        config = env.get_attr("config")[0]
    except AttributeError:
        raise ConfigurationError("from_sb3: the model has no environment of hydro_env: model.set_env(env)") from None
    features = copy(getattr(env, "features", None) or PolicyFeatures(config, lags=()))
    if scaling is not None:
        if features.normalisation is not None:
            raise ConfigurationError("from_sb3: VecNormalize and normalised features: one of them must be absent")
        numbers = (scaling.obs_rms.mean, np.sqrt(scaling.obs_rms.var + scaling.epsilon), scaling.clip_obs)
        features.normalisation = Standardisation(*(np.asarray(part, np.float32) for part in numbers))
    return features


def _array(tensor: Any) -> Singles:
    return tensor.detach().cpu().numpy().copy()
