"""The compiled functions of one plant on plain NumPy arrays, for simulation, linearisation and the reference solver."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from hydro_env.compiling import SOURCES, compiled, tuple_reader, tuple_writer
from hydro_env.errors import HydroError
from hydro_env.plant.equations import (
    Coefficients,
    Derived,
    coefficients,
    command_changed,
    derivatives,
    derived_quantities,
    hold_limits,
    parts_of,
)
from hydro_env.plant.equilibrium import complete_at_rest, equilibrium_state
from hydro_env.plant.parameters import Physical, PlantParameters, to_vector
from hydro_env.plant.parts.lines import VOLUMES, WAVES, LineLaws
from hydro_env.plant.states import ALL_STATES, COMPLETE, N_ALL_STATES, RIGID, State, Structure, state_kind
from hydro_env.types import Floats

read_physical = tuple_reader(Physical)
read_coefficients = tuple_reader(Coefficients)
write_coefficients = tuple_writer(Coefficients)
read_state = tuple_reader(State)
read_complete_state = tuple_reader(COMPLETE)
write_complete_state = tuple_writer(COMPLETE)
_write_derived = tuple_writer(Derived)

N_COEFFICIENTS = len(Coefficients._fields)
N_DERIVED = len(Derived._fields)


def plant_coefficients(parameters: PlantParameters) -> Any:
    """The coefficients of the right-hand side by name, :data:`~hydro_env.plant.equations.Coefficients`."""
    return Coefficients(*coefficient_array(parameters).tolist())


def coefficient_array(parameters: PlantParameters) -> Floats:
    """The coefficients of the right-hand side, shape (N_COEFFICIENTS,)."""
    return _coefficients_of(to_vector(parameters))


def equilibrium(parameters: PlantParameters, position: float = 0.0) -> tuple[dict[str, float], float]:
    """State at rest that holds ``position`` (m), and the voltage (V) that keeps it there.

    The pressures balance the forces of (17); a small spool offset makes the flows of (12), (13) vanish.

    Raises:
        HydroError: the supply cannot hold that position.

    Example:
        >>> from hydro_env import PlantParameters, equilibrium
        >>> state, voltage = equilibrium(PlantParameters(), position=0.02)
        >>> f"{state['pressure_a'] / 1e5:.1f} bar, {1e3 * voltage:.0f} mV"
        '35.2 bar, -8 mV'
    """
    equilibrium_of = _equilibrium_of_lines if parameters.lines.have_waves else _equilibrium_of
    state, voltage, found = equilibrium_of(float(position), to_vector(parameters))
    if not found:
        raise HydroError(
            f"position = {position:g} m cannot be held: spring, leakage or external force need more than "
            f"the supply of {parameters.supply.pressure / 1e5:g} bar can give"
        )
    everything = dict(zip(ALL_STATES, state.tolist(), strict=True))
    return {name: everything[name] for name in state_kind(parameters.structure)._fields}, voltage


def _build(sources: int, lines: LineLaws) -> tuple[Any, ...]:
    def coefficients_of(vector: Floats) -> Floats:
        assert sources >= 0  # keys numba's cache
        out = np.empty(N_COEFFICIENTS)
        write_coefficients(out, coefficients(read_physical(vector)))
        return out

    def equilibrium_of(position: float, vector: Floats) -> Any:
        assert sources >= 0
        p = read_physical(vector)
        c = coefficients(p)
        state, voltage, found = equilibrium_state(position, p, c, lines)
        out = np.empty(N_ALL_STATES)
        write_complete_state(out, complete_at_rest(state, c))
        return out, voltage, found

    return compiled(coefficients_of), compiled(equilibrium_of)


_coefficients_of, _equilibrium_of = _build(SOURCES, VOLUMES)
_, _equilibrium_of_lines = _build(SOURCES + 1, WAVES)


class AxisFunctions(NamedTuple):
    """Functions of the states of one axis, in the order of its structure."""

    derivative: Any  # (state, coefficients, voltage) → derivative
    command_changed: Any  # (state, coefficients, voltage) → state
    hold_limits: Any  # (state, coefficients) → state
    derived: Any  # (states (n, states), coefficients (n or 1, …)) → (n, N_DERIVED)


@cache
def functions_of(structure: Structure) -> AxisFunctions:
    """The functions of axes with a structure; each is compiled when it is first called."""
    sources = SOURCES + structure.number
    parts, kind = parts_of(structure), state_kind(structure)
    read, write, size = tuple_reader(kind), tuple_writer(kind), len(kind._fields)

    def of_command(law: Any) -> Any:
        def array(state: Floats, coefficients: Floats, voltage: float) -> Floats:
            assert sources >= 0
            out = np.empty(size)
            write(out, law(read(state), read_coefficients(coefficients), voltage, parts))
            return out

        return compiled(array)

    def hold_limits_array(state: Floats, coefficients: Floats) -> Floats:
        assert sources >= 0
        out = np.empty(size)
        write(out, hold_limits(read(state), read_coefficients(coefficients), parts))
        return out

    def derived_array(states: Floats, coefficients: Floats) -> Floats:
        assert sources >= 0
        out = np.empty((states.shape[0], N_DERIVED))
        for sample in range(states.shape[0]):
            c = read_coefficients(coefficients[sample if coefficients.shape[0] > 1 else 0])
            _write_derived(out[sample], derived_quantities(read(states[sample]), c, parts))
        return out

    return AxisFunctions(
        of_command(derivatives), of_command(command_changed), compiled(hold_limits_array), compiled(derived_array)
    )


derivative_array = functions_of(RIGID).derivative  # (state, coefficients, voltage) of an axis without optional parts
