"""What the environments of one axis and of many share: their arrays, and a spec of plain data."""

import dataclasses
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from pydantic_core import to_jsonable_python

from hydro_env.arguments import shown
from hydro_env.axes import Axes, AxesState
from hydro_env.errors import ConfigurationError, NotBegunError
from hydro_env.task.configuration import TaskConfig
from hydro_env.types import Indices

Info = dict[str, Any]  # what the controller must not know, for evaluation
NAMED = ("config", "task", "rig", "plant")  # keywords with possible file names


class AxisEnvironment:
    """Base of both environments; comes before Gymnasium's class, whose ``spec`` it replaces."""

    config: TaskConfig
    np_random: np.random.Generator  # of Gymnasium's class
    _spec: EnvSpec | None = None

    def _set_up(self, config: TaskConfig, count: int, threads: int | None, info: Any) -> None:
        """Make the arrays of ``count`` axes, and the attributes that follow from the task.

        Raises:
            ConfigurationError: the task is impossible, or ``info`` is none of True, False and ``"flat"``.
        """
        if not isinstance(info, bool | np.bool_) and not (isinstance(info, str) and info == "flat"):
            raise ConfigurationError(f"info = {shown(info)}: must be True, False or 'flat'")
        self._info_kind = info if isinstance(info, str) else bool(info)
        self.config = config
        self._axes = Axes(config, count, threads)
        self.observation_names = self._axes.observation_names
        self.observation_units = self._axes.observation_units
        self.observation_scale = self._axes.scale
        self._history: list[tuple[float, float]] = []  # position and reference, for drawing
        self._seeded = False
        self._begun = False

    def get_state(self) -> AxesState:
        """Complete state of the environment: plant, clock, sensors, references, options, random numbers.

        It can be pickled, and set any number of times: on this environment, on another one of the same task, or from
        one axis on all axes of the vector environment.

        Raises:
            ConfigurationError: ``reset`` was not called.
        """
        self._require_begun("get_state")
        generator = deepcopy(self.np_random.bit_generator.state)
        return AxesState(self.config, self._axes.get_state(), generator, tuple(self._history))

    def set_state(self, state: AxesState) -> None:
        """Continue from a state; the generator is that of the state if it has as many axes as this environment."""
        if not isinstance(state, AxesState):
            raise ConfigurationError("set_state: must be a state from get_state")
        if state.config != self.config:
            raise ConfigurationError("set_state: this is the state of another task")
        if state.count not in (1, self._axes.count):
            raise ConfigurationError(f"set_state: the state of {state.count} axes for {self._axes.count}")
        self._axes.set_state(state.arrays)
        if state.generator and state.count == self._axes.count:
            self.np_random.bit_generator.state = deepcopy(state.generator)
        self._history = list(state.history)
        self._seeded = self._begun = True

    def _begin(self, axes: Indices) -> None:
        """Begin episodes; if one of them cannot begin, all axes need a reset before the next step."""
        self._begun = False
        self._axes.begin(axes)
        self._begun = True

    def _require_begun(self, what: str) -> None:
        if not self._begun:
            raise NotBegunError(f"{what}: call reset first")

    @property
    def rigs(self) -> tuple[TaskConfig, ...]:
        """The task on each of its rigs, by the number ``info["rig"]``; one unless the task has a law."""
        return self._axes.tasks

    @property
    def axes(self) -> Axes:
        """The arrays behind the environment (hidden from the controller)."""
        return self._axes

    @property
    def spec(self) -> EnvSpec | None:
        """The spec with which ``gym.make`` or ``gym.make_vec`` made this environment.

        ``to_json`` always works: the spec holds the content of a YAML file, not its path. ``max_episode_steps`` is the
        length of the longest episode; the environment itself truncates there.
        """
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        if value:
            kwargs = to_jsonable_python(value.kwargs, fallback=lambda array: array.tolist())
            if any(isinstance(kwargs.get(name), str) for name in NAMED):
                kwargs = {key: inner for key, inner in kwargs.items() if key not in NAMED}
                kwargs["config"] = self.config.model_dump(mode="json")
            value = dataclasses.replace(value, kwargs=kwargs, max_episode_steps=max(task.steps for task in self.rigs))
        self._spec = value
