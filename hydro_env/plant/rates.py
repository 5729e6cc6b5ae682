"""Upper estimates of how fast the parts of an axis act; they give a stable inner step."""

from __future__ import annotations

import math
from typing import NamedTuple

from hydro_env.compiling import inline
from hydro_env.plant.parts.chambers import smallest_volumes
from hydro_env.plant.parts.friction import friction_rate
from hydro_env.plant.parts.leakage import internal_leakage_slope
from hydro_env.plant.parts.load import end_stop_rate, oil_column_rate
from hydro_env.plant.parts.supply import supply_line_rate
from hydro_env.plant.parts.valve import valve_rate


class Rates(NamedTuple):
    """Upper estimates of the rates |λ| in 1/s of the parts of the axis."""

    chamber_a: float  # an edge or a leak relaxes chamber a
    chamber_b: float  # and chamber b
    friction: float  # friction within its transition velocity, and viscous damping
    oil_column: float  # oil column and spring against the mass
    end_stop: float
    valve: float  # spool and coil
    supply_line: float  # pump and relief valve on the oil in the line


@inline
def rates(s, c):
    """:class:`Rates` near a state: slope of S at zero drop, edges fully open, oil without air."""
    volume_a, volume_b = smallest_volumes(s.position, c)
    slope = 1.0 / math.sqrt(math.sqrt(c.transition_squared))
    leak = internal_leakage_slope(slope, c)
    return Rates(
        chamber_a=c.bulk_modulus / volume_a * (c.edge_gain * slope + leak),
        chamber_b=c.bulk_modulus / volume_b * (c.edge_ratio * c.edge_gain * slope + leak + c.external_conductance),
        friction=friction_rate(s, c),
        oil_column=oil_column_rate(volume_a, volume_b, c),
        end_stop=end_stop_rate(c),
        valve=valve_rate(c),
        supply_line=supply_line_rate(max(1.0, c.edge_ratio) * c.edge_gain * slope, c),
    )
