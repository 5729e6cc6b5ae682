"""The native vector environment as a ``VecEnv`` of stable-baselines3, with or without the policy's features."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from hydro_agents.learning.features import FEATURE_LIMIT, FeatureState, PolicyFeatures
from hydro_agents.learning.privileged import Privileged
from hydro_agents.learning.settings import Prices
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.axes import AxesState
from hydro_env.task.rewards import REWARD_TERMS

Array = NDArray[Any]
ENV = "env."

REWARD_PARTS = (*REWARD_TERMS, "prices", "learned")
"""The terms of the task; the prices, relative to the twin; and what the policy learns from, before ``reward_scale``."""


class AxisVecEnv(VecEnv):
    """N axes in one compiled step, for any algorithm of stable-baselines3; several times faster than ``DummyVecEnv``.

    Observations and actions are those of the environment. With ``features`` the policy gets :class:`PolicyFeatures`
    instead; they also turn its outputs into commands.

    ``infos`` holds the entries of stable-baselines3 (``terminal_observation``, ``TimeLimit.truncated``, ``episode``)
    for axes whose episode has ended, and is empty for the others. Such an axis has already begun its next episode.

    With ``paired`` each axis has a twin with the same plant, reference and noise, driven by the corrected controller
    alone; the reward is the difference to the twin's reward. Errors that no controller can avoid cancel out. The twin
    does not depend on the policy's actions; the policy gradient therefore remains unbiased.

    Args:
        config: the task, as for the environments.
        count: number of axes N.
        features: map observations to policy inputs, and outputs to commands; ``None`` leaves both unchanged.
        seed: seed of axis 0; axis i gets seed + i.
        reward_scale: factor on rewards, which keeps values near 1.
        paired: reward relative to a twin under the corrected controller; needs features in the residual form.
        stagger: advance the clock of axis i by i/N of an episode at the first reset; the axes then restart at
            different times. The references jump at that moment; later episodes are whole.
        told_critic: append hidden quantities to the inputs, for the critic
            (:class:`~hydro_agents.learning.privileged.Privileged`).
        prices: additional costs; see :class:`~hydro_agents.learning.settings.Prices`.
        overrides: single fields of the task.

    Raises:
        ConfigurationError: the task is impossible, or ``paired`` has no controller to compare with.

    Example:
        >>> from stable_baselines3 import PPO
        >>> from hydro_agents.learning.vec_env import AxisVecEnv
        >>> env = AxisVecEnv({"episode_duration": 1.0}, 64)
        >>> model = PPO("MlpPolicy", env, n_steps=8, batch_size=512, n_epochs=1, device="cpu").learn(512)
        >>> model.num_timesteps
        512
    """

    def __init__(
        self,
        config: TaskConfig | Mapping[str, Any] | str | Path | None = None,
        count: int = 1,
        features: PolicyFeatures | None = None,
        seed: int = 0,
        reward_scale: float = 1.0,
        paired: bool = False,
        stagger: bool = False,
        told_critic: bool = False,
        prices: Prices | None = None,
        **overrides: Any,
    ) -> None:
        if paired and (features is None or features.base is None):
            raise ConfigurationError("paired rewards need the residual form: a controller to compare with")
        self._paired = paired
        self._total = 2 * count if paired else count
        self.env = ServoHydraulicVectorEnv(self._total, config, autoreset_mode="Disabled", info=False, **overrides)
        self.features = features
        self.reward_scale = reward_scale
        self.render_mode = None
        self._first_seed: int | None = seed
        self._next_options: dict[str, Any] | None = None
        self._state: FeatureState | None = None
        self._twins: Any = None
        self._twin_commands = np.zeros((0, 1), dtype=np.float32)
        self._actions: NDArray[np.float32] = np.zeros((count, 1), dtype=np.float32)
        self._returns = np.zeros(count)
        self._lengths = np.zeros(count, dtype=np.int64)
        self._parts = np.zeros(len(REWARD_PARTS))
        self._periods = 0
        self._stagger = stagger
        self._prices = prices if prices is not None else Prices()
        self.told_critic = told_critic
        self._privileged = Privileged(self.env.config) if told_critic else None
        observed: spaces.Space[Any] = self.env.single_observation_space
        if features is not None:
            told = self._privileged.size if self._privileged is not None else 0
            observed = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (features.size + told,), np.float32)
        super().__init__(count, observed, self.env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Begin an episode on every axis; returns the policy's inputs (N, size)."""
        seed = self._first_seed
        seeds = None if seed is None else [seed + axis % self.num_envs for axis in range(self._total)]
        observation, _ = self.env.reset(seed=seeds, options=self._next_options)
        self._first_seed = None
        if self._stagger:
            state = self.env.get_state()
            shares = np.arange(self._total) % self.num_envs
            state.arrays["record"]["step"] = shares * self.env.config.steps // self.num_envs
            self.env.set_state(state)
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._state = self._twins = None
        return self._inputs(observation, None)

    def _inputs(self, observation: NDArray[np.float32], restarted: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        """Process the observations of all axes and twins; returns the policy's inputs (N, size)."""
        if self._paired:
            assert self.features is not None
            assert self.features.base is not None
            twins = observation[self.num_envs :]
            self._twin_commands, self._twins = self.features.base.predict(twins, self._twins, restarted)
        if self.features is None:
            return observation
        inputs, self._state = self.features(observation[: self.num_envs], self._state, restarted)
        return self._with_privileged(inputs, slice(self.num_envs))

    def _with_privileged(self, inputs: NDArray[np.float32], axes: slice | NDArray[np.int64]) -> NDArray[np.float32]:
        """The policy's inputs of some axes, within their limits, with the hidden quantities for the critic."""
        if self._privileged is not None:
            inputs = np.concatenate([inputs, self._privileged(self.env.axes, axes)], axis=1)
        return np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)

    def step_async(self, actions: Array) -> None:
        """Store the policy's outputs (N, 1) for ``step_wait``."""
        self._actions = np.asarray(actions, dtype=np.float32)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all axes by one control period."""
        count = self.num_envs
        command = self._actions
        if self.features is not None:
            assert self._state is not None
            command = self.features.command(command, self._state)
        if self._paired:
            command = np.concatenate([command, self._twin_commands])
        axes = self.env.axes
        change = axes.column("change").copy()
        observation, rewards, terminated, truncated, _ = self.env.step(command)
        price = self._prices_of_commands(change, axes.column("change"))
        worth, costs = rewards - price, axes.column("costs")[:count].mean(axis=0)
        reward = rewards[:count]
        ended = terminated | truncated
        done = ended[:count]
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(count)]
        if self._paired:  # an axis and its twin restart together
            worth, price = (part[:count] - part[count:] for part in (worth, price))
            done = done | ended[count:]
        correction = self._prices_of_correction(axes.column("command")[:count])
        worth = worth - correction
        self._parts += [*-costs, -(price + correction).mean(), worth.mean()]
        self._periods += 1
        if done.any():
            self._fill_infos(infos, np.flatnonzero(done), observation, terminated)
            mask = np.concatenate([done, done]) if self._paired else done
            observation, _ = self.env.reset(options={"reset_mask": mask})
        inputs = self._inputs(observation, done)
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return inputs, (worth * self.reward_scale).astype(np.float32), done, infos

    def mean_rewards(self) -> dict[str, float]:
        """Mean of each part of the reward (REWARD_PARTS) per axis and control period since the last call."""
        means = self._parts / max(self._periods, 1)
        self._parts[:], self._periods = 0.0, 0
        return dict(zip(REWARD_PARTS, means.tolist(), strict=True))

    def _prices_of_commands(self, before: Array, change: Array) -> Array:
        """Cost of a period's change of each command, given the previous change."""
        prices = self._prices
        reversed_swing = np.where(change * before < 0.0, np.minimum(np.abs(change), np.abs(before)), 0.0)
        price: Array = prices.travel * np.abs(change) + prices.reversal * reversed_swing
        return price

    def _prices_of_correction(self, command: Array) -> Array:
        """Cost of each correction that led to ``command``."""
        prices, state = self._prices, self._state
        if state is None or not (prices.lasting or prices.change):
            return np.zeros(self.num_envs)
        assert self.features is not None
        correction = command[:, None].astype(np.float32) - state.base_command
        lasting, change = self.features.lasting_after(correction, state), correction - state.correction
        price: Array = (prices.lasting * lasting**2 + prices.change * change**2)[:, 0]
        return price

    def _fill_infos(
        self, infos: list[dict[str, Any]], ended: NDArray[np.int64], last: Array, terminated: NDArray[np.bool_]
    ) -> None:
        """Fill ``infos`` of the ended episodes; their last inputs combine their history with the last observation."""
        inputs = last[ended]
        if self.features is not None:
            assert self._state is not None
            inputs, _ = self.features(inputs, self._state.rows(ended), None)
            inputs = self._with_privileged(inputs, ended)
        for row, axis in enumerate(ended):
            infos[axis] = {
                "terminal_observation": inputs[row],
                "TimeLimit.truncated": not terminated[axis],
                "episode": {"r": float(self._returns[axis]), "l": int(self._lengths[axis]), "t": 0.0},
            }

    def get_state(self) -> dict[str, Array]:
        """Complete state as copies of named arrays, for :meth:`set_state`."""
        arrays = {f"{ENV}{name}": array for name, array in self.env.get_state().arrays.items()}
        arrays |= {"returns": self._returns.copy(), "lengths": self._lengths.copy()}
        if self._state is not None:
            arrays |= self._state.arrays() | {"slot": np.asarray(self._state.slot)}
        for name, memory in (("base", self._state.base if self._state is not None else None), ("twin", self._twins)):
            if memory is not None:
                arrays |= {f"{name}.{field}": value for field, value in memory._asdict().items()}
        return arrays | {"twin_command": self._twin_commands}

    def set_state(self, state: Mapping[str, Array]) -> None:
        """Restore a state of :meth:`get_state`, from this or another ``AxisVecEnv`` with the same arguments.

        Raises:
            ConfigurationError: the arrays describe no possible state of an axis.
        """
        arrays = {name.removeprefix(ENV): array for name, array in state.items() if name.startswith(ENV)}
        record, steps = arrays["record"], self.env.config.steps
        finite = all(np.isfinite(record[name]).all() for name in record.dtype.names or ())
        if not finite or not np.isin(record["step"], np.arange(steps + 1)).all():
            raise ConfigurationError("env.record: holds no possible state of an axis")
        self.env.set_state(AxesState(self.env.config, arrays))
        self._returns, self._lengths = state["returns"].copy(), state["lengths"].copy()
        self._twin_commands = state["twin_command"]

        def memory(name: str) -> Any:
            base = self.features.base if self.features is not None else None
            if base is None or f"{name}.{base.memory._fields[0]}" not in state:
                return None
            return base.memory(*(state[f"{name}.{field}"] for field in base.memory._fields))

        self._twins = memory("twin")
        if self.features is not None:
            slot = int(state["slot"])
            if not 0 <= slot < state["ring"].shape[1]:
                raise ConfigurationError(f"slot = {slot}: must be within 0 to {state['ring'].shape[1] - 1}")
            names = [name for name in FeatureState._fields if name not in ("base", "slot", "noise", "hidden")]
            stored: dict[str, Any] = {name: state[name] for name in names}
            self._state = FeatureState(base=memory("base"), slot=slot, **stored)

    def close(self) -> None:
        """Stop the worker threads."""
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next reset; axis i gets ``seed + i``."""
        self._first_seed = seed
        return [None if seed is None else seed + axis for axis in range(self.num_envs)]

    def set_options(self, options: Any = None) -> None:
        """Set the options of the next reset; see :meth:`hydro_env.ServoHydraulicVectorEnv.reset`."""
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
