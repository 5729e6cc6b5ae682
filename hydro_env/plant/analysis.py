"""What an engineer computes by hand: natural frequency, damping, speed and force limits, the terms of dF/dt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.plant.arrays import TYPICAL_SIZE, coefficient_array, derivative_array, equilibrium
from hydro_env.plant.equations import (
    STATE_NAMES,
    Coefficients,
    State,
    edge_flows,
    external_leakage,
    fastest_rate,
    internal_leakage,
    pressure_rate,
)
from hydro_env.plant.parameters import PlantParameters
from hydro_env.plant.simulate import Trajectory
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

Array = NDArray[np.float64]

AXIS_STATES = ("position", "velocity", "pressure_a", "pressure_b", "supply_pressure")
"""The states of the axis without its valve."""


class ChamberVolumes(NamedTuple):
    """Oil volumes of the two chambers with their dead volumes, m³."""

    a: float
    b: float


def chamber_volumes(parameters: PlantParameters, position: float = 0.0) -> ChamberVolumes:
    """Oil in both chambers at a position (m): V_a0 + A_a x and V_b0 − A_b x (8), (9)."""
    c = Coefficients(*coefficient_array(parameters))
    return ChamberVolumes(c.volume_a0 + c.area_a * position, c.volume_b0 - c.area_b * position)


def closed_port_stiffness(parameters: PlantParameters, position: float = 0.0) -> float:
    """Stiffness in N/m of both closed oil columns and the spring: β (A_a²/V_a + A_b²/V_b) + k (Merritt 1967).

    β is that of oil without free air. Holds for short times: over long ones the seal and the valve let oil pass.
    """
    c = Coefficients(*coefficient_array(parameters))
    volumes = chamber_volumes(parameters, position)
    return float(
        c.bulk_modulus * (c.area_a**2 / volumes.a + c.area_b**2 / volumes.b) + c.spring_stiffness,
    )


def softest_position(parameters: PlantParameters) -> float:
    """Position in m where the natural frequency with closed ports is lowest (Jelali & Kroll 2003).

    There A_a³/V_a² = A_b³/V_b²; the end of the stroke where that lies outside.
    """
    c = Coefficients(*coefficient_array(parameters))
    ratio = (c.area_a / c.area_b) ** 1.5
    position = (ratio * c.volume_b0 - c.volume_a0) / (c.area_a + ratio * c.area_b)
    return float(min(max(position, -c.end_stop_position), c.end_stop_position))


def leak_at_test_pressure(parameters: PlantParameters) -> float:
    """Internal leakage in l/min at 100 bar across the piston: seal and throttle together."""
    c = Coefficients(*coefficient_array(parameters))
    at = State(0.0, 0.0, LEAKAGE_TEST_PRESSURE, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    return float(internal_leakage(at, c)) / LITRE_PER_MINUTE


class ForceLimits(NamedTuple):
    """Largest steady forces on the load at full pressure, N; positive where the supply pushes that way."""

    extending: float
    retracting: float


def force_limits(parameters: PlantParameters) -> ForceLimits:
    """P_s A_a − P_T A_b extending and P_s A_b − P_T A_a retracting, in N, less the external force."""
    c = Coefficients(*coefficient_array(parameters))
    return ForceLimits(
        float(c.area_a * c.relief_pressure - c.area_b * c.tank_pressure - c.external_force),
        float(c.area_b * c.relief_pressure - c.area_a * c.tank_pressure + c.external_force),
    )


def closed_port_natural_frequency(parameters: PlantParameters, position: float = 0.0) -> float:
    """Natural frequency in rad/s of the mass on the two closed oil columns and the spring (Merritt 1967).

    ω = √((β (A_a²/V_a + A_b²/V_b) + k) / (M + m_d)); β is that of oil without free air. Does not depend on leakage.
    """
    c = Coefficients(*coefficient_array(parameters))
    return math.sqrt(closed_port_stiffness(parameters, position) * c.inverse_mass)


class SpeedLimits(NamedTuple):
    """Steady speeds at full valve opening, m/s, both positive; 0 where the force does not suffice."""

    extending: float
    retracting: float


def speed_limits(parameters: PlantParameters, force: float = 0.0) -> SpeedLimits:
    """Steady speed at ±10 V against a constant force (N, positive against extension).

    From the flow law on both edges and the balance of forces, without leakage:
    v = K √((A_a P_s − A_b P_T − F)/(A_a³ + A_b³)) extending, and with A_b P_s − A_a P_T + F retracting.
    """
    c = Coefficients(*coefficient_array(parameters))
    cubes = c.area_a**3 + c.area_b**3
    out = c.area_a * c.relief_pressure - c.area_b * c.tank_pressure - force
    back = c.area_b * c.relief_pressure - c.area_a * c.tank_pressure + force
    return SpeedLimits(c.edge_gain * math.sqrt(max(out, 0.0) / cubes), c.edge_gain * math.sqrt(max(back, 0.0) / cubes))


def reachable_range(parameters: PlantParameters) -> tuple[float, float]:
    """Lowest and highest position in m that the supply can hold against spring and external force."""
    c = Coefficients(*coefficient_array(parameters))
    out, back = force_limits(parameters)
    stop = c.end_stop_position
    if c.spring_stiffness == 0.0:
        return (-stop if back > 0 else stop), (stop if out > 0 else -stop)
    return max(-back / c.spring_stiffness, -stop), min(out / c.spring_stiffness, stop)


class Mode(NamedTuple):
    """One eigenvalue, or a complex pair, of the linearised axis."""

    natural_frequency: float  # rad/s
    damping_ratio: float
    eigenvalue: complex


@dataclass(frozen=True)
class Linearisation:
    """d(state)/dt = A (state − state_0) + B (voltage − voltage_0), states in the order of STATE_NAMES."""

    a: Array  # (10, 10)
    b: Array  # (10,)
    state: Array  # (10,)
    voltage: float

    @property
    def modes(self) -> list[Mode]:
        """Modes by rising natural frequency; complex pairs appear once."""
        values = [complex(value) for value in np.linalg.eigvals(self.a) if value.imag >= 0]
        modes = [Mode(abs(v), -v.real / abs(v) if abs(v) > 0 else 1.0, v) for v in values]
        return sorted(modes, key=lambda mode: mode.natural_frequency)

    @property
    def hydraulic_mode(self) -> Mode:
        """The oscillation of the mass on the oil columns: of position, velocity and pressures, the fastest pair.

        The axis does not act back on the valve, so that these states have eigenvalues of their own. Dry friction at
        standstill is part of the linearisation; the damping of a moving axis is that with ``friction.model: none``.

        Raises:
            ArithmeticError: no oscillation.
        """
        rows = [STATE_NAMES.index(name) for name in AXIS_STATES]
        values = np.linalg.eigvals(self.a[np.ix_(rows, rows)])
        pairs = [complex(value) for value in values if value.imag > 1e-3 * np.abs(values).max()]
        if not pairs:
            raise ArithmeticError("the linearised axis has no oscillation: it is overdamped here")
        best = max(pairs, key=abs)
        return Mode(abs(best), -best.real / abs(best), best)


def linearise(
    parameters: PlantParameters, state: State | Array | None = None, voltage: float | None = None, position: float = 0.0
) -> Linearisation:
    """Linearise the right-hand side by central differences.

    Args:
        parameters: the plant.
        state: where; ``None`` is the equilibrium at ``position`` (m).
        voltage: V; ``None`` is the one that holds the equilibrium (0 with a given state).
        position: m, used without ``state``.
    """
    if state is None:
        values, holding = equilibrium(parameters, position)
        at = np.array([values[name] for name in STATE_NAMES])
        voltage = holding if voltage is None else voltage
    else:
        at = np.asarray(state, dtype=np.float64)
        voltage = 0.0 if voltage is None else voltage
    c = coefficient_array(parameters)
    a = np.empty((len(at), len(at)))
    for column, size in enumerate(TYPICAL_SIZE):
        step = np.zeros(len(at))
        step[column] = 1e-6 * size
        a[:, column] = (derivative_array(at + step, c, voltage) - derivative_array(at - step, c, voltage)) / (
            2e-6 * size
        )
    b = (derivative_array(at, c, voltage + 1e-3) - derivative_array(at, c, voltage - 1e-3)) / 2e-3
    _make_ideal(parameters, a, b)
    return Linearisation(a, b, at, voltage)


IDEAL_RATE = 1e5
"""1/s; rate at which an ideal part of the valve follows in a linearisation, where it must have one."""


def _make_ideal(parameters: PlantParameters, a: Array, b: Array) -> None:
    """Give the ideal parts of the valve a lag of 10 µs in the matrices of a linearisation."""
    c = Coefficients(*coefficient_array(parameters))
    current_gain = c.drive_rate / c.coil_rate
    ideal = {"coil_current": current_gain} if c.ideal_drive else {}
    if c.ideal_spool:
        ideal |= {"spool_position": c.spool_gain * current_gain, "spool_velocity": 0.0}
    for name, gain in ideal.items():
        row = STATE_NAMES.index(name)
        a[row] = 0.0
        a[row, row] = -IDEAL_RATE
        b[row] = IDEAL_RATE * gain


class ForceRateTerms(NamedTuple):
    """The four terms of dF/dt in N/s (24), F = P_a A_a − P_b A_b; they add up to the total."""

    valve: Array
    motion: Array
    internal_leakage: Array
    external_leakage: Array


def force_rate_terms(trajectory: Trajectory) -> ForceRateTerms:
    """The four terms of (24), with the corrected volume of chamber b, along a trajectory; shapes (n + 1,)."""
    c = Coefficients(*coefficient_array(trajectory.parameters))
    rows = []
    for sample in trajectory.states:
        s = State(*sample)
        supply_to_a, a_to_tank, b_to_tank, supply_to_b = edge_flows(s, c)
        per_flow_a = c.area_a * pressure_rate(1.0, c.volume_a0 + c.area_a * s.position, s.pressure_a, c)
        per_flow_b = c.area_b * pressure_rate(1.0, c.volume_b0 - c.area_b * s.position, s.pressure_b, c)
        rows.append(
            (
                per_flow_a * (supply_to_a - a_to_tank) + per_flow_b * (b_to_tank - supply_to_b),
                -(per_flow_a * c.area_a + per_flow_b * c.area_b) * s.velocity,
                -(per_flow_a + per_flow_b) * internal_leakage(s, c),
                per_flow_b * external_leakage(s, c),
            )
        )
    return ForceRateTerms(*np.array(rows).T)


def fastest_eigenvalue(parameters: PlantParameters, state: State | Array, voltage: float = 0.0) -> float:
    """|λ| in 1/s of the fastest eigenvalue of the linearisation at a state; ideal parts of the valve have none."""
    found = np.abs(np.linalg.eigvals(linearise(parameters, state, voltage).a))
    return float(found[np.abs(found - IDEAL_RATE) > 1e-6 * IDEAL_RATE].max())


def fastest_rate_bound(parameters: PlantParameters, state: State | Array) -> float:
    """The estimate of |λ| in 1/s from which a rig is judged at a state."""
    return float(fastest_rate(State(*np.asarray(state)), Coefficients(*coefficient_array(parameters))))
