"""Changes of an axis under a condition of a protocol: task, plant, sensors, or the whole rig."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, validate
from hydro_env.mistakes import did_you_mean
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS
from hydro_env.task.configuration import task_config
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK
from hydro_env.task.rig import merged
from hydro_env.task.sensors import CHANNELS

Factor = Annotated[float, Field(ge=0.0, le=100.0)]


class Surroundings(Group):
    """Changes of a task, of every plant and of the sensors."""

    task: dict[str, Any] = Field(default_factory=dict, description="changed fields of the task, as in YAML")
    parameters: dict[str, float | str] = Field(default_factory=dict, description="of every plant, SI units, by path")
    factors: dict[str, Factor] = Field(default_factory=dict, description="parameters relative to the nominal rig's")
    noise_factor: Factor = Field(1.0, description="on the noise of every sensor")
    bias_factor: Factor = Field(1.0, description="on the largest bias of every sensor")
    rig: str | None = Field(None, description="another rig: a name in configs/rigs, or a path")

    @model_validator(mode="after")
    def _paths_exist(self) -> Surroundings:
        for name in ("parameters", "factors"):
            for path in getattr(self, name):
                if path not in PARAMETER_PATHS or path in LEAKAGE_OF_THE_TASK:
                    guess = did_you_mean(path, PARAMETER_PATHS)
                    raise ValueError(f"{name}: '{path}' is not a parameter that a condition may set{guess}")
                if name == "factors" and path in MODEL_CODES:
                    raise ValueError(f"factors: '{path}' is a name, not a number")
                if name == "factors" and path in self.parameters:
                    raise ValueError(f"factors: '{path}' is also in parameters")
        return self

    def task_on(self, base: TaskConfig, where: str) -> TaskConfig:
        """A task with these changes.

        Args:
            base: the task.
            where: for messages, such as ``conditions.<name>``.

        Raises:
            ConfigurationError: the changed task is impossible.
        """
        try:
            task = task_config(base, rig=self.rig, **self.task)
        except ConfigurationError as error:
            raise ConfigurationError(f"{where}: {error}") from None
        sensors = {
            channel: {
                "noise": self.noise_factor * getattr(task.sensors, channel).noise,
                "bias": self.bias_factor * getattr(task.sensors, channel).bias,
            }
            for channel in CHANNELS
        }
        return validate(TaskConfig, merged(task.model_dump(), {"sensors": sensors}), f"{where}: task")

    def parameters_on(self, task: TaskConfig) -> dict[str, dict[str, float | str]]:
        """Fixed parameters of every plant of a task, for the option ``parameters`` of ``reset``."""
        fixed: dict[str, float | str] = dict(self.parameters)
        for path, factor in self.factors.items():
            group, field = path.split(".")
            fixed[path] = factor * float(getattr(getattr(task.plant, group), field))
        groups: dict[str, dict[str, float | str]] = {}
        for path, value in fixed.items():
            group, field = path.split(".")
            groups.setdefault(group, {})[field] = value
        return groups
