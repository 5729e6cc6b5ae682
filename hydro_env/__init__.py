"""A hydraulic servo axis with a leaking piston seal, as plant and as Gymnasium environment.

``import hydro_env`` registers ``ServoHydraulic-v0`` for ``gymnasium.make`` and ``gymnasium.make_vec``. Everything else,
including the compiler, is imported at first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium as _gymnasium

from hydro_env.version import __version__

if TYPE_CHECKING:
    from hydro_env.env import ServoHydraulicEnv
    from hydro_env.errors import ConfigurationError, HydroError, InvalidStateError
    from hydro_env.plant.arrays import equilibrium
    from hydro_env.plant.linearisation import Linearisation, linearise
    from hydro_env.plant.parameters import PlantParameters
    from hydro_env.plant.simulate import Trajectory, simulate
    from hydro_env.task.configuration import LEAKAGE_CLASSES, TaskConfig, task_config
    from hydro_env.task.reference_signals import REFERENCE_FAMILIES
    from hydro_env.units import flow_from_resistance, resistance_from_flow
    from hydro_env.vector_env import ServoHydraulicVectorEnv

ENVIRONMENT_ID = "ServoHydraulic-v0"

if ENVIRONMENT_ID not in _gymnasium.registry:
    _gymnasium.register(
        id=ENVIRONMENT_ID,
        entry_point="hydro_env.env:ServoHydraulicEnv",
        vector_entry_point="hydro_env.vector_env:ServoHydraulicVectorEnv",
    )

_HOME = {
    "ConfigurationError": "errors",
    "HydroError": "errors",
    "InvalidStateError": "errors",
    "LEAKAGE_CLASSES": "task.configuration",
    "Linearisation": "plant.linearisation",
    "PlantParameters": "plant.parameters",
    "REFERENCE_FAMILIES": "task.reference_signals",
    "ServoHydraulicEnv": "env",
    "ServoHydraulicVectorEnv": "vector_env",
    "TaskConfig": "task.configuration",
    "Trajectory": "plant.simulate",
    "equilibrium": "plant.arrays",
    "flow_from_resistance": "units",
    "linearise": "plant.linearisation",
    "resistance_from_flow": "units",
    "simulate": "plant.simulate",
    "task_config": "task.configuration",
}
"""Module that defines each public name; the name is imported at its first use."""

__all__ = [
    "ENVIRONMENT_ID",
    "LEAKAGE_CLASSES",
    "REFERENCE_FAMILIES",
    "ConfigurationError",
    "HydroError",
    "InvalidStateError",
    "Linearisation",
    "PlantParameters",
    "ServoHydraulicEnv",
    "ServoHydraulicVectorEnv",
    "TaskConfig",
    "Trajectory",
    "__version__",
    "equilibrium",
    "flow_from_resistance",
    "linearise",
    "resistance_from_flow",
    "simulate",
    "task_config",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'hydro_env' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"hydro_env.{_HOME[name]}"), name)
    globals()[name] = value  # later uses find it directly
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
