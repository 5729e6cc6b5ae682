"""A critic that sees more than the actor in training: leak, plant, true state, bias, latency, family."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor

from hydro_agents.running.seeds import LEARNING
from hydro_env import REFERENCE_FAMILIES, ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.axes import Axes
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.states import STATES, TYPICAL_SIZE
from hydro_env.task.sensors import SENSOR_COLUMNS, SENSORS

PLANTS = 256  # number of plants that are drawn for the mean and the spread of each parameter
ERROR_SCALE = 1e-3  # m; scale of the true error
SMALLEST_LEAK = 1e-4  # l/min; the leak enters as the logarithm of its size relative to this


class Privileged:
    """The hidden quantities of N axes, scaled to order 1.

    Args:
        config: the task.
        any_axis: the same numbers for every rig: all parameters of the plant, zeros for those that a rig does not
            draw; states in parts of the rig's own full scale.

    Raises:
        ConfigurationError: a plant of the task cannot hold its initial position, or the task draws its rigs.
    """

    def __init__(self, config: TaskConfig, any_axis: bool = False) -> None:
        if config.law is not None:
            raise ConfigurationError("law: a told critic knows one rig; rig_tasks(config) lists those of the law")
        env = ServoHydraulicVectorEnv(PLANTS, config, info=False)
        env.reset(seed=list(LEARNING.take(PLANTS)))
        drawn = env.axes.physical
        area, pressure = (env.axes.coefficient[:, Coefficients._fields.index("area_a")], config.plant.supply.pressure)
        self._force = float(np.mean(area)) * pressure
        varied = np.isfinite(drawn).all(axis=0) & (drawn != drawn[0]).any(axis=0)
        self._drawn = varied | any_axis
        self._varied = varied[self._drawn]
        finite = np.where(self._varied, drawn[:, self._drawn], 0.0)
        self._mean, self._spread = finite.mean(axis=0), np.where(self._varied, finite.std(axis=0), 1.0)
        weights = [getattr(plant_coefficients(config.plant), f"{name}_weight") for name in STATES]
        self._state_size = 1.0 / np.array(weights) if any_axis else TYPICAL_SIZE
        sensors = [getattr(config.sensors, name) for name in SENSORS]
        self._bias = np.array([sensor.bias if sensor.bias > 0.0 else 1.0 for sensor in sensors])
        self._steps, self._period = config.steps, config.control_period
        self.size = self(env.axes).shape[1]
        env.close()

    def __call__(self, axes: Axes, chosen: slice | NDArray[np.int64] = slice(None)) -> NDArray[np.float32]:
        """The numbers of the ``chosen`` axes, (N, size)."""
        record = axes.record[chosen]
        state = axes.state[chosen] / self._state_size
        drawn = np.where(self._varied, axes.physical[chosen][:, self._drawn], 0.0)
        error = (record["reference"] - record["position"]) / ERROR_SCALE
        force = axes.coefficient[chosen, Coefficients._fields.index("external_force")] / self._force
        family = record["reference_family"][:, None] == np.arange(len(REFERENCE_FAMILIES))
        columns: list[NDArray[Any]] = [
            np.log10(np.maximum(record["leak_flow"], SMALLEST_LEAK))[:, None],
            (drawn - self._mean) / self._spread,
            state,
            error[:, None],
            force[:, None],
            record["bias"][:, SENSOR_COLUMNS] / self._bias,
            record["latency"][:, None] / self._period,
            family,
            1.0 - record["step"][:, None] / self._steps,
        ]
        return np.concatenate(columns, axis=1, dtype=np.float32)


ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


class _Extractor(MlpExtractor):
    """Like its parent, but the actor sees only the first inputs."""

    def __init__(self, actor_inputs: int, inputs: int, **options: Any) -> None:
        super().__init__(inputs, **options)
        if actor_inputs < inputs:
            self.policy_net = MlpExtractor(actor_inputs, **options).policy_net
        self._actor_inputs = actor_inputs

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Last hidden layer of the actor."""
        hidden: torch.Tensor = self.policy_net(features[:, : self._actor_inputs])
        return hidden

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Last hidden layers of actor and critic."""
        if not torch.is_grad_enabled():
            critic = _POOL.submit(torch.no_grad()(self.forward_critic), features)
            return self.forward_actor(features), critic.result()
        weights = *self.policy_net.parameters(), *self.value_net.parameters()
        latent: tuple[torch.Tensor, torch.Tensor] = _SideBySide.apply(self, features, *weights)  # type: ignore[no-untyped-call]
        return latent


_POOL = ThreadPoolExecutor(1, thread_name_prefix="critic")


class _SideBySide(torch.autograd.Function):
    """An update of actor and critic on two threads; they share no weights, so the numbers are those of one thread."""

    @staticmethod
    def forward(context: Any, extractor: _Extractor, features: torch.Tensor, *weights: torch.Tensor) -> Any:
        """Last hidden layers of actor and critic; ``weights`` tells the graph of ``features`` what has gradients."""
        del weights
        critic = _POOL.submit(extractor.forward_critic, features)
        with torch.enable_grad():
            context.latent = extractor.forward_actor(features), critic.result()
        context.weights = [tuple(net.parameters()) for net in (extractor.policy_net, extractor.value_net)]
        return tuple(latent.detach() for latent in context.latent)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> Any:
        """Gradients of the weights."""
        actor, critic = zip(context.latent, context.weights, gradients, strict=True)
        gradients_of: Any = torch.autograd.grad
        others = _POOL.submit(gradients_of, *critic)
        return None, None, *gradients_of(*actor), *others.result()


class AsymmetricPolicy(ActorCriticPolicy):
    """``MlpPolicy`` whose actor sees the first ``actor_inputs`` entries of an observation, and whose critic sees all.

    :class:`~hydro_agents.learning.vec_env.AxisVecEnv` with ``privileged`` gives such observations. A trained actor
    needs no hidden quantity.
    """

    def __init__(self, *arguments: Any, actor_inputs: int, **keywords: Any) -> None:
        self.actor_inputs = actor_inputs
        super().__init__(*arguments, **keywords)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _Extractor(
            self.actor_inputs,
            self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )
