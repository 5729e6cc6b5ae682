"""A proportional controller about the command that holds the start, and a task without noise and friction."""

from typing import Any

import numpy as np

from hydro_agents.controllers.base import ObservationLayout
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config


class Proportional:
    """Command = holding command + gain (1/m) times the error of the reading."""

    def __init__(self, gain: float, config: TaskConfig) -> None:
        self.gain, self.layout = gain, ObservationLayout.of(config)

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, *_: Any) -> Any:
        holding = self.layout.si(observation, "previous_command") if state is None else state
        command = holding + self.gain * self.layout.si(observation, "tracking_error")
        return command[:, None].astype(np.float32), holding


class Constant:
    """Commands one number, or fails where it is none; counts in its memory the periods since its start."""

    def __init__(self, command: float | None = 0.0) -> None:
        self.command = command

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, *_: Any) -> Any:
        if self.command is None:
            raise RuntimeError("broken")
        count = np.zeros(len(observation)) if state is None else np.where(episode_start, 0.0, state + 1.0)
        return np.full((len(observation), 1), self.command, np.float32), count


class Relay:
    """Command of one size, towards the reference."""

    def __init__(self, size: float, config: TaskConfig) -> None:
        self.size, self.layout = size, ObservationLayout.of(config)

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, *_: Any) -> Any:
        return (self.size * np.sign(self.layout.si(observation, "tracking_error")))[:, None], None


def exact_task(**changes: Any) -> TaskConfig:
    """The paper's rig as it is, without dry friction, with exact sensors."""
    exact = {"randomisation": {}, "sensors": {"enabled": False}, "plant": {"friction": {"model": "none"}}}
    return task_config(None, **exact | changes)
