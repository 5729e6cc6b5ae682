"""The native vector environment as a stable-baselines3 ``VecEnv``, with the policy's features computed on the way."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from agents.controllers.pid import PIDState
from agents.learning.features import FeatureState, PolicyFeatures
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig

FEATURE_LIMIT = 50.0


class AxisVecEnv(VecEnv):
    """N axes for stable-baselines3: the policy sees :class:`PolicyFeatures`, its output becomes a command.

    ``infos`` carries what stable-baselines3 reads (``terminal_observation``, ``TimeLimit.truncated``, ``episode``) on
    the axes that ended, nothing elsewhere.

    With ``paired`` each axis has a twin with the same plant, reference and noise that the PID alone drives, and the
    reward is the difference to the twin's. What no controller can help (a large step, a bad plant) cancels out; the
    twin does not depend on the policy's actions, so that the policy gradient stays unbiased.

    Args:
        config: the task.
        count: number of axes.
        features: from observation to policy input, from output to command.
        seed: of axis 0; axis i gets seed + i.
        reward_scale: multiplies rewards, to keep values near 1.
        paired: reward against a twin under the PID; needs the residual form.
        stagger: end the first episodes at different steps, so that not all axes restart at once.
    """

    def __init__(
        self,
        config: TaskConfig,
        count: int,
        features: PolicyFeatures,
        seed: int = 0,
        reward_scale: float = 1.0,
        paired: bool = False,
        stagger: bool = True,
    ) -> None:
        if paired and features.pid is None:
            raise ConfigurationError("paired rewards need the residual form: a PID to compare with")
        self._paired = paired
        self._total = 2 * count if paired else count
        self.env = ServoHydraulicVectorEnv(self._total, config, autoreset_mode="Disabled", info=False)
        self.features = features
        self.reward_scale = reward_scale
        self.render_mode = None
        self._first_seed: int | None = seed
        self._next_options: dict[str, Any] | None = None
        self._state: FeatureState | None = None
        self._twins: PIDState | None = None
        self._twin_commands = np.zeros((0, 1), dtype=np.float32)
        self._actions: NDArray[np.float32] = np.zeros((count, 1), dtype=np.float32)
        self._returns = np.zeros(count)
        self._lengths = np.zeros(count, dtype=np.int64)
        self._stagger = stagger
        space = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (features.size,), np.float32)
        super().__init__(count, space, spaces.Box(-1.0, 1.0, (1,), np.float32))

    def reset(self) -> VecEnvObs:
        """Begin an episode on every axis; returns the policy's inputs (N, size)."""
        seed = self._first_seed
        seeds = None if seed is None else [seed + axis % self.num_envs for axis in range(self._total)]
        observation, _ = self.env.reset(seed=seeds, options=self._next_options)
        self._first_seed = None
        if self._stagger:
            steps = self.env.axes.column("step")
            steps[:] = (np.arange(self._total) % self.num_envs) * self.env.config.steps // self.num_envs
        self._returns[:] = 0.0
        self._lengths[:] = 0
        inputs, self._state = self.features(observation[: self.num_envs], None, None)
        self._drive_twins(observation[self.num_envs :], None)
        return np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)

    def _drive_twins(self, observation: NDArray[np.float32], restarted: NDArray[np.bool_] | None) -> None:
        if self._paired:
            assert self.features.pid is not None
            memory = self._twins if restarted is not None else None
            self._twin_commands, self._twins = self.features.pid.predict(observation, memory, restarted)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the policy's outputs (N, 1)."""
        self._actions = np.asarray(actions, dtype=np.float32)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all axes by one control period."""
        assert self._state is not None
        count = self.num_envs
        command = self.features.command(self._actions, self._state)
        if self._paired:
            command = np.concatenate([command, self._twin_commands])
        observation, rewards, terminated, truncated, _ = self.env.step(command)
        reward = rewards[:count]
        ended = terminated | truncated
        done = ended[:count]
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(count)]
        if self._paired:  # an axis and its twin restart together
            reward = reward - rewards[count:]
            done = done | ended[count:]
        if done.any():
            self._fill_infos(infos, np.flatnonzero(done), observation, terminated)
            mask = np.concatenate([done, done]) if self._paired else done
            observation, _ = self.env.reset(options={"reset_mask": mask})
        inputs, self._state = self.features(observation[:count], self._state, done)
        self._drive_twins(observation[count:], done)
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return (
            np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT),
            (reward * self.reward_scale).astype(np.float32),
            done,
            infos,
        )

    def _fill_infos(
        self, infos: list[dict[str, Any]], ended: NDArray[np.int64], last: NDArray[Any], terminated: NDArray[np.bool_]
    ) -> None:
        """The last inputs of the episodes that ended: their history with the last observation in place of the new."""
        assert self._state is not None
        of_ended = _rows(self._state, ended)
        inputs, _ = self.features(last[ended], of_ended, None)
        inputs = np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)
        for row, axis in enumerate(ended):
            infos[axis] = {
                "terminal_observation": inputs[row],
                "TimeLimit.truncated": not terminated[axis],
                "episode": {"r": float(self._returns[axis]), "l": int(self._lengths[axis]), "t": 0.0},
            }

    def close(self) -> None:
        """Stop the worker threads."""
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed of the next reset; axis i gets ``seed + i``."""
        self._first_seed = seed
        return [None if seed is None else seed + axis for axis in range(self.num_envs)]

    def set_options(self, options: Any = None) -> None:
        """Options of the next reset, as the vector environment takes them."""
        self._next_options = options

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute, the same for every axis."""
        value = getattr(self, attr_name) if hasattr(self, attr_name) else getattr(self.env, attr_name)
        return [value for _ in self._indices(indices)]

    def has_attr(self, attr_name: str) -> bool:
        """Whether the adaptor or its environment has an attribute."""
        return hasattr(self, attr_name) or hasattr(self.env, attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the adaptor, for all axes together."""
        del indices
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector environment once; every axis gets the same answer."""
        value = getattr(self.env, method_name)(*args, **kwargs)
        return [value for _ in self._indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """No axis has a wrapper of its own."""
        del wrapper_class
        return [False for _ in self._indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """The vector environment does not draw."""
        return [None for _ in range(self.num_envs)]

    def _indices(self, indices: VecEnvIndices) -> Iterable[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else indices


def _rows(state: FeatureState, rows: NDArray[np.int64]) -> FeatureState:
    """The memory of some axes, as a copy."""
    pid = state.pid
    if pid is not None:
        pid = type(pid)(pid.integral[rows], pid.velocity[rows], pid.position[rows])
    return FeatureState(pid, state.ring[rows].copy(), state.slot, state.base_command[rows].copy())
