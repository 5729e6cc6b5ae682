"""The reference solver: SciPy's implicit Radau IIA at tight tolerance on the same right-hand side.

It shares only the equations with the fast integrator, and treats limits differently: it stops where the solution
meets or leaves a limit (by root finding on its own interpolant). Between these events a held quantity has zero rate
and a free one is not limited; the solver never integrates over a jump.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from hydro_env.errors import InvalidStateError
from hydro_env.plant.arrays import functions_of
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.valve import spool_pull
from hydro_env.plant.states import STATE_NAMES, VAPOUR_PRESSURE, Structure, state_kind, typical_sizes
from hydro_env.types import Floats

_SPOOL, _SPOOL_VELOCITY = (STATE_NAMES.index(name) for name in ("spool_position", "spool_velocity"))

_NEAR = 1e-12  # relative distance from a limit within which a state counts as on it
_OFF = 1e-10  # relative distance from a limit just left, so that it is not met again immediately

_MOST_EVENTS = 100


class Held(NamedTuple):
    """Which limits hold: −1, 0 (free) or 1 by side for the spool, 0 or 1 for each pressure that cavitates."""

    slew: int
    stroke: int
    vapour: tuple[int, ...]

    @property
    def sides(self) -> tuple[int, ...]:
        """Of all limits."""
        return self.slew, self.stroke, *self.vapour


def reference_states(
    start: Floats, coefficients: Floats, inputs: Floats, sample_time: float, tolerance: float, structure: Structure
) -> Floats:
    """States (n + 1, states) from the one at the start (states,) on, after every sample of held voltages (n,), V.

    The absolute tolerance is the relative one times the states' typical size.

    Raises:
        InvalidStateError: the solver failed.
    """
    plant = _Plant(coefficients, structure)
    of_axis = functions_of(structure)
    states = np.tile(start, (len(inputs) + 1, 1))
    for sample, voltage in enumerate(inputs):
        state, time = of_axis.command_changed(states[sample], coefficients, voltage), 0.0
        for _ in range(_MOST_EVENTS):
            held = plant.held(state, voltage)
            solution = solve_ivp(
                lambda _, y, u=voltage, held=held: plant.rate(y, u, held),
                (time, sample_time),
                state,
                method="Radau",
                rtol=tolerance,
                atol=tolerance * plant.typical,
                events=plant.events(voltage, held),
            )
            if not solution.success:
                when = sample * sample_time + time
                raise InvalidStateError(f"the reference solver failed at t = {when:g} s: {solution.message}")
            state, time = of_axis.hold_limits(solution.y[:, -1], coefficients), solution.t[-1]
            if time >= sample_time:
                break
            state = plant.put_on_limit(state, np.flatnonzero([len(times) for times in solution.t_events]), held)
        else:
            raise InvalidStateError(f"the reference solver met more than {_MOST_EVENTS} limits in one sample")
        states[sample + 1] = state
    return states


class _Plant:
    """Plant whose limits the integrator switches on and off."""

    def __init__(self, coefficients: Floats, structure: Structure) -> None:
        names = state_kind(structure)._fields
        self.kind, self.derivative = state_kind(structure), functions_of(structure).derivative
        self.typical = typical_sizes(names)
        self.pressures = [row for row, name in enumerate(names) if "pressure" in name and name != "supply_pressure"]
        self.rows = [_SPOOL_VELOCITY, _SPOOL, *self.pressures]  # the state of each limit, as in Held.sides
        self.limits = Coefficients(*coefficients)
        self.free = np.array(self.limits._replace(slew_limit=1e30))

    def free_rate(self, y: Floats, voltage: float) -> Floats:
        """The derivative without limits."""
        rate = self.derivative(y, self.free, voltage)
        if abs(y[_SPOOL]) >= 1.0:
            rate[_SPOOL] = y[_SPOOL_VELOCITY]
            rate[_SPOOL_VELOCITY] = spool_pull(self.kind(*y), self.limits)
        for row in self.pressures:
            if y[row] <= VAPOUR_PRESSURE:  # the rate without cavitation
                above = y.copy()
                above[row] = VAPOUR_PRESSURE + 1.0
                rate[row] = self.derivative(above, self.free, voltage)[row]
        return rate

    def held(self, y: Floats, voltage: float) -> Held:
        """The limits that hold a state: it has reached them and its rate points beyond them."""
        rate = self.free_rate(y, voltage)
        vapour = tuple(y[row] <= VAPOUR_PRESSURE * (1.0 - _NEAR) and rate[row] < 0.0 for row in self.pressures)
        slew = stroke = 0
        if self.limits.ideal_spool:  # it always equals the command
            return Held(slew, stroke, vapour)
        if abs(y[_SPOOL_VELOCITY]) >= self.limits.slew_limit * (1.0 - _NEAR):
            side = np.sign(y[_SPOOL_VELOCITY])
            slew = side if side * rate[_SPOOL_VELOCITY] > 0.0 else 0
        if abs(y[_SPOOL]) >= 1.0 - _NEAR:
            side = np.sign(y[_SPOOL])
            stroke = side if side * y[_SPOOL_VELOCITY] > 0.0 else 0
        return Held(slew, stroke, vapour)

    def rate(self, y: Floats, voltage: float, held: Held) -> Floats:
        """The derivative with the active limits."""
        rate = self.free_rate(y, voltage)
        for row, holds in zip(self.rows, held.sides, strict=True):
            if holds or (self.limits.ideal_spool and row in (_SPOOL, _SPOOL_VELOCITY)):
                rate[row] = 0.0
        return rate

    def events(self, voltage: float, held: Held) -> list[Any]:
        """Functions that fall through zero where a state meets or leaves a limit; order of :class:`Held`."""
        c = self.limits

        def slew(_: float, y: Floats) -> float:
            if held.slew:
                return held.slew * self.free_rate(y, voltage)[_SPOOL_VELOCITY] / c.spool_stiffness
            return 1.0 + c.ideal_spool - abs(y[_SPOOL_VELOCITY]) / c.slew_limit

        def stroke(_: float, y: Floats) -> float:
            if held.stroke:
                return held.stroke * y[_SPOOL_VELOCITY] / c.slew_limit
            return 1.0 + c.ideal_spool - abs(y[_SPOOL])

        def vapour(row: int, holds: int) -> Any:
            def distance(_: float, y: Floats) -> float:
                if holds:
                    return -self.free_rate(y, voltage)[row] / c.bulk_modulus
                return (y[row] - VAPOUR_PRESSURE) / c.relief_pressure

            return distance

        functions = [slew, stroke, *map(vapour, self.pressures, held.vapour)]
        for function in functions:
            function.terminal, function.direction = True, -1.0
        return functions

    def put_on_limit(self, y: Floats, met: NDArray[np.intp], held: Held) -> Floats:
        """The state moved exactly onto the limits that it has just met, and slightly off those that it has left."""
        y = y.copy()
        limits = [self.limits.slew_limit, 1.0, *[abs(VAPOUR_PRESSURE)] * len(self.pressures)]
        for event in met:
            row = self.rows[event]
            y[row] = np.sign(y[row]) * limits[event] * (1.0 - _OFF if held.sides[event] else 1.0)
        return y
