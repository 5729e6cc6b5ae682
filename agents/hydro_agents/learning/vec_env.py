"""The native vector environment as a ``VecEnv`` of stable-baselines3: axes of one rig, or of many rigs in one batch."""

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from hydro_agents.controllers.base import Controller, rows
from hydro_agents.learning.any_axis import AnyAxisFeatures
from hydro_agents.learning.features import FEATURE_LIMIT, FeatureState, PolicyFeatures
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.axes import AxesState
from hydro_env.task.paces import periods_per_step
from hydro_env.types import Array, Floats, Indices, Mask, Singles


class _SharedVecEnv(VecEnv):
    """What :class:`AxisVecEnv` and :class:`RigsVecEnv` share: all axes have the same attributes, and no wrappers."""

    env: Any
    _actions: Singles

    def step_async(self, actions: Array) -> None:
        """Store the policy's outputs (N, 1) for ``step_wait``."""
        self._actions = np.asarray(actions, dtype=np.float32)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the adaptor, or of its environment; the same for every axis."""
        value = getattr(self, attr_name) if hasattr(self, attr_name) else getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the adaptor, for all axes together."""
        del indices
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector environment once; every axis gets the same answer."""
        value = getattr(self.env, method_name)(*args, **kwargs)
        return [value for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """No axis has a wrapper of its own."""
        del wrapper_class
        return [False for _ in self._get_indices(indices)]


class AxisVecEnv(_SharedVecEnv):
    """N axes in one compiled step, for any algorithm of stable-baselines3; several times faster than ``DummyVecEnv``.

    Observations and actions are those of the environment. With ``features`` the policy gets :class:`PolicyFeatures`
    instead; they also turn its outputs into commands.

    ``infos`` holds the entries of stable-baselines3 (``terminal_observation``, ``TimeLimit.truncated``, ``episode``)
    for axes whose episode has ended, and is empty for the others. Such an axis has already begun its next episode.

    With ``paired`` each axis has a twin with the same plant, reference and noise, driven by the corrected controller,
    or the teacher, alone; the reward is the difference to the twin's. Errors that no controller can avoid cancel out,
    and the policy gradient remains unbiased, because the twin does not depend on the policy's actions.

    Args:
        config: the task, as for the environments.
        count: number of axes N.
        features: map observations to policy inputs, and outputs to commands; ``None`` leaves both unchanged.
        seed: seed of axis 0; axis i gets seed + i.
        reward_scale: factor on rewards, which keeps values near 1.
        paired: reward relative to a twin under the corrected controller; needs features in the residual form.
        stagger: advance the clock of axis i by i/N of an episode at the first reset; the axes then restart at
            different times. The references jump at that moment; later episodes are whole.
        reversal_price: additional cost, per part of 10 V of the smaller swing at each reversal of the command.
        teacher: a controller whose commands on the axes' own states ``taught`` holds; paired alone.
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
        reversal_price: float = 0.0,
        teacher: Controller | None = None,
        **overrides: Any,
    ) -> None:
        self._leader: Any = teacher or (features and features.base)
        if paired and self._leader is None:
            raise ConfigurationError("paired rewards need the residual form or a teacher: a controller to compare with")
        self.features, self.reward_scale, self._price = features, reward_scale, reversal_price
        self._paired, self.stagger = paired, stagger
        self._total = 2 * count if paired else count
        self.env = ServoHydraulicVectorEnv(self._total, config, autoreset_mode="Disabled", info=False, **overrides)
        self.render_mode = None
        self._state: FeatureState | None = None
        self._corrected: Any = None
        self._twin_commands = np.zeros((0, 1), dtype=np.float32)
        self.lessons: list[Singles] | None = None  # collects `taught` of each step, if a list
        self.taught = np.zeros((count, 1), dtype=np.float32)  # the teacher's commands for the last inputs
        self._returns = np.zeros(count)
        self._lengths = np.zeros(count, dtype=np.int64)
        observed = self.env.single_observation_space
        if features is not None:
            observed = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (features.size,), np.float32)
        super().__init__(count, observed, self.env.single_action_space)
        self.seed(seed)

    def reset(self) -> VecEnvObs:
        """Begin an episode on every axis; returns the policy's inputs (N, size)."""
        seeds = None
        options = None
        if self._seeds[0] is not None:
            seeds = self._seeds * (self._total // self.num_envs)
        if any(self._options):
            options = self._options * (self._total // self.num_envs)
        observation, _ = self.env.reset(seed=seeds, options=options)
        self._reset_seeds()
        self._reset_options()
        if self.stagger:
            state = self.env.get_state()
            shares = np.arange(self._total) % self.num_envs
            state.arrays["record"]["step"] = shares * self.env.axes.steps() // self.num_envs
            self.env.set_state(state)
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._state = self._corrected = None
        return self._inputs(observation, None)

    def _inputs(self, observation: Singles, restarted: Mask | None) -> Singles:
        """Process the observations of all axes and twins; returns the policy's inputs (N, size)."""
        if self.features is None:
            return observation
        own, answer = slice(self.num_envs), None
        if self._paired:  # one call for the axes and their twins
            both = None if restarted is None else np.tile(restarted, 2)
            commands, self._corrected = self._leader.predict(observation, self._corrected, both)
            self._twin_commands, self.taught = commands[self.num_envs :], commands[own]
            if self.features.base is not None:
                answer = self.taught, rows(self._corrected, own)
        inputs, self._state = self.features(observation[own], self._state, restarted, answer)
        return np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all axes by one control period."""
        count = self.num_envs
        command = self._actions
        if self.lessons is not None:
            self.lessons.append(self.taught)
        if self.features is not None and self._state is not None:
            command = self.features.command(command, self._state)
        if self._paired:
            command = np.concatenate([command, self._twin_commands])
        axes = self.env.axes
        before = axes.column("change").copy()
        observation, rewards, terminated, truncated, _ = self.env.step(command)
        worth = rewards - self._price * _smaller_swing(before, axes.column("change"))
        done = terminated | truncated
        if self._paired:
            worth = worth[:count] - worth[count:]
            done = done[:count] | done[count:]  # an axis and its twin restart together
        self._returns += rewards[:count]
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(count)]
        if done.any():
            self._fill_infos(infos, np.flatnonzero(done), observation, terminated)
            mask = np.concatenate([done, done]) if self._paired else done
            observation, _ = self.env.reset(options={"reset_mask": mask})
        inputs = self._inputs(observation, done)
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return inputs, (worth * self.reward_scale).astype(np.float32), done, infos

    def _fill_infos(self, infos: list[dict[str, Any]], ended: Indices, last: Array, terminated: Mask) -> None:
        """Fill ``infos`` of the ended episodes; their last inputs combine their history with the last observation."""
        inputs = last[ended]
        if self.features is not None:
            inputs, _ = self.features(inputs, rows(self._state, ended), None)
            inputs = np.clip(inputs, -FEATURE_LIMIT, FEATURE_LIMIT)
        for row, axis in enumerate(ended):
            infos[axis] = {
                "terminal_observation": inputs[row],
                "TimeLimit.truncated": not terminated[axis],
                "episode": {"r": float(self._returns[axis]), "l": int(self._lengths[axis]), "t": 0.0},
            }

    def get_state(self) -> dict[str, Any]:
        """Complete state, for :meth:`set_state`: nested mappings and tuples of arrays; no later step changes it."""
        return {
            "env": self.env.get_state().arrays,
            "returns": self._returns.copy(),
            "lengths": self._lengths.copy(),
            "twin_commands": self._twin_commands,
            "taught": self.taught,
            "corrected": self._corrected,
            "features": self._state,
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state of :meth:`get_state`, from this or another ``AxisVecEnv`` with the same arguments."""
        self.env.set_state(AxesState(self.env.config, state["env"]))
        self._returns, self._lengths = state["returns"].copy(), state["lengths"].copy()
        self._twin_commands, self.taught = state["twin_commands"], state["taught"]
        self._corrected = state["corrected"]
        self._state = state["features"]

    def close(self) -> None:
        """Stop the worker threads."""
        self.env.close()


def _smaller_swing(before: Array, change: Array) -> Array:
    """The smaller of two successive changes of each command where it reverses; else 0."""
    smaller = np.minimum(np.abs(change), np.abs(before))
    return np.where(change * before < 0.0, smaller, 0.0)


class RigsVecEnv(_SharedVecEnv):
    """The axes of several :class:`AxisVecEnv`, one per rig, in one batch; their inputs mean the same on every rig.

    Args:
        make: makes the axes of rig 0, 1, …, as many on each.
        count: number of rigs at the same time.
        features: those of the task that the weights' file names.
    """

    def __init__(self, make: Callable[[int], AxisVecEnv], count: int, features: AnyAxisFeatures) -> None:
        self.envs, self.features = [make(number) for number in range(count)], features
        self._make, self.first = make, 0  # number of the oldest rig
        self.lessons: list[Singles] | None = None  # as those of one rig
        self.render_mode = None
        axes = self.envs[0].num_envs
        self._parts = [slice(place * axes, (place + 1) * axes) for place in range(count)]
        super().__init__(count * axes, self.envs[0].observation_space, spaces.Box(-1.0, 1.0, (1,), np.float32))

    def renew(self, first: int) -> list[tuple[slice, VecEnvObs]]:
        """Replace the rigs before number ``first`` by the next ones; returns the places and inputs of the new axes."""
        renewed = []
        self.first = max(self.first, first - len(self.envs))  # a resumed training makes only the rigs that it needs
        while self.first < first:
            place = self.first % len(self.envs)
            self.envs[place].close()
            self.envs[place] = self._make(self.first + len(self.envs))
            self.envs[place].stagger = False  # a jump of the references again and again would drown what is learned
            renewed.append((self._parts[place], self.envs[place].reset()))
            self.first += 1
        return renewed

    def periods_per_step(self) -> Floats:
        """Control periods in a step of the rig, of each axis, (N,)."""
        return np.concatenate([np.full(env.num_envs, periods_per_step(env.env.config)) for env in self.envs])

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """The axes of each rig get their seeds in turn."""
        seeds = super().seed(seed)
        for env, part in zip(self.envs, self._parts, strict=True):
            env.seed(seeds[part.start])
        return seeds

    def reset(self) -> VecEnvObs:
        """Begin an episode on every axis."""
        return np.concatenate([env.reset() for env in self.envs])

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all axes by one control period of their rig."""
        if self.lessons is not None:
            self.lessons.append(np.concatenate([env.taught for env in self.envs]))
        results = [env.step(self._actions[part]) for env, part in zip(self.envs, self._parts, strict=True)]
        inputs, rewards, done, infos = zip(*results, strict=True)
        return np.concatenate(inputs), np.concatenate(rewards), np.concatenate(done), [*chain(*infos)]

    def get_state(self) -> dict[str, Any]:
        """Complete state, for :meth:`set_state`."""
        return {
            "first": np.array(self.first),
            **{f"rig{place}": env.get_state() for place, env in enumerate(self.envs)},
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state of :meth:`get_state` while the rigs are the same."""
        for place, env in enumerate(self.envs):
            env.set_state(state[f"rig{place}"])

    def close(self) -> None:
        """Stop the worker threads."""
        for env in self.envs:
            env.close()
