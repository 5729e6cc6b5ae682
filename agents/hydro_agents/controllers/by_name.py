"""Objects of users by name: ``module:attribute``."""

import importlib
import os
import sys
from operator import attrgetter
from typing import Any

from hydro_env import ConfigurationError
from hydro_env.errors import reason


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
        value = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        raise ConfigurationError(f"'{name}': module '{module}' cannot be imported: {reason(error)}") from error
    try:
        return attrgetter(attribute)(value)
    except AttributeError:
        raise ConfigurationError(f"'{name}': module '{module}' has no '{attribute}'") from None
