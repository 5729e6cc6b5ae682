"""Open-loop runs of one plant, with the fast integrator or the reference solver."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.errors import HydroError, InvalidStateError
from hydro_env.mistakes import refuse_unknown
from hydro_env.plant.arrays import coefficient_array, equilibrium, functions_of, plant_coefficients
from hydro_env.plant.equations import Derived
from hydro_env.plant.kernel import (
    MAXIMUM_STEP,
    MOST_STEPS_PER_PERIOD,
    N_PEAKS,
    STEPS,
    TOLERANCE,
    Accuracy,
    Plants,
    integrators,
)
from hydro_env.plant.parameters import PlantParameters
from hydro_env.plant.states import (
    ALL_STATES,
    N_ALL_STATES,
    STATE_NAMES,
    STATE_UNITS,
    Structure,
    columns_of,
    state_kind,
    valid_range,
)
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

DERIVED_NAMES = Derived._fields
DERIVED_UNITS = tuple(hint.__metadata__[0] for hint in get_type_hints(Derived, include_extras=True).values())
TRAJECTORY_NAMES = ("time", "voltage", *STATE_NAMES, *DERIVED_NAMES)
TRAJECTORY_UNITS = dict(zip(TRAJECTORY_NAMES, ("s", "V", *STATE_UNITS, *DERIVED_UNITS), strict=True))
"""Of an axis without optional parts; those have further states (:data:`~hydro_env.plant.states.ALL_STATES`)."""

LONGEST_PERIOD = 0.02  # s; a longer sample may take more inner steps


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """A simulated run: n held inputs give n + 1 samples.

    ``time`` (s), ``voltage`` (V; the input that acts from each sample on, the last one repeated), every state
    (:data:`STATE_NAMES`) and every derived quantity (:data:`DERIVED_NAMES`) have shape (n + 1,). Read them by name:
    ``trajectory.position`` or ``trajectory["position"]``. :data:`TRAJECTORY_UNITS` lists the units.

    Example:
        >>> import numpy as np
        >>> from hydro_env import PlantParameters, simulate
        >>> run = simulate(PlantParameters(), np.full(500, 3.0), 1e-3)
        >>> run
        Trajectory(501 samples, 0.5 s, position, velocity, pressure_a, …)
        >>> f"{1e3 * run.velocity[-1]:.0f} mm/s"
        '46 mm/s'
        >>> list(run.to_dataframe().columns[:3])
        ['voltage', 'position', 'velocity']
    """

    parameters: PlantParameters
    time: Floats
    voltage: Floats
    states: Floats  # (n + 1, states), columns as in state_names
    derived: Floats  # (n + 1, len(DERIVED_NAMES))

    @property
    def state_names(self) -> tuple[str, ...]:
        """The states of this axis; lines with waves and a second mass have their own."""
        return state_kind(self.parameters.structure)._fields

    @property
    def names(self) -> tuple[str, ...]:
        """Every quantity."""
        return ("time", "voltage", *self.state_names, *DERIVED_NAMES)

    def __getattr__(self, name: str) -> Floats:
        if name in ALL_STATES and name in self.state_names:
            return self.states[:, self.state_names.index(name)]
        if name in DERIVED_NAMES:
            return self.derived[:, DERIVED_NAMES.index(name)]
        raise AttributeError(f"a trajectory has no '{name}'; it has: {', '.join(TRAJECTORY_NAMES)}")

    def __getitem__(self, name: str) -> Floats:
        if name not in self.names:
            raise KeyError(f"no quantity '{name}'; there are: {', '.join(self.names)}")
        return getattr(self, name)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return f"Trajectory({len(self)} samples, {self.time[-1]:g} s, {', '.join(TRAJECTORY_NAMES[2:5])}, …)"

    def to_dataframe(self) -> Any:
        """All quantities as a pandas DataFrame (n + 1 rows) over time; ``frame.attrs["units"]`` has the units."""
        from pandas import DataFrame, Index  # imported at first use

        frame = DataFrame({name: self[name] for name in self.names[1:]}, index=Index(self.time, name="time"))
        units = {name: info.unit for name, info in ALL_STATES.items() if name in self.state_names}
        frame.attrs["units"] = dict(TRAJECTORY_UNITS) | units
        return frame


def simulate(
    parameters: PlantParameters,
    voltage: ArrayLike,
    sample_time: float,
    initial_state: Mapping[str, float] | None = None,
    method: Literal["fast", "radau"] = "fast",
    *,
    tolerance: float = TOLERANCE,
    maximum_step: float = MAXIMUM_STEP,
    relative_tolerance: float = 1e-10,
) -> Trajectory:
    """Run one plant open loop, each input held for one sample.

    Args:
        parameters: the plant.
        voltage: commands to the valve drive, shape (n,), V, within ±10 V.
        sample_time: duration of each input, s.
        initial_state: values by state name (SI); absent states take their equilibrium value at the given position.
            ``None`` is the equilibrium at position 0.
        method: ``"fast"``, the integrator of the environment (Tsitouras 5(4), see ``plant/kernel.py``), or
            ``"radau"``, SciPy's implicit Radau IIA solver at ``relative_tolerance``, restarted at every change of
            the input and at every kink of the solution.
        tolerance: of ``"fast"``: largest estimated error of an inner step, relative to each state's size;
            infinity for steps of fixed length.
        maximum_step: longest inner step of ``"fast"``, s.
        relative_tolerance: of ``"radau"``.

    Returns:
        :class:`Trajectory` with n + 1 samples.

    Raises:
        HydroError: the input is impossible, a state name or the method is unknown, or the start cannot be held.
        InvalidStateError: a state left the range in which the model is valid; the message gives state, time and value.

    Example:
        >>> import numpy as np
        >>> from hydro_env import PlantParameters, resistance_from_flow, simulate
        >>> rig = PlantParameters()
        >>> worn = rig.replace(leakage={"internal_resistance": resistance_from_flow(4.0)})
        >>> voltage = np.full(500, 3.0)  # 0.5 s
        >>> [f"{1e3 * simulate(plant, voltage, 1e-3).position[-1]:.1f} mm" for plant in (rig, worn)]
        ['24.9 mm', '24.2 mm']
    """
    inputs = _checked_input(voltage)
    sample_time = _positive("sample_time", sample_time, 1e6)
    accuracy = Accuracy(
        maximum_step=_positive("maximum_step", maximum_step, 1e6),
        tolerance=_positive("tolerance", tolerance, math.inf),
        most_steps=MOST_STEPS_PER_PERIOD * max(sample_time / LONGEST_PERIOD, 1.0),
    )
    start, structure = _checked_start(parameters, initial_state), parameters.structure
    coefficients = coefficient_array(parameters)
    if method == "fast":
        states = _run(start, coefficients, inputs, sample_time, accuracy, structure)
    elif method == "radau":
        from hydro_env.plant.reference import reference_states  # SciPy's solvers are imported at first use

        relative = _positive("relative_tolerance", relative_tolerance, 1.0)
        states = reference_states(start, coefficients, inputs, sample_time, relative, structure)
    else:
        raise HydroError(f"method = {method!r}: must be 'fast' or 'radau'")
    time = sample_time * np.arange(len(inputs) + 1, dtype=float)
    _check_range(parameters, time, states)
    acting = np.append(inputs, inputs[-1:])
    return Trajectory(parameters, time, acting, states, functions_of(structure).derived(states, coefficients[None]))


def valid_ranges(parameters: PlantParameters) -> tuple[Floats, Floats]:
    """Lowest and highest value of each state for which the model is valid, shapes (N_STATES,)."""
    lowest, highest = valid_range(plant_coefficients(parameters))
    return np.array(lowest), np.array(highest)


def _check_range(parameters: PlantParameters, time: Floats, states: Floats) -> None:
    low, high = valid_ranges(parameters)
    own = states[:, : len(low)]
    bad = ~((own >= low) & (own <= high))
    if bad.any():
        sample, row = np.argwhere(bad)[0]
        raise InvalidStateError(
            f"{STATE_NAMES[row]} left its valid range at t = {time[sample]:g} s: {states[sample, row]:g} "
            f"{STATE_UNITS[row]}, allowed {low[row]:g} to {high[row]:g}"
        )


def _checked_input(voltage: ArrayLike) -> Floats:
    inputs = np.asarray(voltage, float)
    if inputs.ndim != 1 or not len(inputs):
        raise HydroError(f"voltage: must be one row of at least one value, not of shape {inputs.shape}")
    wrong = ~(np.abs(inputs) <= FULL_VOLTAGE)
    if wrong.any():
        first, limit = np.argmax(wrong), FULL_VOLTAGE
        raise HydroError(f"voltage[{first}] = {inputs[first]:g} V: must be within -{limit:g} to {limit:g} V")
    return inputs


def _positive(name: str, value: float, most: float) -> float:
    if not 0.0 < value <= most:
        raise HydroError(f"{name} = {value!r}: must be positive, at most {most:g}")
    return float(value)


def _checked_start(parameters: PlantParameters, initial_state: Mapping[str, float] | None) -> Floats:
    given = dict(initial_state or {})
    names = state_kind(parameters.structure)._fields
    refuse_unknown("initial_state", given, names, "state")
    for name, value in given.items():
        if not math.isfinite(value):
            raise HydroError(f"initial_state: {name} = {value}: must be a finite number")
    if len(given) < len(names):
        rest, _ = equilibrium(parameters, given.get("position", 0.0))
        given = rest | given
    start = np.array([given[name] for name in names])
    _check_range(parameters, np.zeros(1), start[None])
    return start


def _run(
    start: Floats, coefficients: Floats, inputs: Floats, sample_time: float, accuracy: Accuracy, structure: Structure
) -> Floats:
    integrate, _ = integrators(structure)
    columns = columns_of(structure)
    everything = np.zeros((1, N_ALL_STATES))
    everything[0, columns] = start
    plants = Plants(
        everything, coefficients[None], np.empty((1, 1)), np.full((1, 1), sample_time), np.empty((1, N_PEAKS))
    )
    states = np.tile(start, (len(inputs) + 1, 1))
    for sample, voltage in enumerate(inputs):
        plants.voltage[0, 0] = voltage
        integrate(plants, accuracy, 0, 1)
        if plants.peaks[0, STEPS] > accuracy.most_steps:
            raise InvalidStateError(
                f"more than {accuracy.most_steps:,.0f} inner steps in the sample at t = {sample * sample_time:g} s: "
                f"the parameters make the axis too stiff, or the tolerance is too small"
            )
        states[sample + 1] = everything[0, columns]
    return states
