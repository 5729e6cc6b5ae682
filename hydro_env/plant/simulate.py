"""Open-loop runs of one plant: the fast integrator, and the tight-tolerance reference solver beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from hydro_env.plant import compiler, equations, kernel
from hydro_env.plant.equations import (
    STATE_NAMES,
    STATE_UNITS,
    Physical,
    State,
    acceleration,
    derivatives,
    edge_flows,
    external_leakage,
    internal_leakage,
    valid_limits,
)
from hydro_env.plant.equilibrium import equilibrium_state
from hydro_env.plant.errors import HydroError, InvalidStateError
from hydro_env.plant.parameters import PlantParameters, to_vector

Array = NDArray[np.float64]

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


@dataclass(frozen=True)
class Trajectory:
    """A simulated run: n held inputs give n + 1 samples.

    ``time`` (s), one array per state (:data:`STATE_NAMES`, units :data:`STATE_UNITS`), ``voltage`` (V; the input that
    acts from each sample on, the last one repeated), and derived quantities by name (:data:`DERIVED_NAMES`, units
    :data:`DERIVED_UNITS`). All have the shape (n + 1,). ``trajectory["flow_a"]`` works as well.
    """

    parameters: PlantParameters
    time: Array
    voltage: Array
    position: Array
    velocity: Array
    pressure_a: Array
    pressure_b: Array
    spool_position: Array
    spool_velocity: Array
    coil_current: Array
    supply_pressure: Array
    gas_volume: Array
    flow_a: Array
    flow_b: Array
    leakage_flow: Array
    external_leakage_flow: Array
    supply_flow: Array
    load_force: Array
    friction_force: Array
    acceleration: Array

    def __getitem__(self, name: str) -> Array:
        if name not in TRAJECTORY_NAMES:
            raise KeyError(f"no quantity '{name}'; there are: {', '.join(TRAJECTORY_NAMES)}")
        return cast("Array", getattr(self, name))

    @property
    def states(self) -> Array:
        """All states, shape (n + 1, 9), columns as in :data:`STATE_NAMES`."""
        return np.column_stack([getattr(self, name) for name in STATE_NAMES])


TRAJECTORY_NAMES = ("time", "voltage", *STATE_NAMES, *DERIVED_NAMES)
TRAJECTORY_UNITS = dict(
    zip(TRAJECTORY_NAMES, ("s", "V", *STATE_UNITS, *DERIVED_UNITS), strict=True),
)


def simulate(
    parameters: PlantParameters,
    voltage: ArrayLike,
    sample_time: float,
    initial_state: Mapping[str, float] | None = None,
    method: Literal["rk4", "radau"] = "rk4",
    *,
    maximum_step: float = kernel.MAXIMUM_STEP,
    relative_tolerance: float = 1e-10,
) -> Trajectory:
    """Run one plant open loop, each input held for one sample.

    Args:
        parameters: the plant.
        voltage: commands to the valve drive, shape (n,), V, within ±10 V.
        sample_time: duration of each input, s.
        initial_state: values by state name (SI); states that are absent take their value of the equilibrium at the
            given position. ``None`` is the equilibrium that holds position 0.
        method: ``"rk4"``, the fixed-step integrator of the environment, or ``"radau"``, SciPy's implicit
            Radau IIA solver at ``relative_tolerance``, started anew at every change of the input.
        maximum_step: longest inner step of ``"rk4"``, s.
        relative_tolerance: of ``"radau"``.

    Returns:
        :class:`Trajectory` with n + 1 samples.

    Raises:
        HydroError: impossible input, unknown state name or method, or a start that cannot be held.
        InvalidStateError: a state left the range in which the model is valid; says which, when and its value.
    """
    inputs = _checked_input(voltage, sample_time, maximum_step)
    start = _checked_start(parameters, initial_state)
    coefficients = coefficient_array(parameters)
    if method == "rk4":
        states = _run(start, coefficients, inputs, float(sample_time), maximum_step)
    elif method == "radau":
        states = _reference(start, coefficients, inputs, float(sample_time), relative_tolerance)
    else:
        raise HydroError(f"method = {method!r}: must be 'rk4' or 'radau'")
    time = sample_time * np.arange(len(inputs) + 1, dtype=np.float64)
    _check_range(parameters, time, states)
    acting = np.append(inputs, inputs[-1:])
    columns = {name: states[:, row].copy() for row, name in enumerate(STATE_NAMES)}
    derived = _derived(states, coefficients)
    columns |= {name: derived[:, row].copy() for row, name in enumerate(DERIVED_NAMES)}
    return Trajectory(parameters=parameters, time=time, voltage=acting, **columns)


def valid_ranges(parameters: PlantParameters) -> tuple[Array, Array]:
    """Lowest and highest value of each state for which the model holds, shapes (9,) each, order of STATE_NAMES."""
    c = equations.Coefficients(*coefficient_array(parameters))
    low, high = valid_limits(
        c.end_stop_position,
        c.slew_limit,
        c.volume_b0,
        c.area_a,
        c.area_b,
        c.supply_dynamics,
        parameters.supply.accumulator_volume,
    )
    return np.array(low), np.array(high)


def _check_range(parameters: PlantParameters, time: Array, states: Array) -> None:
    low, high = valid_ranges(parameters)
    bad = ~((states >= low) & (states <= high))
    if bad.any():
        sample, row = np.argwhere(bad)[0]
        raise InvalidStateError(
            f"{STATE_NAMES[row]} left its valid range at t = {time[sample]:g} s: {states[sample, row]:g} "
            f"{STATE_UNITS[row]}, allowed {low[row]:g} to {high[row]:g}"
        )


def _checked_input(voltage: ArrayLike, sample_time: float, maximum_step: float) -> Array:
    try:
        inputs = np.asarray(voltage, dtype=np.float64)
    except (TypeError, ValueError):
        raise HydroError("voltage: must be numbers, in V") from None
    if inputs.ndim != 1 or len(inputs) == 0:
        raise HydroError(f"voltage: must be one row of at least one value, not of shape {inputs.shape}")
    wrong = ~(np.abs(inputs) <= 10.0)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise HydroError(f"voltage[{first}] = {inputs[first]:g} V: must be within -10 to 10 V")
    if not 0.0 < sample_time < np.inf:
        raise HydroError(f"sample_time = {sample_time} s: must be positive")
    if not 0.0 < maximum_step < np.inf:
        raise HydroError(f"maximum_step = {maximum_step} s: must be positive")
    return inputs


def _checked_start(parameters: PlantParameters, initial_state: Mapping[str, float] | None) -> Array:
    given = dict(initial_state or {})
    for name, value in given.items():
        if name not in STATE_NAMES:
            raise HydroError(f"initial_state: unknown state '{name}'; known: {', '.join(STATE_NAMES)}")
        if not np.isfinite(value):
            raise HydroError(f"initial_state: {name} = {value}: must be a finite number")
    if len(given) < len(STATE_NAMES):
        rest, _ = equilibrium(parameters, given.get("position", 0.0))
        given = rest | given
    start = np.array([float(given[name]) for name in STATE_NAMES])
    _check_range(parameters, np.zeros(1), start[None])
    return start


def _run(start: Array, coefficients: Array, inputs: Array, sample_time: float, maximum_step: float) -> Array:
    state = np.repeat(start[None, :, None], kernel.LANES, axis=2)
    packed = np.repeat(coefficients[None, :, None], kernel.LANES, axis=2)
    held = np.empty((1, 1, kernel.LANES))
    peaks = np.empty((1, kernel.N_PEAKS, kernel.LANES))
    durations = np.array([sample_time])
    states = np.empty((len(inputs) + 1, len(start)))
    states[0] = start
    for sample, value in enumerate(inputs):
        held[:] = value
        kernel.integrate(state, packed, held, durations, maximum_step, peaks, 0, 1)
        states[sample + 1] = state[0, :, 0]
    return states


TYPICAL_SIZE = np.array([0.1, 0.1, 1e6, 1e6, 1.0, 10.0, 1.0, 1e6, 1e-3])
"""Sizes of the states, to which absolute tolerances relate."""


def _reference(start: Array, coefficients: Array, inputs: Array, sample_time: float, tolerance: float) -> Array:
    states = np.empty((len(inputs) + 1, len(start)))
    states[0] = start
    for sample, value in enumerate(inputs):
        solution: Any = solve_ivp(
            lambda _, y, u=value: derivative_array(y, coefficients, u),
            (0.0, sample_time),
            states[sample],
            method="Radau",
            rtol=tolerance,
            atol=tolerance * TYPICAL_SIZE,
        )
        if not solution.success:
            raise InvalidStateError(
                f"the reference solver failed at t = {sample * sample_time:g} s: {solution.message}"
            )
        states[sample + 1] = solution.y[:, -1]
    return states


def _build(stamp: int) -> tuple[Any, ...]:
    @compiler.compiled
    def coefficients_of(vector: Array) -> Any:
        assert stamp >= 0  # keys numba's cache
        return equations.coefficients(_physical(vector))

    @compiler.compiled
    def equilibrium_of(position: float, vector: Array) -> Any:
        assert stamp >= 0
        p = _physical(vector)
        c = equations.coefficients(p)
        state, voltage, found = equilibrium_state(position, p, c)
        return state, voltage, found > 0.0

    @compiler.compiled
    def derivative_of(y: Array, coefficients: Array, voltage: float) -> Array:
        assert stamp >= 0
        rate = derivatives(_state(y), _coefficient_tuple(coefficients), voltage)
        out = np.empty(y.shape[0])
        for row, value in enumerate(rate):
            out[row] = value
        return out

    @compiler.compiled
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
            out[sample, 6] = equations.friction_force(s.velocity, c)
            out[sample, 7] = acceleration(s, c)
        return out

    return coefficients_of, equilibrium_of, derivative_of, derived_of


_physical = compiler.tuple_reader(Physical)
_state = compiler.tuple_reader(State)
_coefficient_tuple = compiler.tuple_reader(equations.Coefficients)
_coefficients, _equilibrium, derivative_array, _derived = _build(
    compiler.source_stamp("plant/equations.py", "plant/equilibrium.py")
)
