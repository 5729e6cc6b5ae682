"""Flow law of the nominal valve at the measured pressures: speed of an opening, opening of a speed.

Sources: Merritt, *Hydraulic Control Systems* (1967), chapter 5: flow of the edges; Jelali & Kroll, *Hydraulic
Servo-systems* (2003), chapter 6: inverse of the valve's characteristic.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import PlantParameters

Array = NDArray[np.float64]

LOWEST_DROP = 0.02
"""Lowest pressure drop over an edge, in parts of the supply pressure; it keeps openings finite."""


class ValveFlow:
    """Flow law of the nominal rig.

    The speed of an opening is the one at which the force of the oil stays constant: the flows of both chambers,
    weighted by the stiffness of their oil columns at mid-stroke.

    Args:
        plant: the nominal rig.
        pressure_trust: exponent on the flow gain at the measured pressures over the nominal one; 1 trusts the
            pressures, 0 leaves them out.
    """

    def __init__(self, plant: PlantParameters, pressure_trust: float = 1.0) -> None:
        c = plant_coefficients(plant)
        column_a, column_b = c.area_a / c.volume_a0, c.area_b / c.volume_b0
        stiffness = c.area_a * column_a + c.area_b * column_b
        self._area_a, self._area_b, self._tank = c.area_a, c.area_b, c.tank_pressure
        self._share_a, self._share_b = (c.edge_gain * column / stiffness for column in (column_a, column_b))
        drop = c.relief_pressure - c.tank_pressure
        self._lowest = LOWEST_DROP * drop
        self._nominal = (self._share_a + self._share_b) * float(np.sqrt(0.5 * drop))
        self._trust = pressure_trust
        self._underlap_squared = c.underlap_squared

    def supply_at_rest(self, pressure_a: Array, pressure_b: Array) -> Array:
        """Supply pressure in Pa of an axis at rest: both chambers have the same drop to one of supply and tank."""
        supply: Array = pressure_a + pressure_b - self._tank
        return supply

    def force(self, pressure_a: Array, pressure_b: Array) -> Array:
        """Force of the oil on the piston, N."""
        force: Array = self._area_a * pressure_a - self._area_b * pressure_b
        return force

    def gains(self, pressure_a: Array, pressure_b: Array, supply: Array) -> Array:
        """Speeds in m/s at full opening, extending and retracting, (2, N), at pressures in Pa, each (N,)."""
        extending = self._share_a * self._root(supply - pressure_a) + self._share_b * self._root(
            pressure_b - self._tank
        )
        retracting = self._share_a * self._root(pressure_a - self._tank) + self._share_b * self._root(
            supply - pressure_b
        )
        gains: Array = self._nominal * (np.stack([extending, retracting]) / self._nominal) ** self._trust
        return gains

    def speed(self, opening: Array, gains: Array) -> Array:
        """Speed in m/s, (N,) or (M, N), of openings, 1 = full; near the centre all edges are open (underlap)."""
        width = np.sqrt(opening * opening + self._underlap_squared)
        speed: Array = 0.5 * (gains[0] * (width + opening) - gains[1] * (width - opening))
        return speed

    def opening(self, speed: Array, gains: Array) -> Array:
        """Opening, 1 = full, (N,), that gives a speed in m/s: the inverse of :meth:`speed`."""
        root = np.sqrt(speed * speed + self._underlap_squared * gains[0] * gains[1])
        opening: Array = 0.5 * ((root + speed) / gains[0] - (root - speed) / gains[1])
        return opening

    def _root(self, drop: Array) -> Array:
        root: Array = np.sqrt(np.maximum(drop, self._lowest))
        return root
