"""The compiled functions of one plant, on plain NumPy arrays: for simulation, linearisation, the reference solver."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import hydro_env.compiling as compiling
from hydro_env.errors import HydroError
from hydro_env.plant import equations
from hydro_env.plant.equations import (
    STATE_NAMES,
    Physical,
    State,
    acceleration,
    command_changed,
    derivatives,
    edge_flows,
    external_leakage,
    internal_leakage,
)
from hydro_env.plant.equilibrium import equilibrium_state
from hydro_env.plant.limits import hold_limits
from hydro_env.plant.parameters import PlantParameters, to_vector

Array = NDArray[np.float64]

TYPICAL_SIZE = np.array([0.1, 0.1, 1e6, 1e6, 1.0, 10.0, 1.0, 1e6, 1e-3, 1e-5])
"""Sizes of the states, to which absolute tolerances and finite differences relate."""

DERIVED_NAMES = (
    "flow_a",
    "flow_b",
    "leakage_flow",
    "external_leakage_flow",
    "supply_flow",
    "load_force",
    "friction_force",
    "acceleration",
)
DERIVED_UNITS = ("m³/s", "m³/s", "m³/s", "m³/s", "m³/s", "N", "N", "m/s²")


def coefficient_array(parameters: PlantParameters) -> Array:
    """The coefficients of the right-hand side, shape (N_COEFFICIENTS,)."""
    return np.array(_coefficients(to_vector(parameters)))


def equilibrium(parameters: PlantParameters, position: float = 0.0) -> tuple[dict[str, float], float]:
    """State at rest that holds ``position`` (m), and the voltage (V) that keeps it there.

    Pressures balance the forces of (17); the spool stands a little off centre so that the flows of (12), (13) vanish.

    Raises:
        HydroError: the supply cannot hold that position.
    """
    state, voltage, found = _equilibrium(float(position), to_vector(parameters))
    if not found:
        raise HydroError(
            f"position = {position:g} m cannot be held: spring, leakage or external force ask for more than "
            f"the supply of {parameters.supply.pressure / 1e5:g} bar gives"
        )
    return dict(zip(STATE_NAMES, state, strict=True)), voltage


@compiling.inline
def _array_of(state: Any) -> Array:
    out = np.empty(len(state))
    for row, value in enumerate(state):
        out[row] = value
    return out


def _build(stamp: int) -> tuple[Any, ...]:
    @compiling.compiled
    def coefficients_of(vector: Array) -> Any:
        assert stamp >= 0  # keys numba's cache
        return equations.coefficients(_physical(vector))

    @compiling.compiled
    def equilibrium_of(position: float, vector: Array) -> Any:
        assert stamp >= 0
        p = _physical(vector)
        c = equations.coefficients(p)
        state, voltage, found = equilibrium_state(position, p, c)
        return state, voltage, found > 0.0

    @compiling.compiled
    def derivative_of(y: Array, coefficients: Array, voltage: float) -> Array:
        assert stamp >= 0
        return _array_of(derivatives(_state(y), _coefficient_tuple(coefficients), voltage))

    @compiling.compiled
    def command_changed_of(y: Array, coefficients: Array, voltage: float) -> Array:
        assert stamp >= 0
        return _array_of(command_changed(_state(y), _coefficient_tuple(coefficients), voltage))

    @compiling.compiled
    def hold_limits_of(y: Array, coefficients: Array) -> Array:
        assert stamp >= 0
        return _array_of(hold_limits(_state(y), _coefficient_tuple(coefficients)))

    @compiling.compiled
    def derived_of(states: Array, coefficients: Array) -> Array:
        assert stamp >= 0
        c = _coefficient_tuple(coefficients)
        out = np.empty((states.shape[0], len(DERIVED_NAMES)))
        for sample in range(states.shape[0]):
            s = _state(states[sample])
            supply_to_a, a_to_tank, b_to_tank, supply_to_b = edge_flows(s, c)
            out[sample, 0] = supply_to_a - a_to_tank
            out[sample, 1] = b_to_tank - supply_to_b
            out[sample, 2] = internal_leakage(s, c)
            out[sample, 3] = external_leakage(s, c)
            out[sample, 4] = supply_to_a + supply_to_b
            out[sample, 5] = s.pressure_a * c.area_a - s.pressure_b * c.area_b
            out[sample, 6] = equations.friction(s.velocity, s.bristle_deflection, c)[0]
            out[sample, 7] = acceleration(s, c)
        return out

    return coefficients_of, equilibrium_of, derivative_of, command_changed_of, hold_limits_of, derived_of


_physical = compiling.tuple_reader(Physical)
_state = compiling.tuple_reader(State)
_coefficient_tuple = compiling.tuple_reader(equations.Coefficients)
_coefficients, _equilibrium, derivative_array, command_changed_array, hold_limits_array, derived_array = _build(
    compiling.source_stamp("plant/equations.py", "plant/equilibrium.py", "plant/limits.py")
)
