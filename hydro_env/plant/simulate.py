"""Open-loop runs of one plant: the fast integrator, and the tight-tolerance reference solver beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydro_env.errors import HydroError, InvalidStateError
from hydro_env.plant import equations, kernel
from hydro_env.plant.arrays import DERIVED_NAMES, DERIVED_UNITS, coefficient_array, derived_array, equilibrium
from hydro_env.plant.equations import STATE_NAMES, STATE_UNITS
from hydro_env.plant.limits import valid_limits
from hydro_env.plant.parameters import PlantParameters

Array = NDArray[np.float64]


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
    bristle_deflection: Array
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
        """All states, shape (n + 1, 10), columns as in :data:`STATE_NAMES`."""
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
    method: Literal["fast", "radau"] = "fast",
    *,
    tolerance: float = kernel.TOLERANCE,
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
        method: ``"fast"``, the integrator of the environment (Tsitouras 5(4), see ``plant/kernel.py``), or
            ``"radau"``, SciPy's implicit Radau IIA solver at ``relative_tolerance``, started anew at every change of
            the input and wherever the solution has a kink.
        tolerance: of ``"fast"``: largest estimated error of an inner step, in parts of each state's size;
            infinity for steps of fixed length.
        maximum_step: longest inner step of ``"fast"``, s.
        relative_tolerance: of ``"radau"``.

    Returns:
        :class:`Trajectory` with n + 1 samples.

    Raises:
        HydroError: impossible input, unknown state name or method, or a start that cannot be held.
        InvalidStateError: a state left the range in which the model is valid; says which, when and its value.
    """
    inputs = _checked_input(voltage, sample_time, tolerance, maximum_step)
    start = _checked_start(parameters, initial_state)
    coefficients = coefficient_array(parameters)
    if method == "fast":
        states = _run(start, coefficients, inputs, float(sample_time), tolerance, maximum_step)
    elif method == "radau":
        from hydro_env.plant.reference import reference_states  # SciPy's solvers are loaded when first needed

        states = reference_states(start, coefficients, inputs, float(sample_time), relative_tolerance)
    else:
        raise HydroError(f"method = {method!r}: must be 'fast' or 'radau'")
    time = sample_time * np.arange(len(inputs) + 1, dtype=np.float64)
    _check_range(parameters, time, states)
    acting = np.append(inputs, inputs[-1:])
    columns = {name: states[:, row].copy() for row, name in enumerate(STATE_NAMES)}
    derived = derived_array(states, coefficients)
    columns |= {name: derived[:, row].copy() for row, name in enumerate(DERIVED_NAMES)}
    return Trajectory(parameters=parameters, time=time, voltage=acting, **columns)


def valid_ranges(parameters: PlantParameters) -> tuple[Array, Array]:
    """Lowest and highest value of each state for which the model holds, shapes (10,) each, order of STATE_NAMES."""
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


def _checked_input(voltage: ArrayLike, sample_time: float, tolerance: float, maximum_step: float) -> Array:
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
    if not tolerance > 0.0:
        raise HydroError(f"tolerance = {tolerance}: must be positive")
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


def _run(
    start: Array, coefficients: Array, inputs: Array, sample_time: float, tolerance: float, maximum_step: float
) -> Array:
    state = start[None].copy()
    packed = coefficients[None]
    peaks = np.empty((1, kernel.N_PEAKS))
    durations = np.array([sample_time])
    states = np.empty((len(inputs) + 1, len(start)))
    states[0] = start
    for sample in range(len(inputs)):
        kernel.integrate(
            state, packed, inputs[sample : sample + 1, None], durations, maximum_step, tolerance, peaks, 0, 1
        )
        states[sample + 1] = state[0]
    return states
