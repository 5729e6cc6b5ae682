"""What the environments of one axis and of many share: their arrays, and a spec of plain data."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from pydantic_core import to_jsonable_python

from hydro_env.arguments import shown
from hydro_env.axes import Axes
from hydro_env.errors import ConfigurationError, NotBegunError
from hydro_env.task.configuration import TaskConfig

Given = TaskConfig | Mapping[str, Any] | str | Path | None
"""A task as the environments take it: an object, a mapping, the name of a file or its path."""

NAMED = ("config", "task", "rig", "plant")
"""Keywords with possible file names."""


class AxisEnvironment:
    """Base of both environments; comes before Gymnasium's class, whose ``spec`` it replaces."""

    config: TaskConfig
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
        self._seeded = False
        self._begun = False

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
        if value is not None:
            kwargs = to_jsonable_python(value.kwargs, fallback=lambda array: array.tolist())
            if any(isinstance(kwargs.get(name), str) for name in NAMED):
                kwargs = {key: inner for key, inner in kwargs.items() if key not in NAMED}
                kwargs["config"] = self.config.model_dump(mode="json")
            longest = max(task.steps for task in self.rigs)
            value = dataclasses.replace(value, kwargs=kwargs, max_episode_steps=longest)
        self._spec = value
