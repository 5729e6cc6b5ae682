"""The sampled position loop around the linearised axis: its largest stable proportional gain, its stiffness."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from hydro_env import HydroError, PlantParameters, linearise
from hydro_env.plant.analysis import reachable_range
from hydro_env.plant.states import typical_sizes
from hydro_env.task.paces import periods_late
from hydro_env.types import Array, Floats
from hydro_env.units import FULL_VOLTAGE

CONTROL_PERIOD = 5e-3  # s

COMMAND_LATENCY = 1e-3  # s, from sampling to the new command

REACH_SHARE = 0.9  # share of the reachable range over which a position loop is examined
PLACES = 9  # number of positions at which it is examined there
_NEUTRAL = 1e-7  # excess of a spectral radius over 1 that is treated as rounding


@dataclass(frozen=True)
class SampledLoop:
    """Linearised axis and valve, sampled; the control law is command = −gain · (position − set point).

    In each period the previous command is held during the latency and the new one during the rest. Hence
    x[n+1] = Φ x[n] + Γ_old u[n−1−late] + Γ_new u[n−late] is exact for the linear plant; ``late`` counts the whole
    periods of a latency above one. States are scaled by their typical size.
    """

    transition: Floats  # Φ, (n, n)
    input_old: Floats  # Γ_old, (n,), per command
    input_new: Floats  # Γ_new, (n,), per command
    a: Floats  # of the continuous plant, (n, n), 1/s
    b: Floats  # (n,), per command
    force: Floats  # (n,), per newton of external force
    position_size: float  # m
    control_period: float  # s
    late: int = 0  # whole periods

    def closed(self, gain: complex | Array) -> Array:
        """Transition matrix of one period with the loop closed, (..., n + 1 + late, n + 1 + late).

        It holds the states and the last commands, newest first. A complex gain turns the phase of the loop at every
        frequency alike.
        """
        n, feedback = len(self.input_new), -np.asarray(gain) * self.position_size
        size = n + 1 + self.late
        matrix = np.zeros((*feedback.shape, size, size), feedback.dtype)
        matrix[..., :n, :n] = self.transition
        matrix[..., :n, -1] = self.input_old
        if self.late:
            matrix[..., :n, -2] = self.input_new
            matrix[..., range(n + 1, size), range(n, size - 1)] = 1.0
        else:
            matrix[..., :n, 0] += self.input_new * feedback[..., None]
        matrix[..., n, 0] = feedback
        return matrix

    def spectral_radius(self, gain: complex) -> float:
        """Largest |z| of the closed loop; above 1 the loop is unstable."""
        return np.abs(np.linalg.eigvals(self.closed(gain))).max()

    def is_stable(self, gain: float) -> bool:
        """Whether the closed loop is stable; rounding at the limit counts as stable."""
        return self.spectral_radius(gain) <= 1.0 + _NEUTRAL

    def _first_unstable(self, gains: Array) -> int | None:
        """Index of the first of some gains with which the closed loop is unstable."""
        unstable = np.flatnonzero(np.abs(np.linalg.eigvals(self.closed(gains))).max(axis=-1) > 1.0 + _NEUTRAL)
        return unstable[0] if len(unstable) else None

    def largest_stable_gain(self, limit: float = 1e6) -> float:
        """Gain in command per metre (1 = 10 V) at which an eigenvalue of the closed loop leaves the unit circle.

        It is 0 if the axis is unstable in open loop, and infinite if no gain up to a limit per metre makes it unstable.
        """
        gains = np.geomspace(1e-2, 1e6, 161)
        gains = np.append(gains[gains < limit], limit)
        first = self._first_unstable(gains)
        if first is None:
            return np.inf
        if first == 0:
            return 0.0
        low, high = gains[first - 1], gains[first]
        while high / low > 1.0 + 1e-9:
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self.is_stable(middle) else (low, middle)
        return low

    def phase_margin(self, gain: float) -> float:
        """Least phase in degrees, lag or lead, that makes the closed loop unstable; infinite if none does."""
        angles = np.arange(0.0, 180.5, 0.5)
        first = self._first_unstable(gain * np.exp(-1j * np.radians(angles)))
        return np.inf if first is None else angles[max(first - 1, 0)]

    def frequency_response(self, frequencies: Floats) -> Array:
        """Response of the position to the command at frequencies in Hz, (n,) → m per command (1 = 10 V), (n,)."""
        z = np.exp(2j * np.pi * self.control_period * np.asarray(frequencies))[:, None]
        inputs = z**-self.late * (self.input_new + self.input_old / z)
        matrix = z[..., None] * np.eye(len(self.transition)) - self.transition
        return self.position_size * np.linalg.solve(matrix, inputs[..., None])[:, 0, 0]

    def step_response(self, gain: float, periods: int) -> Floats:
        """Position after a step of the set point by 1 at the first of some periods, (periods,)."""
        matrix, count = self.closed(gain), len(self.input_new)
        given = np.zeros(len(matrix))
        given[count] = gain
        if not self.late:
            given[:count] = gain * self.input_new
        state, positions = np.zeros(len(matrix)), np.zeros(periods)
        for n in range(1, periods):
            state = matrix @ state + given
            positions[n] = self.position_size * state[0]
        return positions

    def static_stiffness(self, gain: float) -> float:
        """Constant external force per steady-state position error, N/m, with the loop closed; inf without an error."""
        matrix = self.a.copy()
        matrix[:, 0] -= gain * self.position_size * self.b
        answer, *_ = np.linalg.lstsq(matrix, -self.force, rcond=1e-15)
        compliance = -answer[0] * self.position_size
        return 1.0 / compliance if compliance > 1e-12 else np.inf


def sampled_loop(
    parameters: PlantParameters,
    position: float = 0.0,
    control_period: float = CONTROL_PERIOD,
    latency: float = COMMAND_LATENCY,
) -> SampledLoop:
    """Linearise at rest and sample exactly (zero-order hold with latency; Åström & Wittenmark 1997, section 2.3).

    The linearisation omits dry friction, which blocks an axis at rest and hardly damps a moving one. The closed valve
    is the worst case, because every opening adds damping. The position at rest is in m, times are in s.

    Raises:
        HydroError: the position cannot be held, or period and latency do not fit.
    """
    if not 0.0 < control_period < np.inf:
        raise HydroError(f"control_period = {control_period} s: must be positive")
    if not 0.0 <= latency < np.inf:
        raise HydroError(f"latency = {latency} s: must not be negative")
    plant = linearise(parameters.replace(friction={"model": "none"}), position=position)
    active = plant.active_states  # any other state would add a pole at z = 1
    rows, size = [plant.names.index(name) for name in active], typical_sizes(active)
    a = plant.a[np.ix_(rows, rows)] * size / size[:, None]
    b = FULL_VOLTAGE * plant.b[rows] / size
    force = plant.force[rows] / size
    late = periods_late(latency, control_period)
    within = min(latency - late * control_period, control_period)
    first, held_first = zero_order_hold(a, b, within)
    rest, held_rest = zero_order_hold(a, b, control_period - within)
    held = rest @ first, rest @ held_first, held_rest
    return SampledLoop(*held, a, b, force, size[0], control_period, late)


def places_in_reach(parameters: PlantParameters) -> list[float]:
    """Positions in m at which a loop is examined, evenly over 0.9 of the reachable range, ends included."""
    low, high = (REACH_SHARE * end for end in reachable_range(parameters))
    return [low + part * (high - low) / (PLACES - 1) for part in range(PLACES)]


def zero_order_hold(a: Floats, b: Floats, duration: float) -> tuple[Floats, Floats]:
    """exp(A t) and ∫₀ᵗ exp(A s) ds B from one matrix exponential (Van Loan 1978)."""
    n = len(b)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n] = a
    block[:n, n] = b
    exponential = expm(block * duration)
    return exponential[:n, :n], exponential[:n, n]
