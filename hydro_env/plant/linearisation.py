"""The axis linearised at a state: matrices, modes, and a state space in the form that control libraries use."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hydro_env.errors import HydroError
from hydro_env.plant.arrays import coefficient_array, equilibrium, functions_of
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parameters import PlantParameters
from hydro_env.plant.states import ALL_STATES, STATE_NAMES, State, state_kind, typical_sizes
from hydro_env.types import Floats

VALVE_STATES = ("spool_position", "spool_velocity", "coil_current")  # on which the others do not act back
IDEAL_RATE = 1e5  # 1/s; an ideal part of the valve follows its command at this rate in a linearisation
NO_RATE = 1e-6  # 1/s; a smaller effect of one state on another, both relative to their typical sizes, is ignored


class Mode(NamedTuple):
    """One eigenvalue, or a complex pair, of the linearised axis."""

    natural_frequency: float  # rad/s
    damping_ratio: float
    eigenvalue: complex
    state: str = "velocity"  # that takes part most


class StateSpace(NamedTuple):
    """dx/dt = A x + B u, y = C x + D u, of deviations, where u is the voltage; with names and units of x, u and y.

    Use it as ``scipy.signal.StateSpace(*space.matrices)`` or ``control.ss(*space.matrices, **space.names)``.
    """

    A: Floats  # (n, n)
    B: Floats  # (n, 1)
    C: Floats  # (p, n)
    D: Floats  # (p, 1)
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    units: dict[str, str]

    @property
    def matrices(self) -> tuple[Floats, Floats, Floats, Floats]:
        """A, B, C, D."""
        return self.A, self.B, self.C, self.D

    @property
    def names(self) -> dict[str, list[str]]:
        """Names of states, inputs and outputs, as keywords for python-control."""
        return {"states": list(self.states), "inputs": ["voltage"], "outputs": list(self.outputs)}


@dataclass(frozen=True, eq=False)
class Linearisation:
    """d(state)/dt = A (state − state_0) + B (voltage − voltage_0) + E F, F the change of the external force.

    Example:
        >>> from hydro_env import PlantParameters, linearise
        >>> model = linearise(PlantParameters(), position=0.01)
        >>> space = model.state_space(outputs=["position"])
        >>> space.A.shape, space.names["inputs"], space.names["states"][:2]
        ((8, 8), ['voltage'], ['position', 'velocity'])
    """

    a: Floats  # (N, N), states in the order of ``names``
    b: Floats  # (N,), per V
    force: Floats  # E, (N,), per N
    state: Floats  # (N,)
    voltage: float
    names: tuple[str, ...] = STATE_NAMES  # of the N states

    @property
    def active_states(self) -> tuple[str, ...]:
        """States that move and act on another state, and the position; all others would add poles at zero.

        At rest the gas volume acts on nothing. A constant supply pressure does not move, nor does the bristle
        deflection without LuGre friction.
        """
        size = typical_sizes(self.names)
        rates = np.abs(self.a) * size / size[:, None]
        moves = rates.max(axis=1) + np.abs(self.b) / size > NO_RATE
        acts = rates.max(axis=0) > NO_RATE
        acts[self.names.index("position")] = True
        return tuple(name for name, active in zip(self.names, moves & acts, strict=True) if active)

    def state_space(self, outputs: Sequence[str] = ("position",)) -> StateSpace:
        """State space of the active states, from the voltage to chosen outputs (names of states).

        Raises:
            HydroError: an output is unknown, or not active.
        """
        active = self.active_states
        if isinstance(outputs, str) or not set(outputs) <= set(active):
            raise HydroError(f"state_space: outputs = {outputs!r}: must be names of {', '.join(active)}")
        rows = [self.names.index(name) for name in active]
        c = np.array([[float(name == state) for state in active] for name in outputs])
        units = {name: ALL_STATES[name].unit for name in active} | {"voltage": "V"}
        d = np.zeros((len(outputs), 1))
        return StateSpace(self.a[np.ix_(rows, rows)], self.b[rows][:, None], c, d, active, tuple(outputs), units)

    @property
    def modes(self) -> list[Mode]:
        """Oscillations of mass, oil columns, lines and second mass, the slowest first.

        The axis does not act back on the valve; these states therefore have their own eigenvalues. Each mode names the
        state with the largest participation factor (Perez-Arriaga, Verghese & Schweppe 1982).
        """
        names = [name for name in self.names if name not in VALVE_STATES]
        rows = [self.names.index(name) for name in names]
        values, right = np.linalg.eig(self.a[np.ix_(rows, rows)])
        left = np.linalg.pinv(right)
        found = []
        for number in np.flatnonzero(values.imag > 1e-3 * np.abs(values).max()):
            value = complex(values[number])
            share = np.abs(right[:, number] * left[number])
            found.append(Mode(abs(value), -value.real / abs(value), value, names[np.argmax(share)]))
        return sorted(found)

    @property
    def hydraulic_mode(self) -> Mode:
        """Oscillation of the mass on the oil columns: the fastest one in which the lines take less part than the mass.

        A linearisation at standstill includes dry friction; use ``friction.model: none`` for the damping of a moving
        axis.

        Raises:
            ArithmeticError: no oscillation.
        """
        own = [mode for mode in self.modes if not mode.state.startswith(("line_", "tip_"))]
        if not own:
            raise ArithmeticError("the linearised axis has no oscillation: it is overdamped here")
        return own[-1]


def linearise(
    parameters: PlantParameters,
    state: State | Mapping[str, float] | Floats | None = None,
    voltage: float | None = None,
    position: float = 0.0,
) -> Linearisation:
    """Linearise the right-hand side by central differences.

    Args:
        parameters: the plant.
        state: operating point, as values in the order of :data:`STATE_NAMES` or by name; ``None`` is the equilibrium
            at ``position`` (m).
        voltage: V; ``None`` is the voltage that holds the equilibrium (0 with a given state).
        position: m, used without ``state``.

    Raises:
        HydroError: the state is incomplete or has the wrong shape, or the position cannot be held.

    Example:
        >>> from hydro_env import PlantParameters, linearise
        >>> frictionless = PlantParameters().replace(friction={"model": "none"})
        >>> mode = linearise(frictionless).hydraulic_mode
        >>> f"{mode.natural_frequency:.0f} rad/s, damping ratio {mode.damping_ratio:.3f}"
        '414 rad/s, damping ratio 0.009'
    """
    holding = 0.0
    if state is None:
        state, holding = equilibrium(parameters, position)
    names = state_kind(parameters.structure)._fields
    derivative_array, command_changed_array, *_ = functions_of(parameters.structure)
    values = [state.get(name) for name in names] if isinstance(state, Mapping) else state
    try:
        at = np.array(values, float).reshape(len(names))
    except (TypeError, ValueError):
        raise HydroError(f"state: must be numbers for {', '.join(names)}") from None
    voltage = holding if voltage is None else float(voltage)
    c = coefficient_array(parameters)
    typical, unit = typical_sizes(names), np.eye(len(names))
    columns = [
        _difference(lambda step, row=row: derivative_array(at + unit[row] * step, c, voltage), 1e-6 * size)
        for row, size in enumerate(typical)
    ]
    a = np.column_stack(columns)
    b = _difference(lambda step: derivative_array(at, c, voltage + step), 1e-3)
    acting = np.eye(len(c))[Coefficients._fields.index("external_force")]
    force = _difference(lambda step: derivative_array(at, c + acting * step, voltage), 1.0)
    # The states that a new command sets at once (ideal parts of the valve) get a lag of 10 µs.
    elsewhere = at + 1e-3 * typical
    gains = _difference(lambda step: command_changed_array(at, c, voltage + step), 1e-3)
    for row in np.flatnonzero(command_changed_array(elsewhere, c, voltage) != elsewhere):
        a[row] = 0.0
        a[row, row] = -IDEAL_RATE
        b[row] = IDEAL_RATE * gains[row]
    return Linearisation(a, b, force, at, voltage, names)


def _difference(function: Any, step: float) -> Any:
    return (function(step) - function(-step)) / (2.0 * step)


def fastest_motion(parameters: PlantParameters, state: State | Floats) -> tuple[float, str]:
    """|λ| in 1/s of the fastest eigenvalue at a state, and the state that moves most in it, relative to its size.

    Ideal parts of the valve do not count.
    """
    model = linearise(parameters, state, 0.0)
    values, vectors = np.linalg.eig(model.a)
    rates = np.abs(values)
    rates[np.abs(rates - IDEAL_RATE) < 1e-6 * IDEAL_RATE] = 0.0
    fastest = np.argmax(rates)
    return rates[fastest], model.names[np.argmax(np.abs(vectors[:, fastest]) / typical_sizes(model.names))]
