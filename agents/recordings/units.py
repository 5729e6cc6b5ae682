"""Units of recordings: how many SI units one of them is."""

from __future__ import annotations

from hydro_env import ConfigurationError
from hydro_env.units import FULL_VOLTAGE

_PARTS = {"V": 1.0 / FULL_VOLTAGE, "%": 1e-2, "1": 1.0, "-": 1.0, "mV": 1e-3 / FULL_VOLTAGE}

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "position": {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 0.0254, "um": 1e-6, "µm": 1e-6},
    "pressure_a": {"bar": 1e5, "MPa": 1e6, "psi": 6894.757293168, "kPa": 1e3, "Pa": 1.0, "mbar": 1e2},
    "spool_position": _PARTS,
    "command": _PARTS,
}
"""SI units per unit, by signal; the command and the spool are in parts of full scale. Pressures are gauge pressures.

The usual units come first.
"""

UNITS["pressure_b"] = UNITS["pressure_a"]


def factor(signal: str, unit: str, place: str) -> float:
    """SI units per ``unit`` of a signal.

    Args:
        signal: a key of :data:`UNITS`.
        unit: one of its units; ``μ`` (Greek) and ``µ`` (micro) are the same.
        place: for the message.

    Raises:
        ConfigurationError: the signal is not measured in this unit.
    """
    known = UNITS[signal]
    wanted = unit.strip().replace("μ", "µ")
    if wanted not in known:
        raise ConfigurationError(f"{place}: unit '{unit[:40]}': must be one of {', '.join(known)}")
    return known[wanted]
