"""The servo axis as hydraulics: parameters, equations, integration, analysis. Knows nothing of learning."""

from hydro_env.plant.arrays import equilibrium
from hydro_env.plant.equations import STATE_NAMES, STATE_UNITS
from hydro_env.plant.parameters import PlantParameters, flow_from_resistance, resistance_from_flow
from hydro_env.plant.simulate import Trajectory, simulate

__all__ = [
    "STATE_NAMES",
    "STATE_UNITS",
    "PlantParameters",
    "Trajectory",
    "equilibrium",
    "flow_from_resistance",
    "resistance_from_flow",
    "simulate",
]
