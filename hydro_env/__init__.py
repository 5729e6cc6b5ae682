"""A hydraulic servo axis with a leaking piston seal, as plant and as Gymnasium environment.

``import hydro_env`` registers ``ServoHydraulic-v0`` for ``gymnasium.make`` and ``gymnasium.make_vec``.
"""

from __future__ import annotations

import gymnasium as _gymnasium

from hydro_env.env import ServoHydraulicEnv
from hydro_env.plant import (
    PlantParameters,
    Trajectory,
    equilibrium,
    flow_from_resistance,
    resistance_from_flow,
    simulate,
)
from hydro_env.plant.errors import ConfigurationError, HydroError, InvalidStateError
from hydro_env.task.configuration import LEAKAGE_CLASSES, REFERENCE_FAMILIES, TaskConfig
from hydro_env.vector_env import ServoHydraulicVectorEnv
from hydro_env.version import __version__

ENVIRONMENT_ID = "ServoHydraulic-v0"

if ENVIRONMENT_ID not in _gymnasium.registry:
    _gymnasium.register(
        id=ENVIRONMENT_ID,
        entry_point="hydro_env.env:ServoHydraulicEnv",
        vector_entry_point="hydro_env.vector_env:ServoHydraulicVectorEnv",
    )

__all__ = [
    "ENVIRONMENT_ID",
    "LEAKAGE_CLASSES",
    "REFERENCE_FAMILIES",
    "ConfigurationError",
    "HydroError",
    "InvalidStateError",
    "PlantParameters",
    "ServoHydraulicEnv",
    "ServoHydraulicVectorEnv",
    "TaskConfig",
    "Trajectory",
    "__version__",
    "equilibrium",
    "flow_from_resistance",
    "resistance_from_flow",
    "simulate",
]
