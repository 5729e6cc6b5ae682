"""Imitation as the first part of a training: the policy learns its teacher's commands on the states that it reaches.

Source: Ross, Gordon & Bagnell, *A reduction of imitation learning and structured prediction to no-regret online
learning*, AISTATS 2011 (DAgger, here with the newest states alone). The critic learns the policy's own returns.
"""

import math
from typing import Any

import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch.nn.functional import mse_loss

ACTOR = ("lstm_actor", "mlp_extractor.policy_net", "action_net")  # of the networks of stable-baselines3
FLOOR = 0.01  # of full command; smaller commands of the teacher are missed by parts of this, larger ones by their own
WORST = 25.0  # largest squared miss that counts


class _Imitating:
    """PPO whose updates imitate the environment's teacher during the first ``imitated_steps``."""

    imitated_steps = 0

    def collect_rollouts(self: Any, env: VecEnv, *arguments: Any, **named: Any) -> bool:
        """Collect a rollout, and the teacher's commands on its states."""
        lessons: list[Any] | None = [] if self.num_timesteps < self.imitated_steps else None
        env.set_attr("lessons", lessons)
        whole: bool = super().collect_rollouts(env, *arguments, **named)  # type: ignore[misc]
        self.lessons = lessons and np.stack(lessons)
        return whole

    def train(self: Any) -> None:
        """Update from the last rollout."""
        if self.lessons is None:
            super().train()  # type: ignore[misc]
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        self.rollout_buffer.actions[:] = self.lessons  # the density at the lessons tells how far the policy misses them
        recurrent = isinstance(self, RecurrentPPO)
        actor: list[torch.nn.Parameter] = []
        critic: list[torch.nn.Parameter] = []
        misses = []
        for name, weights in self.policy.named_parameters():
            (actor if name.startswith(ACTOR) else critic).append(weights)
        for _ in range(self.n_epochs):
            for batch in self.rollout_buffer.get(self.batch_size):
                value = None
                if recurrent or self.imitated_steps < self._total_timesteps:
                    memory = (batch.lstm_states, batch.episode_starts) if recurrent else ()
                    value, density, _ = self.policy.evaluate_actions(batch.observations, batch.actions, *memory)
                else:  # no critic is needed afterwards
                    density = self.policy.get_distribution(batch.observations).log_prob(batch.actions)
                spread = self.policy.log_std.exp()
                squared = -2.0 * spread**2 * (density + (spread * math.sqrt(2.0 * math.pi)).log())
                relative = (squared / (FLOOR + batch.actions.flatten().abs()) ** 2).clamp(max=WORST)
                real = batch.mask > 0.5 if recurrent else torch.ones_like(squared, dtype=torch.bool)
                loss = relative[real].mean()
                if value is not None:
                    loss = loss + self.vf_coef * mse_loss(value.flatten()[real], batch.returns[real])
                self.policy.optimizer.zero_grad()
                loss.backward()
                for part in actor, critic:  # together, the errors of a young critic would leave the actor nothing
                    torch.nn.utils.clip_grad_norm_(part, self.max_grad_norm)
                self.policy.optimizer.step()
                misses.append(relative[real].mean().item())
        self._n_updates += self.n_epochs
        self.logger.record("train/miss_of_teacher", np.mean(misses))


class ImitatingPPO(_Imitating, PPO):
    """PPO after imitation."""


class ImitatingRecurrentPPO(_Imitating, RecurrentPPO):
    """RecurrentPPO after imitation."""
