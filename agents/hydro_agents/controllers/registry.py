"""Controllers by kind, ``kind: pid`` or ``kind: "my_module:MyController"`` for your own, and files of tuned gains.

A file of gains holds each with its unit, and as an engineer enters it in a PLC.
"""

import inspect
import math
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.by_name import imported
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.pid import PID, PIDGains
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.errors import at, reason
from hydro_env.files import Group, read_yaml, validate
from hydro_env.mistakes import unknown
from hydro_env.types import ByName
from hydro_env.units import FULL_VOLTAGE

CONTROLLERS: dict[str, tuple[type[ClassicalController], type[Group]]] = {
    "pid": (PID, PIDGains),
    "flow_linearising": (FlowLinearising, FlowLinearisingGains),
}
"""Each classical controller by kind: its class, and the class of its gains."""

GAINS_FILE = "gains.yaml"

MILLIMETRE = 1e-3

PRACTICE = {
    "1/m": (FULL_VOLTAGE * MILLIMETRE, "V/mm"),
    "1/(m s)": (FULL_VOLTAGE * MILLIMETRE, "V/(mm s)"),
    "s/m": (FULL_VOLTAGE, "V/(m/s)"),
    "s": (1e3, "ms"),
}
"""Factor and unit in which a PLC takes a gain, by its own unit; a command of 1 is 10 V."""


def kind_of(controller: ClassicalController) -> str:
    """The kind under which a classical controller is registered.

    Raises:
        ConfigurationError: its class is not registered.
    """
    kinds = {registered: kind for kind, (registered, _) in CONTROLLERS.items()}
    if type(controller) not in kinds:
        raise ConfigurationError(f"{type(controller).__name__}: must be one of CONTROLLERS ({', '.join(CONTROLLERS)})")
    return kinds[type(controller)]


def make_controller(kind: str, config: TaskConfig, settings: ByName | None = None) -> Controller:
    """A controller for a task.

    Args:
        kind: a key of :data:`CONTROLLERS`, or ``"module:attribute"``. The attribute is a controller, or a class or
            function that makes one: ``attribute(config, **settings)``, or ``attribute()`` if it takes no argument.
        config: the task, which defines the layout of the observations and the control period.
        settings: settings of the controller.

    Raises:
        ConfigurationError: the kind is unknown, or the settings do not fit it.

    Example:
        >>> from hydro_agents.controllers.registry import make_controller
        >>> from hydro_env import TaskConfig
        >>> make_controller("pid", TaskConfig(), {"proportional": 25.0}).gains.proportional
        25.0
    """
    if kind in CONTROLLERS:
        controller, gains = CONTROLLERS[kind]
        return controller(validate(gains, settings or {}, kind), config)
    if ":" not in kind:
        raise ConfigurationError(f"kind '{kind}': {unknown(kind, CONTROLLERS)}, or 'module:attribute'")
    make = imported(kind)
    if not isinstance(make, type) and hasattr(make, "predict"):
        if settings:
            raise ConfigurationError(f"'{kind}': is already a controller and takes no settings")
        return make
    if not callable(make):
        raise ConfigurationError(f"'{kind}': needs a method predict, or must be a class or function that makes one")
    try:
        task = (config,) if inspect.signature(make).parameters else ()
        return make(*task, **(settings or {}))
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigurationError(f"'{kind}': cannot be made from task and settings: {reason(error)}") from error


class GainRow(NamedTuple):
    """One gain as a person reads it."""

    name: str
    value: Any  # in its own unit
    in_practice: str  # "0.199 V/mm", or empty if its own unit is the usual one
    meaning: str
    low: float = -math.inf  # ends of the range of allowed values, in its own unit
    high: float = math.inf


def gain_rows(gains: Group) -> list[GainRow]:
    """The gains of a controller, in the order of their class."""
    rows = []
    for name, field in type(gains).model_fields.items():
        extra: Any = field.json_schema_extra or {}
        value, unit, meaning, in_practice = getattr(gains, name), extra.get("unit"), str(field.description), ""
        if unit in PRACTICE:
            factor, practical = PRACTICE[unit]
            in_practice, meaning = f"{factor * value:.4g} {practical}", meaning.removeprefix(f"{unit}; ")
        rows.append(GainRow(name, value, in_practice, meaning, *extra.get("range", ())))
    return rows


def gains_text(gains: Group, note: str = "") -> str:
    """The gains as YAML; beside each a comment with its value in the units of a PLC, and its meaning.

    A ``note`` about all of them is a comment above them.
    """
    lines = ["# A command of 1 is 10 V; lengths in m, times in s. Beside each gain: the same for a PLC."]
    lines += [f"# {note}"] if note else []
    for row in gain_rows(gains):
        entry = yaml.safe_dump({row.name: row.value}).strip()
        lines.append(f"{entry}  # {', '.join(part for part in (row.in_practice, row.meaning) if part)}")
    return "\n".join(lines) + "\n"


def controller_with_gains(values: ByName, config: TaskConfig) -> Controller:
    """The classical controller with these gains; their names identify it.

    Raises:
        ConfigurationError: they are the gains of no controller, or impossible.
    """
    kinds = [kind for kind, (_, gains) in CONTROLLERS.items() if values and set(values) <= set(gains.model_fields)]
    if len(kinds) != 1:
        raise ConfigurationError(f"must hold the gains of one controller ({', '.join(CONTROLLERS)})")
    return make_controller(kinds[0], config, values)


def controller_from_gains(path: str | Path, config: TaskConfig) -> Controller:
    """The classical controller whose gains a file holds.

    Raises:
        ConfigurationError: the file cannot be read, or holds the gains of no controller.
    """
    gains = read_yaml(path)
    with at(path):
        return controller_with_gains(gains, config)
