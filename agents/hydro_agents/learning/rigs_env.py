"""Axes of many rigs at once, for training a policy that serves any axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from hydro_agents.learning.features import FEATURE_LIMIT, AnyAxisFeatures, periods_per_step
from hydro_agents.learning.vec_env import AxisVecEnv

RIG = "rig"


class RigsVecEnv(VecEnv):
    """The axes of several :class:`AxisVecEnv`, one per rig, in one batch; their inputs mean the same on every rig.

    Args:
        envs: one per rig.
        features: of the task that the weights' file names.
    """

    def __init__(self, envs: Sequence[AxisVecEnv], features: AnyAxisFeatures) -> None:
        self.envs, self.features = list(envs), features
        self.render_mode = None
        ends = np.cumsum([env.num_envs for env in envs])
        self._parts = [slice(end - env.num_envs, end) for env, end in zip(envs, ends, strict=True)]
        self._actions: NDArray[np.float32] = np.zeros((int(ends[-1]), 1), dtype=np.float32)
        inputs = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (features.size,), np.float32)
        super().__init__(int(ends[-1]), inputs, spaces.Box(-1.0, 1.0, (1,), np.float32))

    def periods_per_step(self) -> NDArray[np.float64]:
        """Control periods in a step of the rig, of each axis, (N,)."""
        periods = [np.full(env.num_envs, periods_per_step(env.env.config)) for env in self.envs]
        return np.concatenate(periods)

    def reset(self) -> VecEnvObs:
        """Begin an episode on every axis."""
        return np.concatenate([env.reset() for env in self.envs])

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the policy's outputs (N, 1) for ``step_wait``."""
        self._actions = np.asarray(actions, dtype=np.float32)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all axes by one control period of their rig."""
        parts = []
        for env, part in zip(self.envs, self._parts, strict=True):
            env.step_async(self._actions[part])
            parts.append(env.step_wait())
        inputs, rewards, done, infos = zip(*parts, strict=True)
        every = [info for group in infos for info in group]
        return np.concatenate(inputs), np.concatenate(rewards), np.concatenate(done), every

    def mean_rewards(self) -> dict[str, float]:
        """Mean over the rigs of :meth:`AxisVecEnv.mean_rewards`."""
        means = [env.mean_rewards() for env in self.envs]
        return {name: float(np.mean([each[name] for each in means])) for name in means[0]}

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Complete state as copies of named arrays, for :meth:`set_state`."""
        states = enumerate(env.get_state() for env in self.envs)
        return {f"{RIG}{number}.{name}": array for number, state in states for name, array in state.items()}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state of :meth:`get_state`.

        Raises:
            ConfigurationError: the arrays describe no possible state of an axis.
        """
        for number, env in enumerate(self.envs):
            start = f"{RIG}{number}."
            env.set_state({name.removeprefix(start): array for name, array in state.items() if name.startswith(start)})

    def close(self) -> None:
        """Stop the worker threads."""
        for env in self.envs:
            env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute, the same for every axis."""
        return self.envs[0].get_attr(attr_name, indices)[:1] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the adaptor of every rig."""
        for env in self.envs:
            env.set_attr(attr_name, value, indices)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of every rig's environment; each axis gets its rig's answer."""
        del indices
        return [value for env in self.envs for value in env.env_method(method_name, *args, **kwargs)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """No axis has a wrapper of its own."""
        del wrapper_class, indices
        return [False] * self.num_envs

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """The axes of each rig get their seeds in turn."""
        first = 0 if seed is None else seed
        return [
            value for env, part in zip(self.envs, self._parts, strict=True) for value in env.seed(first + part.start)
        ]
