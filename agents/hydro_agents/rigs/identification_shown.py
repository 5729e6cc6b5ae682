"""Names, units and numbers of the unknowns for readers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_agents.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, LEAKAGE
from hydro_agents.running.text import decimals_for, number
from hydro_env import PlantParameters
from hydro_env.units import UNITS

READ_IN = {"Pa": "bar", "m³/s": "l/min", "m": "mm", "m³": "cm³", "rad/s": "Hz", "m/s": "mm/s"}
"""Unit in which a person reads a quantity, by its SI unit."""

SHARES = ("overlap", "underlap", "null_shift", "air_fraction")
"""Fields without a unit that data sheets give in per cent."""

_BIAS_UNITS = {"position": (1e3, "mm"), "spool_position": (100.0, "%")}


class Shown(NamedTuple):
    """Display of an unknown: name, factor, unit."""

    words: str
    factor: float
    unit: str

    def span(self, low: float, high: float) -> str:
        """Two values with enough digits to distinguish them."""
        low, high = self.factor * low, self.factor * high
        # Two digits of their difference; a range of zero width gets four digits of its value.
        difference = abs(high - low)
        decimals = decimals_for(difference, 2) if difference > 0.0 and np.isfinite(difference) else None
        return f"{number(low, decimals, 4)} to {number(high, decimals, 4)}"

    def value(self, value: float, uncertainty: float) -> str:
        """A value with the digits that its uncertainty allows; both in the unknown's unit."""
        size = self.factor * uncertainty
        decimals = decimals_for(size, 2) if size > 0.0 and np.isfinite(size) else None
        return number(self.factor * value, decimals, 4)


def reading_unit(path: str, plant: PlantParameters) -> tuple[float, str]:
    """SI per unit, and the unit, in which a person reads a number of the rig: that of data sheets."""
    group, field = path.split(".")
    schema = type(getattr(plant, group)).model_fields[field].json_schema_extra
    si = str(schema.get("unit", "")) if isinstance(schema, dict) else ""
    unit = "%" if field in SHARES else "GPa" if field.endswith("bulk_modulus") else READ_IN.get(si, si)
    return UNITS.get(si, {}).get(unit, 1.0), unit


def shown(name: str, plant: PlantParameters) -> Shown:
    """Display of an unknown of :mod:`hydro_agents.estimation.unknowns`."""
    if name == LEAKAGE:
        return Shown("leak past the piston", 1.0, "l/min at 100 bar")
    if name == EXTERNAL_LEAKAGE:
        return Shown("leak past the rod seal", 1.0, "l/min at 100 bar")
    if name in BIASES:
        channel = name.removesuffix("_bias")
        factor, unit = _BIAS_UNITS.get(channel, (1e-5, "bar"))
        return Shown(f"offset of the sensor: {channel.replace('_', ' ')}", factor, unit)
    group, field = name.split(".")
    size, unit = reading_unit(name, plant)
    return Shown(f"{group}: {field.replace('_', ' ')}", 1.0 / size, unit)


def share_in_words(share: float) -> str:
    """A share of variance as text; a simulation with errors larger than the signal's variation explains nothing."""
    return f"{100 * share:.2f} %" if share > 0.0 else "nothing"
