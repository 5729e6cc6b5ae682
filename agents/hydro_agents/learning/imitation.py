"""Imitation as the first part of a training: the policy learns its teacher's commands on the states that it reaches.

Source: Ross, Gordon & Bagnell, *A reduction of imitation learning and structured prediction to no-regret online
learning*, AISTATS 2011 (DAgger, here with the newest states alone). The critic learns the policy's own returns.
"""

from typing import Any

import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch.nn.functional import mse_loss, smooth_l1_loss

ACTOR = ("lstm_actor", "mlp_extractor.policy_net", "action_net")  # of the networks of stable-baselines3
FLOOR = 0.01  # of full command


def misses(commands: torch.Tensor, lessons: torch.Tensor) -> torch.Tensor:
    """How far commands are from the teacher's, as fractions of full command, (N,).

    Both are compared as arcsinh(u / :data:`FLOOR`): a miss of a small command counts by its size, of a large one by its
    ratio, and a start that comes too early as much as one that comes too late.
    """
    return smooth_l1_loss(torch.asinh(commands / FLOOR), torch.asinh(lessons / FLOOR), reduction="none").flatten()


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
        self.rollout_buffer.actions[:] = self.lessons
        recurrent = isinstance(self, RecurrentPPO)
        actor: list[torch.nn.Parameter] = []
        critic: list[torch.nn.Parameter] = []
        missed = []
        for name, weights in self.policy.named_parameters():
            (actor if name.startswith(ACTOR) else critic).append(weights)
        for _ in range(self.n_epochs):
            for batch in self.rollout_buffer.get(self.batch_size):
                actor_memory: tuple[Any, ...] = ()
                critic_memory: tuple[Any, ...] = ()
                if recurrent:
                    actor_memory, critic_memory = ((part, batch.episode_starts) for part in batch.lstm_states)
                distribution = self.policy.get_distribution(batch.observations, *actor_memory)
                commands = (distribution[0] if recurrent else distribution).mode()
                miss = misses(commands, batch.actions)
                real = batch.mask > 0.5 if recurrent else torch.ones_like(miss, dtype=torch.bool)
                loss = miss[real].mean()
                missed.append(loss.item())
                if self.imitated_steps < self._total_timesteps:  # else no critic is needed afterwards
                    value = self.policy.predict_values(batch.observations, *critic_memory)
                    loss = loss + self.vf_coef * mse_loss(value.flatten()[real], batch.returns[real])
                self.policy.optimizer.zero_grad()
                loss.backward()
                for part in actor, critic:  # together, the errors of a young critic would leave the actor nothing
                    torch.nn.utils.clip_grad_norm_(part, self.max_grad_norm)
                self.policy.optimizer.step()
        self._n_updates += self.n_epochs
        self.logger.record("train/miss_of_teacher", np.mean(missed))


class ImitatingPPO(_Imitating, PPO):
    """PPO after imitation."""


class ImitatingRecurrentPPO(_Imitating, RecurrentPPO):
    """RecurrentPPO after imitation."""
