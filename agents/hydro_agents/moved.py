"""Module paths of version 0.2: for one release they lead to the new ones, with a ``DeprecationWarning``."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

PACKAGE = "hydro_agents."
MOVED = {
    "alarms.alarm": "hydro_agents.detection.alarm",
    "alarms.looks": "hydro_agents.detection.looks",
    "bound.best_found": "hydro_agents.evaluation.best_found",
    "diagnosis.diagnose": "hydro_agents.rigs.diagnose",
    "diagnosis.picture": "hydro_agents.rigs.diagnosis_page",
    "evaluation.opponents": "hydro_agents.learning.opponents",
    "evaluation.protocol": "hydro_agents.evaluation.evaluate",
    "leakage.head": "hydro_agents.detection.head",
    "leakage.monitor": "hydro_agents.detection.monitor",
    "rigs.brief": "hydro_agents.rigs.check_table",
    "robustness.conditions": "hydro_agents.evaluation.robustness_protocol",
    "robustness.participants": "hydro_agents.evaluation.participants",
    "robustness.running": "hydro_agents.evaluation.tracking",
}
"""Modules whose names the documentation of version 0.2 used, without the package, and where these names are now."""


class MovedModules(MetaPathFinder, Loader):
    """Finds the modules of :data:`MOVED`, and the packages in which they were."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Where to load a module from; ``None`` for every other one."""
        name = fullname.removeprefix(PACKAGE)
        package = any(old.startswith(f"{name}.") for old in MOVED)
        known = fullname.startswith(PACKAGE) and (package or name in MOVED)
        return ModuleSpec(fullname, self, is_package=package) if known else None

    def exec_module(self, module: ModuleType) -> None:
        """Let the module look up its names in the new one."""
        new = MOVED.get(module.__name__.removeprefix(PACKAGE))
        if new is not None:
            warnings.warn(f"{module.__name__} is {new} since version 0.3", DeprecationWarning, stacklevel=2)
            module.__dict__["__getattr__"] = partial(getattr, importlib.import_module(new))


def find_moved_modules() -> None:
    """Let ``import`` find the paths of version 0.2, after all modules that exist."""
    sys.meta_path.append(MovedModules())
