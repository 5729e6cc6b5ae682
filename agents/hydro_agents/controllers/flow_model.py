"""The flow of valve and chambers from the data sheet, at the measured pressures.

Sources: Merritt, *Hydraulic Control Systems* (1967), chapters 5 and 6: flow of the edges, stiffness of the oil columns,
speed at full opening. Jelali & Kroll, *Hydraulic Servo-systems* (2003), chapters 4 to 6: effective bulk modulus of oil
with air, inverse valve characteristic, exact linearisation.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from hydro_env import PlantParameters
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parts.load import holding_force
from hydro_env.plant.states import ATMOSPHERIC_PRESSURE
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

_LOWEST_DROP = 0.02  # least pressure drop over an edge, as a fraction of the supply: below, the opening would saturate
_SUPPLIES = (0.8, 1.5)  # range of the supply pressure, as fractions of the data sheet's


class Flow(NamedTuple):
    """Effect of the pressures of N axes on their motion, each (N,)."""

    extending: Floats  # speed per opening of the edges P→A and B→T, m/s
    retracting: Floats  # speed per opening of the edges A→T and P→B, m/s
    leak: Floats  # speed per leak conductance, m/s per m³/(s Pa)
    force: Floats  # of the oil on the piston, N
    stiffness: Floats  # of both oil columns, N/m


class FlowModel:
    """Speed of the piston from the opening of the valve, and the inverse; for N axes.

    In each chamber A v = q − C dp/dt with the compliance C = V/β of its oil. Weighted with A/C and added up, the
    pressures appear as the force of the oil alone: v = Σ (A/C) q / k − dF/dt / k, with k = Σ A²/C. The flow gains
    follow from the measured pressures. The model is therefore also valid while the pressures change, for example after
    a reversal of an unequal cylinder.
    """

    def __init__(self, plant: PlantParameters) -> None:
        self._c = c = plant_coefficients(plant)
        self._areas = np.array([[c.area_a], [c.area_b]])
        self._signs = np.array([[1.0], [-1.0]])
        self._volumes = np.array([[c.volume_a0], [c.volume_b0]])
        self._walls = np.array([[c.wall_compliance_a], [c.wall_compliance_b]])
        self._straight = c.overlap == 0.0 and c.slope_change == 0.0
        self._lowest = _LOWEST_DROP * (c.relief_pressure - c.tank_pressure)
        self._supplies = _SUPPLIES[0] * c.relief_pressure, _SUPPLIES[1] * c.relief_pressure
        self._full = c.edge_gain / math.sqrt(c.area_a**3 + c.area_b**3 / c.edge_ratio**2)

    def supply(self, pressures: Floats, speed: Floats) -> Floats:
        """Supply pressure (Pa), (N,), of axes with pressures (2, N) in Pa and speeds in m/s, (N,).

        At rest the valve holds both chambers with equal openings: P_s − p_a = p_b − P_T, for any internal leak. In
        motion the data sheet tells more. It also bounds the estimate.
        """
        at_rest = np.clip(pressures.sum(axis=0) - self._c.tank_pressure, *self._supplies)
        return np.where(speed == 0.0, at_rest, self._c.relief_pressure)

    def at(self, position: Floats, pressures: Floats, supply: Floats) -> Flow:
        """:class:`Flow` at positions (N,) in m, pressures (2, N) and supply pressures (N,) in Pa."""
        c = self._c
        absolute = np.maximum(pressures, 0.0) + ATMOSPHERIC_PRESSURE
        softness = 1.0 / c.bulk_modulus + c.free_air_pressure / (absolute * absolute)
        columns = self._areas / (softness * (self._volumes + self._signs * self._areas * position) + self._walls)
        stiffness = (self._areas * columns).sum(axis=0)
        shares = columns / stiffness
        filling = shares * np.sqrt(np.maximum(supply - pressures, self._lowest))
        emptying = shares * np.sqrt(np.maximum(pressures - c.tank_pressure, self._lowest))
        forces = self._areas * pressures
        return Flow(
            extending=c.edge_gain * (filling[0] + c.edge_ratio * emptying[1]),
            retracting=c.edge_gain * (emptying[0] + c.edge_ratio * filling[1]),
            leak=(shares[0] + shares[1]) * (pressures[1] - pressures[0]),
            force=forces[0] - forces[1],
            stiffness=stiffness,
        )

    def speed(self, spool: Floats, flow: Flow) -> Floats:
        """Speed (m/s) at a position of the spool (−1 to 1) without leak and at constant force, (N,)."""
        forward, backward = self._edges(spool)
        speed = flow.extending * forward - flow.retracting * backward
        return speed

    def _edges(self, spool: Floats) -> tuple[Floats, Floats]:
        """Openings of the edges P→A and B→T, and of A→T and P→B, each (N,)."""
        opening = spool - self._c.null_shift
        if not self._straight:
            return _edge_opening(opening, self._c), _edge_opening(-opening, self._c)
        width = np.sqrt(opening * opening + self._c.underlap_squared)
        return 0.5 * (width + opening), 0.5 * (width - opening)

    def opening(self, speed: Floats, flow: Flow) -> Floats:
        """Position of the spool that gives a speed (m/s): the inverse of :meth:`speed`, (N,)."""
        root = np.sqrt(speed * speed + self._c.underlap_squared * flow.extending * flow.retracting)
        opening = 0.5 * ((speed + root) / flow.extending + (speed - root) / flow.retracting)
        if not self._straight:
            opening = _stroke_of(opening, self._c)
        return opening + self._c.null_shift

    def voltage_at_rest(self, position: Floats, pressure_a: Any = None, pressure_b: Any = None) -> Any:
        """Voltage (V) at which no oil moves the piston, (), at the measured pressures (Pa); else at the rig's own load.

        The valve holds both chambers with equal openings: the pressures add up to those of supply and tank.
        """
        c = self._c
        if pressure_a is None or pressure_b is None:
            total = c.relief_pressure + c.tank_pressure
            force = holding_force.py_func(position, c)  # type: ignore[attr-defined]
            force = np.clip(force, -c.area_b * total, c.area_a * total)
            pressure_a = (force + c.area_b * total) / (c.area_a + c.area_b)
            pressure_b = total - pressure_a
        pressures, speed = np.stack([pressure_a, pressure_b])[:, None], np.zeros(1)
        flow = self.at(position, pressures, self.supply(pressures, speed))
        voltage_at_rest = FULL_VOLTAGE * self.opening(speed, flow)[0]
        return voltage_at_rest

    def full_speeds(self, force: Floats, supply: Floats) -> tuple[Floats, Floats]:
        """Steady speeds (m/s) at full opening against a force of the load (N), extending and retracting, each (N,)."""
        c = self._c
        out = c.area_a * supply - c.area_b * c.tank_pressure - force
        back = c.area_b * supply - c.area_a * c.tank_pressure + force
        least = self._lowest * (c.area_a + c.area_b)
        return self._full * np.sqrt(np.maximum(out, least)), self._full * np.sqrt(np.maximum(back, least))


def _edge_opening(stroke: Floats, c: Any) -> Floats:
    """Opening of an edge whose land has moved by ``stroke`` from the null; as in ``plant/parts/valve.py``."""
    beyond = (stroke - c.overlap) * c.stroke_factor
    opening = 0.5 * (np.sqrt(beyond * beyond + c.underlap_squared) + beyond)
    return c.slope * opening + c.slope_change * np.maximum(beyond - c.knee_position, 0.0)


def _stroke_of(opening: Floats, c: Any) -> Floats:
    """Stroke of the spool that gives a bent, overlapped edge the opening of a straight one without overlap.

    The dead band is crossed gradually within the underlap; the command for zero flow therefore does not jump.
    """
    size = np.abs(opening)
    at_knee = c.slope * c.knee_position
    beyond = np.where(size > at_knee, c.knee_position + (size - at_knee) / (c.slope + c.slope_change), size / c.slope)
    return np.sign(opening) * beyond / c.stroke_factor + c.overlap * opening / np.sqrt(
        opening * opening + c.underlap_squared + 1e-12
    )
