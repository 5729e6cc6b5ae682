"""The Gymnasium vector environment: N axes in one compiled step, the same numbers as N single environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from hydro_env.axes import Axes, failure_name
from hydro_env.env import REWARD_TERMS
from hydro_env.errors import ConfigurationError
from hydro_env.reset_options import options_given
from hydro_env.specification import PlainSpec
from hydro_env.task.configuration import REFERENCE_FAMILIES, TaskConfig, task_config
from hydro_env.task.record import Record
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

Observations = NDArray[np.float32]
Flags = NDArray[np.bool_]
_COLUMN = {name: index for index, name in enumerate(Record._fields)}
_NO_FAILURE = np.array([failure_name(0)], dtype=object)
_FAMILY_NAMES = np.array(REFERENCE_FAMILIES, dtype=object)


class ServoHydraulicVectorEnv(PlainSpec, VectorEnv[Observations, NDArray[np.float32], NDArray[Any]]):
    """N independent axes of :class:`~hydro_env.env.ServoHydraulicEnv`, which describes spaces, rewards and options.

    ``gym.make_vec("ServoHydraulic-v0", num_envs=N)`` makes it. Axis i with seed s + i gives the same numbers, bit for
    bit, as the single environment with that seed. Options of ``reset`` may be given per axis: an array of N numbers
    (or N references, or N names) where the single environment takes one.

    Args:
        num_envs: number of axes N.
        config: task, as for the single environment; its fields are also keywords.
        autoreset_mode: ``NEXT_STEP`` (default), ``SAME_STEP`` or ``DISABLED`` (then ``options["reset_mask"]``).
        max_episode_steps: truncate after so many steps instead of after ``episode_duration``.
        threads: worker threads of a step; ``None`` takes the cores where there are axes enough.
        render_mode: must be ``None``; draw a single environment.
        info: ``False`` leaves ``info`` empty, for training loops that do not read it.
    """

    metadata: dict[str, Any] = {
        "render_modes": [],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        config: TaskConfig | Mapping[str, Any] | str | Path | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
        info: bool = True,
        **overrides: Any,
    ) -> None:
        if num_envs < 1:
            raise ConfigurationError(f"num_envs = {num_envs}: must be at least 1")
        if threads is not None and not (type(threads) is int and threads >= 1):
            raise ConfigurationError(f"threads = {threads!r}: must be a whole number of at least 1, or None")
        if render_mode is not None:
            raise ConfigurationError(f"render_mode = {render_mode!r}: the vector environment does not draw")
        try:
            self._mode = AutoresetMode(autoreset_mode)
        except ValueError:
            known = ", ".join(mode.value for mode in AutoresetMode)
            raise ConfigurationError(f"autoreset_mode = {autoreset_mode!r}: must be one of {known}") from None
        self.config = task_config(config, **overrides)
        if max_episode_steps is not None:
            duration = max_episode_steps * self.config.control_period
            self.config = task_config(self.config, episode_duration=duration)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": self._mode}
        self._axes = Axes(self.config, num_envs, threads)
        self.single_observation_space = self._axes.observation_space
        self.single_action_space = self._axes.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_names = self._axes.observation_names
        self.observation_units = self._axes.observation_units
        self.observation_scale = self._axes.scale
        self._everyone = np.arange(num_envs, dtype=np.int64)
        self._present = np.ones(num_envs, dtype=np.bool_)
        self._present.flags.writeable = False
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._observation = np.zeros((num_envs, len(self.observation_names)), dtype=np.float32)
        self._seeded = False
        self._begun = False
        self._with_info = info

    @property
    def axes(self) -> Axes:
        """The arrays behind the environment (for the judge)."""
        return self._axes

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode on every axis, or on those of ``options["reset_mask"]``.

        Args:
            seed: axis i gets ``seed + i``; or one seed (or ``None``) per axis.
            options: as for the single environment, values per axis or for all.

        Raises:
            ConfigurationError: an option is unknown or impossible.
        """
        options = options_given(options)
        axes = self._chosen(options.pop("reset_mask", None))
        if not self._begun and len(axes) < self.num_envs:
            raise ConfigurationError("reset options: reset_mask: the first reset must begin every axis")
        self._axes.options.set(options, axes)
        self._seed(seed, axes)
        observation = self._observation.copy()
        self._begin(axes, observation)
        self._observation = observation
        self._ended[axes] = False
        return observation.copy(), self._info(axes)

    def _chosen(self, mask: Any) -> NDArray[np.int64]:
        if mask is None:
            return self._everyone
        mask = np.asarray(mask)
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise ConfigurationError(
                f"reset options: reset_mask must be a boolean array of shape ({self.num_envs},) with at least one True"
            )
        return np.flatnonzero(mask)

    def _begin(self, axes: NDArray[np.int64], observation: Observations) -> None:
        """Begin episodes; where a plant cannot begin, all axes need a reset before the next step."""
        self._begun = False
        self._axes.begin(axes, observation)
        self._begun = True

    def _seed(self, seed: int | Sequence[int | None] | None, axes: NDArray[np.int64]) -> None:
        if isinstance(seed, int | np.integer):
            self._np_random, self._np_random_seed = seeding.np_random(int(seed))
            seeds: list[int | None] = [int(seed) + axis for axis in range(self.num_envs)]
        elif seed is not None:
            seeds = list(seed)
            if len(seeds) != self.num_envs:
                raise ConfigurationError(f"seed: {len(seeds)} seeds for {self.num_envs} axes")
            if not self._seeded:
                seeds = [int(self.np_random.integers(0, 2**62)) if value is None else value for value in seeds]
        elif not self._seeded:
            seeds = [int(value) for value in self.np_random.integers(0, 2**62, self.num_envs)]
        else:
            return
        self._seeded = True
        for axis in axes:
            value = seeds[axis]
            if value is not None:
                self._axes.seed(int(axis), seeding.np_random(value)[0])

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observations, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Advance every axis by one control period.

        Args:
            actions: (N, 1), commands in [−1, 1].

        Returns:
            Observations (N, n), rewards (N,), terminated (N,), truncated (N,), info; fresh arrays each time.

        Raises:
            ConfigurationError: an action is NaN or infinite, the shape is wrong, or ``reset`` was not called.
        """
        try:
            commands = np.array(actions, dtype=np.float64)
        except (TypeError, ValueError):
            raise ConfigurationError("actions: must be numbers within -1 to 1") from None
        if commands.shape != (self.num_envs, 1):
            raise ConfigurationError(f"actions: shape {commands.shape}: must be ({self.num_envs}, 1)")
        if not np.isfinite(commands).all():
            axis = int(np.argmin(np.isfinite(commands[:, 0])))
            raise ConfigurationError(f"actions[{axis}] = {commands[axis, 0]}: must be a finite number within -1 to 1")
        if not self._begun:
            raise ConfigurationError("step: call reset first")
        if self._mode == AutoresetMode.DISABLED and self._ended.any():
            raise ConfigurationError(
                f"step: axis {int(np.argmax(self._ended))} has ended; with autoreset_mode Disabled reset it first "
                "(options={'reset_mask': ...})"
            )
        observation = np.empty_like(self._observation)
        reward = np.empty(self.num_envs)
        terminated = np.empty(self.num_envs, dtype=np.bool_)
        truncated = np.empty(self.num_envs, dtype=np.bool_)
        self._axes.step(commands[:, 0], observation, reward, terminated, truncated)

        final: dict[str, Any] = {}
        if self._mode == AutoresetMode.NEXT_STEP and self._ended.any():
            restarting = np.flatnonzero(self._ended)
            self._begin(restarting, observation)
            reward[restarting] = 0.0
            terminated[restarting] = False
            truncated[restarting] = False
        self._ended = terminated | truncated
        if self._mode == AutoresetMode.SAME_STEP and self._ended.any():
            final = self._finish(observation)
        self._observation = observation
        return observation.copy(), reward, terminated, truncated, self._info(self._everyone) | final

    def _finish(self, observation: Observations) -> dict[str, Any]:
        """Restart the axes that ended in this step; their last observation and info go into the info."""
        mask = self._ended
        ended = np.flatnonzero(mask)
        last = np.full(self.num_envs, None, dtype=object)
        for axis, row in zip(ended, observation[ended], strict=True):
            last[axis] = row
        final = {
            "final_obs": last,
            "_final_obs": mask.copy(),
            "final_info": self._info(ended),
            "_final_info": mask.copy(),
        }
        self._begin(ended, observation)
        self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        return final

    def _info(self, axes: NDArray[np.int64]) -> dict[str, Any]:
        """Arrays over all axes, each with a mask of the axes for which it holds; zero elsewhere, as Gymnasium does."""
        if not self._with_info:
            return {}
        everyone = len(axes) == self.num_envs
        present = self._present
        if not everyone:
            present = np.zeros(self.num_envs, dtype=np.bool_)
            present[axes] = True

        def column(row: int) -> NDArray[np.float64]:
            values = self._axes.record[:, row].copy()
            if not everyone:
                values[~present] = 0.0
            return values

        flow = column(_COLUMN["leak_flow"])
        resistance = np.zeros(self.num_envs)
        with np.errstate(divide="ignore"):  # no leak is an infinite resistance
            np.divide(LEAKAGE_TEST_PRESSURE, flow * LITRE_PER_MINUTE, out=resistance, where=present)
        family = _FAMILY_NAMES[column(_COLUMN["reference_family"]).astype(np.int64)]
        failure = _failure_names(column(_COLUMN["failure"]))
        if not everyone:
            family[~present] = None
            failure[~present] = None
        cost = _COLUMN["cost_tracking"]
        terms: dict[str, Any] = {}
        for index, name in enumerate(REWARD_TERMS):
            terms[name] = -column(cost + index)
            terms[f"_{name}"] = present
        position, reference = column(_COLUMN["position"]), column(_COLUMN["reference"])
        values: dict[str, Any] = {
            "leakage_resistance": resistance,
            "leakage_flow_lpm": flow,
            "leakage_class": self._axes.leakage_class(flow),
            "position": position,
            "velocity": column(_COLUMN["velocity"]),
            "reference": reference,
            "tracking_error": reference - position,
            "reference_family": family,
            "failure": failure,
            "reward_terms": terms,
        }
        masks = {f"_{name}": present for name in values}
        return values | masks

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the worker threads."""
        del kwargs
        axes = getattr(self, "_axes", None)  # absent where the constructor refused its arguments
        if axes is not None:
            axes.close()


def _failure_names(codes: NDArray[np.float64]) -> NDArray[np.object_]:
    failed = np.flatnonzero(codes)
    names: NDArray[np.object_] = np.repeat(_NO_FAILURE, len(codes))
    for axis in failed:
        names[axis] = failure_name(codes[axis])
    return names
