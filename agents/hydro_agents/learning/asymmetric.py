"""An actor that sees the policy's inputs, and a critic that sees more: both for PPO of stable-baselines3."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import Tensor


class _Extractor(MlpExtractor):
    """Like its parent, but the actor sees only the first inputs.

    Args:
        actor_inputs: number of the inputs that the actor sees.
        inputs: number of all inputs.
        options: as for ``MlpExtractor``.
    """

    def __init__(self, actor_inputs: int, inputs: int, **options: Any) -> None:
        super().__init__(inputs, **options)
        self.policy_net = MlpExtractor(actor_inputs, **options).policy_net
        self._actor_inputs = actor_inputs

    def forward_actor(self, features: Tensor) -> Tensor:
        """Last hidden layer of the actor."""
        hidden: Tensor = self.policy_net(features[:, : self._actor_inputs])
        return hidden

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Last hidden layers of actor and critic."""
        return self.forward_actor(features), self.forward_critic(features)


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
