"""Tasks: from parts of YAML files, under a condition of a protocol, and with what experiments hold constant."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator

from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.errors import at
from hydro_env.files import Group, validate, whole_group
from hydro_env.mistakes import did_you_mean, refuse_unknown
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS, grouped
from hydro_env.task.faults import FAULT_KINDS, FAULTS
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK, own_value
from hydro_env.task.rig import merged, task_from
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import ByName, Floats
from hydro_env.units import Number


def between(low: float, high: float, unit: str = "") -> AfterValidator:
    """For the type of a number in a list or mapping, whose bounds pydantic's ``Field`` would not tell."""

    def checked(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"must be within {low:g} to {high:g}{unit}")
        return value

    return AfterValidator(checked)


Factor = Annotated[Number, between(0.0, 100.0)]


def steady(config: TaskConfig) -> TaskConfig:
    """The task with leak, faults and external force constant during an episode."""
    return task_config(
        config,
        disturbance={"kind": "none"},
        leakage={"schedule": "constant"},
        faults={kind: {"schedule": "constant"} for kind in FAULT_KINDS},
    )


def own_reference(config: TaskConfig, reference: Floats) -> TaskConfig:
    """The :func:`steady` task with a given reference (T + 1,), m, one value per period from the start."""
    return task_config(
        steady(config),
        episode_duration=(len(reference) - 1) * config.control_period,
        references={"user": reference.tolist(), "weights": {"user": 1.0}},
    )


def noiseless(config: TaskConfig) -> TaskConfig:
    """The task without sensor noise; the sensors keep their bias and 16-bit steps."""
    return task_config(config, sensors={channel: {"noise": 0.0} for channel in CHANNELS})


def timed_task(
    task: TaskConfig | str | Path | None, rig: str | Path | None, period: str | None, latency: str | None, command: str
) -> TaskConfig:
    """A task on a rig with another control period and latency, each given with its unit.

    Raises:
        ConfigurationError: task or rig is wrong, or period or latency is impossible; the message names the option.
    """
    timing = {"control_period": period, "command_latency": latency}
    given: ByName = {name: text for name, text in timing.items() if text is not None}
    if not given:
        return task_config(task, rig=rig)
    try:
        return task_config(task, rig=rig, **given)
    except ConfigurationError as error:
        fault = str(error).replace("control_period", "--period").replace("command_latency", "--latency")
        raise ConfigurationError(fault.replace("task: --", f"{command}: --")) from None


class Surroundings(Group):
    """Changes of an axis under a condition of a protocol: task, plants and sensors, or another rig."""

    task: ByName = {}  # changed fields of the task, as in YAML
    parameters: dict[str, Number | str] = {}  # of every plant, SI units, by path
    factors: dict[str, Factor] = {}  # parameters relative to the nominal rig's
    noise_factor: Factor = 1.0  # on the noise of every sensor
    bias_factor: Factor = 1.0  # on the largest bias of every sensor
    rig: str | None = None  # another rig: a name in configs/rigs, or a path

    @whole_group
    def _paths_exist(self) -> "Surroundings":
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
        """A task with these changes; messages begin with ``where``, such as ``conditions.<name>``.

        Raises:
            ConfigurationError: the changed task is impossible.
        """
        with at(where):
            task = task_config(base, rig=self.rig, **self.task)
        sensors = {
            channel: {
                "noise": self.noise_factor * getattr(task.sensors, channel).noise,
                "bias": self.bias_factor * getattr(task.sensors, channel).bias,
            }
            for channel in CHANNELS
        }
        return validate(TaskConfig, merged(task.model_dump(), {"sensors": sensors}), f"{where}: task")

    def parameters_on(self, task: TaskConfig) -> dict[str, ByName]:
        """Fixed parameters of every plant of a task, for the option ``parameters`` of ``reset``."""
        relative = {path: factor * own_value(task.plant, path) for path, factor in self.factors.items()}
        return grouped(self.parameters | relative)


def read_task(given: Any, file: Path) -> Any:
    """The task of a YAML file: a name in ``configs/tasks``, a path, or a group whose ``plant`` names a rig.

    Paths are relative to the file. Anything else is returned unchanged.

    Raises:
        ConfigurationError: the task or rig does not exist, the file is unreadable, a key is unknown, or a value is
            impossible.
    """
    if isinstance(given, str):
        return task_config(given, folder=file.parent)
    if isinstance(given, dict) and isinstance(given.get("plant"), str):
        return task_from(TaskConfig, given, str(file), file.parent, within="task")
    return given


def mappings(values: Any) -> dict[str, ByName]:
    """The entries of a part of a YAML file that are mappings themselves, by name; the others are refused later."""
    entries = values.items() if isinstance(values, dict) else ()
    return {name: entry for name, entry in entries if isinstance(entry, dict)}


def named_faults(texts: Sequence[str]) -> dict[str, float]:
    """The values of ``--fault NAME=VALUE``, by name.

    Raises:
        ConfigurationError: a value has the wrong form, or a name is unknown or given twice.
    """
    faults = {}
    for text in texts:
        name, _, value = text.partition("=")
        refuse_unknown(f"--fault {text}", (name,), FAULTS, "fault")
        if name in faults:
            raise ConfigurationError(f"--fault {text}: '{name}' is given twice")
        try:
            faults[name] = float(value)
        except ValueError:
            raise ConfigurationError(f"--fault {text}: must be NAME=VALUE, such as {name}=0.01") from None
    return faults
