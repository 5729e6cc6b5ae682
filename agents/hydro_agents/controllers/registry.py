"""Controllers by kind: ``kind: pid``, or ``kind: "my_module:MyController"`` for your own."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Mapping
from typing import Any

from hydro_agents.controllers.adrc import ADRC, ADRCGains
from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.lqg import LQG, LQGGains
from hydro_agents.controllers.pid import PID, PIDGains
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.errors import reason
from hydro_env.files import Group, validate
from hydro_env.mistakes import unknown

CONTROLLERS: dict[str, tuple[type[ClassicalController], type[Group]]] = {
    "pid": (PID, PIDGains),
    "flow_linearising": (FlowLinearising, FlowLinearisingGains),
    "adrc": (ADRC, ADRCGains),
    "lqg": (LQG, LQGGains),
}
"""Each classical controller by kind: its class, and the class of its gains."""


def kind_of(controller: ClassicalController) -> str:
    """The kind under which a classical controller is registered.

    Raises:
        ConfigurationError: its class is not registered.
    """
    for kind, (registered, _) in CONTROLLERS.items():
        if type(controller) is registered:
            return kind
    raise ConfigurationError(f"{type(controller).__name__}: must be one of CONTROLLERS ({', '.join(CONTROLLERS)})")


def imported(name: str) -> Any:
    """The object that ``"module:attribute"`` names; the module may lie in the current folder.

    Raises:
        ConfigurationError: the module cannot be imported or has no such attribute.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ConfigurationError(f"'{name}': must be 'module:attribute'")
    if os.getcwd() not in sys.path and "" not in sys.path:
        sys.path.append(os.getcwd())
    try:
        value: Any = importlib.import_module(module)
    except Exception as error:
        moved = f"; since version 0.3 it is hydro_{module}" if module.startswith("agents.") else ""
        raise ConfigurationError(f"'{name}': module '{module}' cannot be imported: {reason(error)}{moved}") from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            raise ConfigurationError(f"'{name}': module '{module}' has no '{attribute}'")
        value = getattr(value, part)
    return value


def make_controller(kind: str, config: TaskConfig, settings: Mapping[str, Any] | None = None) -> Controller:
    """A controller for a task.

    Args:
        kind: a key of :data:`CONTROLLERS`, or ``"module:attribute"``. The attribute is a controller, or a class or
            function that makes one: ``attribute(config, **settings)``, or ``attribute()`` if it takes no argument.
        config: the task, which defines the layout of the observations and the control period.
        settings: settings of the controller.

    Raises:
        ConfigurationError: the kind is unknown, or the settings do not fit it.
    """
    make: Any
    if ":" in kind:
        make = imported(kind)
        if not isinstance(make, type) and hasattr(make, "predict"):
            if settings:
                raise ConfigurationError(f"'{kind}': is already a controller and takes no settings")
            return make  # type: ignore[no-any-return]
        if not callable(make):
            raise ConfigurationError(f"'{kind}': needs a method predict, or must be a class or function that makes one")
    elif kind in CONTROLLERS:
        controller, gains = CONTROLLERS[kind]
        return controller(validate(gains, settings or {}, kind), config)
    else:
        raise ConfigurationError(f"kind '{kind}': {unknown(kind, CONTROLLERS)}, or 'module:attribute'")
    try:
        task = (config,) if inspect.signature(make).parameters else ()
        return make(*task, **(settings or {}))  # type: ignore[no-any-return]
    except ConfigurationError:
        raise
    except Exception as error:
        raise ConfigurationError(f"'{kind}': cannot be made from task and settings: {reason(error)}") from error
