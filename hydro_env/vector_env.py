"""The Gymnasium vector environment: N axes in one compiled step, bit-identical to N single environments."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from hydro_env.arguments import numbers, shown, whole_number
from hydro_env.axes import AxesState
from hydro_env.common import AxisEnvironment, Info
from hydro_env.errors import ConfigurationError
from hydro_env.reset_options import options_given
from hydro_env.task.configuration import Given, task_config
from hydro_env.task.record import FAILURES, NO_FAILURE
from hydro_env.task.reference_signals import REFERENCE_FAMILIES
from hydro_env.task.rewards import REWARD_TERMS
from hydro_env.types import Array, ByName, Floats, Indices, Mask, Singles
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

MOST_AXES = 1_000_000
MOST_THREADS = 1024


class ServoHydraulicVectorEnv(AxisEnvironment, VectorEnv[Singles, Singles, Array]):
    """N independent axes of :class:`~hydro_env.env.ServoHydraulicEnv`, which describes spaces, rewards and options.

    ``gym.make_vec("ServoHydraulic-v0", num_envs=N)`` makes it. With the same seed an axis gives the same numbers as
    the single environment, bit for bit. Options of ``reset`` may differ per axis: give an array of N numbers (or N
    references, or N names) instead of one.

    Args:
        num_envs: number of axes N.
        config: task, as for the single environment; its fields are also keywords.
        autoreset_mode: ``NEXT_STEP`` (default), ``SAME_STEP`` or ``DISABLED`` (then ``options["reset_mask"]``).
        max_episode_steps: truncate after so many steps instead of after ``episode_duration``.
        threads: worker threads of a step; ``None`` takes one per core, but no more than the number of axes needs.
        render_mode: must be ``None``; draw a single environment.
        info: ``False`` leaves ``info`` empty, for training loops that do not read it; ``"flat"`` holds only arrays of
            numbers, without text and dictionaries, for array libraries (final observations and infos too).

    Example:
        >>> import gymnasium as gym
        >>> import hydro_env
        >>> env = gym.make_vec("ServoHydraulic-v0", num_envs=3)
        >>> observation, _ = env.reset(seed=0, options={"leakage_flow_lpm": [0.01, 1.0, 4.0]})
        >>> observation, reward, terminated, truncated, info = env.step([[0.1]] * 3)
        >>> observation.shape, info["leakage_class"].tolist()
        ((3, 13), [0, 2, 3])
    """

    metadata: ByName = {"render_modes": [], "render_fps": 50, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        config: Given = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
        info: bool | str = True,
        **overrides: Any,
    ) -> None:
        self.num_envs = whole_number("num_envs", num_envs, 1, MOST_AXES)
        threads = None if threads is None else whole_number("threads", threads, 1, MOST_THREADS)
        if render_mode is not None:
            raise ConfigurationError(f"render_mode = {shown(render_mode)}: the vector environment does not draw")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        task = task_config(config, **overrides)
        if max_episode_steps is not None and task.law:
            raise ConfigurationError("max_episode_steps: drawn rigs differ in their periods; give episode_duration")
        if max_episode_steps is not None and max_episode_steps != task.steps:
            steps = whole_number("max_episode_steps", max_episode_steps, 1)
            task = task_config(task, episode_duration=steps * task.control_period)
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self._set_up(task, self.num_envs, threads, info)
        self.single_observation_space = self._axes.observation_space
        self.single_action_space = self._axes.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._everyone = np.arange(self.num_envs)
        self._present = np.ones(self.num_envs, bool)
        self._present.flags.writeable = False
        self._ended = np.zeros(self.num_envs, bool)

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: Any = None) -> tuple[Singles, Info]:
        """Begin an episode on every axis, or on those of ``options["reset_mask"]``.

        Args:
            seed: axis i gets ``seed + i``; or one seed (or ``None``) per axis.
            options: as for the single environment, values per axis or for all; or a list of options, one per axis.

        Raises:
            ConfigurationError: an option is unknown or impossible.
        """
        axes = self._everyone
        if not isinstance(options, list):
            options = options_given(options)
            axes = self._chosen(options.pop("reset_mask", None))
        if not self._begun and len(axes) < self.num_envs:
            raise ConfigurationError("reset options: reset_mask: the first reset must begin every axis")
        self._axes.options.set(options, axes)
        self._seed(seed, axes)
        self._begin(axes)
        self._ended[axes] = False
        return self._axes.observation.copy(), self._info(axes)

    def _chosen(self, mask: Any) -> Indices:
        if mask is None:
            return self._everyone
        try:
            chosen = np.asarray(mask)
        except ValueError:  # ragged
            chosen = np.empty(0)
        if chosen.dtype != np.bool_ or chosen.shape != (self.num_envs,) or not chosen.any():
            raise ConfigurationError(
                f"reset options: reset_mask must be a boolean array of shape ({self.num_envs},) with at least one True"
            )
        return np.flatnonzero(chosen)

    def _seed(self, seed: int | Sequence[int | None] | None, axes: Indices) -> None:
        if isinstance(seed, list | tuple | np.ndarray) and np.shape(np.asarray(seed, object))[:1]:
            if len(seed) != self.num_envs:
                raise ConfigurationError(f"seed: {len(seed)} seeds for {self.num_envs} axes")
            seeds = [None if value is None else whole_number("seed", value, 0) for value in seed]
            if not self._seeded:
                seeds = [int(self.np_random.integers(0, 2**62)) if value is None else value for value in seeds]
        elif seed is not None:
            first = whole_number("seed", seed, 0)
            self._np_random, self._np_random_seed = seeding.np_random(first)
            seeds = [first + axis for axis in range(self.num_envs)]
        elif not self._seeded:
            seeds = self.np_random.integers(0, 2**62, self.num_envs).tolist()
        else:
            return
        self._seeded = True
        for axis in axes:
            value = seeds[axis]
            if value is not None:
                self._axes.seed(axis, seeding.np_random(value)[0])

    def step(self, actions: Singles) -> tuple[Singles, Floats, Mask, Mask, Info]:
        """Advance every axis by one control period.

        Args:
            actions: (N, 1), commands in [−1, 1].

        Returns:
            Singles (N, n), rewards (N,), terminated (N,), truncated (N,), info; new arrays at each call.

        Raises:
            ConfigurationError: an action is NaN or infinite, the shape is wrong, or ``reset`` was not called.
        """
        commands = numbers(actions)
        if commands is None or commands.shape != (self.num_envs, 1):
            given = "no numbers" if commands is None else f"shape {commands.shape}"
            raise ConfigurationError(f"actions: {given}: must be numbers within -1 to 1, of shape ({self.num_envs}, 1)")
        if not np.isfinite(commands).all():
            axis = np.argmin(np.isfinite(commands[:, 0]))
            raise ConfigurationError(f"actions[{axis}] = {commands[axis, 0]}: must be a finite number within -1 to 1")
        self._require_begun("step")
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            raise ConfigurationError(
                f"step: axis {int(np.argmax(self._ended))} has ended; with autoreset_mode Disabled reset it first "
                "(options={'reset_mask': ...})"
            )
        self._axes.step(commands[:, 0])
        record = self._axes.record
        reward = record["reward"].copy()
        terminated = record["failure"] != NO_FAILURE
        truncated = record["step"] >= self._axes.steps()

        final = {}
        if self.autoreset_mode == AutoresetMode.NEXT_STEP and self._ended.any():
            restarting = np.flatnonzero(self._ended)
            self._begin(restarting)
            reward[restarting] = 0.0
            terminated[restarting] = False
            truncated[restarting] = False
        self._ended = terminated | truncated
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._ended.any():
            final = self._finish()
        return self._axes.observation.copy(), reward, terminated, truncated, self._info(self._everyone) | final

    def _finish(self) -> Info:
        """Restart the axes that ended in this step; returns their last observation and info."""
        mask, ended = self._ended, np.flatnonzero(self._ended)
        last: Array
        if self._info_kind == "flat":
            last = np.where(mask[:, None], self._axes.observation, np.float32(0.0))
            final = {f"final_{name}": values for name, values in self._info(ended).items() if name[0] != "_"}
        else:
            last = np.full(self.num_envs, None, object)
            for axis in ended:
                last[axis] = self._axes.observation[axis].copy()
            final = {"final_info": self._info(ended), "_final_info": mask.copy()}
        self._begin(ended)
        self._ended = np.zeros(self.num_envs, bool)
        return {"final_obs": last, "_final_obs": mask.copy(), **final}

    def set_state(self, state: AxesState) -> None:
        """Continue from a state of :meth:`get_state`, bit for bit; one of the single environment is set on all axes.

        Raises:
            ConfigurationError: ``state`` is not a state, belongs to another task, or has another number of axes.
        """
        super().set_state(state)
        self._ended = self._axes.ended()

    def _info(self, axes: Indices) -> Info:
        """Arrays over all axes, each with a mask of the axes to which it applies; zero elsewhere, as in Gymnasium."""
        if self._info_kind is False:
            return {}
        present = self._present
        if len(axes) < self.num_envs:
            present = np.zeros(self.num_envs, bool)
            present[axes] = True

        def column(name: str) -> Array:
            values = self._axes.record[name].copy()
            if present is not self._present:
                values[~present] = 0.0
            return values

        flow, position, reference = column("leak_flow"), column("position"), column("reference")
        resistance = np.zeros(self.num_envs)
        with np.errstate(divide="ignore"):  # a leak of zero has an infinite resistance
            np.divide(LEAKAGE_TEST_PRESSURE, flow * LITRE_PER_MINUTE, out=resistance, where=present)
        family, failure = column("reference_family").astype(np.int64), column("failure").astype(np.int64)
        costs = column("costs")
        terms = {name: -costs[:, index] for index, name in enumerate(REWARD_TERMS)}
        values: Info = {
            "leakage_resistance": resistance,
            "leakage_flow_lpm": flow,
            "leakage_class": column("leak_class").astype(np.int64),
            "position": position,
            "velocity": column("velocity"),
            "reference": reference,
            "tracking_error": reference - position,
            "reference_family": family,
            "failure": failure,
        }
        if self.config.law:
            values["rig"] = column("rig").astype(np.int64)
        if self._axes.has_tip:
            values["tip_position"] = np.where(present, self._axes.tip_position(), 0.0)
        if self._info_kind == "flat":
            values |= {f"reward_{name}": costs for name, costs in terms.items()}
            faults = self._axes.drawn_faults()
            values |= {f"fault_{name}": np.where(present, size, 0.0) for name, size in faults.items()}
        else:
            values["reference_family"] = _names_of(family, REFERENCE_FAMILIES, present)
            values["failure"] = _names_of(failure, FAILURES, present)
            values["reward_terms"] = terms | {f"_{name}": present for name in terms}
            values["faults"] = _present_values(self._axes.faults(), present)
        return values | {f"_{name}": present for name in values}

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the worker threads."""
        axes = getattr(self, "_axes", None)  # absent if the constructor raised an error
        if axes:
            axes.close()


def _names_of(codes: Indices, known: Sequence[str], present: Mask) -> NDArray[np.object_]:
    """The name of each code; None if an axis is not present.

    Filled code by code: NumPy 2.0 to 2.2.2 crash when two threads repeat an array of objects.
    """
    names = np.empty(len(codes), object)
    for code in np.bincount(codes).nonzero()[0].tolist():
        names[(codes == code) & present] = known[code]
    return names


def _present_values(values: Mapping[str, Floats], present: Mask) -> Info:
    """Each array where an axis is present and its value is not 0, and a mask of those axes; nothing without any."""
    found: Info = {}
    for name, array in values.items():
        exists = present & (array != 0.0)
        if exists.any():
            found |= {name: np.where(exists, array, 0.0), f"_{name}": exists}
    return found
