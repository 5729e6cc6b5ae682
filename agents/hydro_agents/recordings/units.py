"""Units of recordings and their size in SI units."""

from __future__ import annotations

from hydro_env import ConfigurationError
from hydro_env.units import FULL_VOLTAGE, unit_factor
from hydro_env.units import UNITS as QUANTITIES

_PARTS = {"V": 1.0 / FULL_VOLTAGE, "%": 1e-2, "1": 1.0, "-": 1.0, "mV": 1e-3 / FULL_VOLTAGE}

UNITS: dict[str, dict[str, float]] = {
    "time": QUANTITIES["s"],
    "position": QUANTITIES["m"],
    "pressure_a": QUANTITIES["Pa"],
    "pressure_b": QUANTITIES["Pa"],
    "spool_position": _PARTS,
    "command": _PARTS,
}
"""SI units per unit, by signal; command and spool are fractions of full scale. Pressures are gauge pressures.

The usual units come first.
"""


def factor(signal: str, unit: str, place: str) -> float:
    """SI units per ``unit`` of a signal.

    Args:
        signal: a key of :data:`UNITS`.
        unit: one of its units; ``μ`` (Greek) and ``µ`` (micro) are the same.
        place: for the message.

    Raises:
        ConfigurationError: the signal is not measured in this unit.
    """
    try:
        return unit_factor(unit, UNITS[signal])
    except ValueError as error:
        raise ConfigurationError(f"{place}: {error}") from None
