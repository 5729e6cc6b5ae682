"""The spec of an environment as plain data, which can be written as JSON and used on another machine."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from pydantic import BaseModel

from hydro_env.task.configuration import TaskConfig
from hydro_env.task.drawn_rigs import rig_tasks

NAMED = ("config", "task", "rig", "plant")
"""Keywords with possible file names."""


class PlainSpec:
    """Gives an environment its ``spec``; comes before Gymnasium's class among the bases."""

    config: TaskConfig
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The spec with which ``gym.make`` or ``gym.make_vec`` made this environment.

        ``to_json`` always works: the spec holds the content of a YAML file, not its path. ``max_episode_steps`` is the
        length of an episode; the environment itself truncates there.
        """
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        if value is not None:
            kwargs = _plain(value.kwargs)
            if any(isinstance(kwargs.get(name), str) for name in NAMED):
                kwargs = {key: inner for key, inner in kwargs.items() if key not in NAMED}
                kwargs["config"] = _plain(self.config)
            value = dataclasses.replace(value, kwargs=kwargs, max_episode_steps=self._longest())
        self._spec = value

    def _longest(self) -> int:
        """Control periods in the longest episode."""
        return max(task.steps for task in rig_tasks(self.config))


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Enum):
        return value.value
    return str(value) if isinstance(value, Path) else value
