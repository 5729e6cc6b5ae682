"""Files of tuned gains: each gain with its unit, and as an engineer enters it in a PLC."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import yaml

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, read_yaml
from hydro_env.units import FULL_VOLTAGE

GAINS_FILE = "gains.yaml"

MILLIMETRE = 1e-3

PRACTICE = {
    "1/m": (FULL_VOLTAGE * MILLIMETRE, "V/mm"),
    "1/(m s)": (FULL_VOLTAGE * MILLIMETRE, "V/(mm s)"),
    "s/m": (FULL_VOLTAGE, "V/(m/s)"),
    "s": (1e3, "ms"),
}
"""Factor and unit in which a PLC takes a gain, by its own unit; a command of 1 is 10 V."""


class GainRow(NamedTuple):
    """One gain as a person reads it."""

    name: str
    value: Any  # in its own unit
    in_practice: str  # "0.199 V/mm", or empty if its own unit is the usual one
    meaning: str


def gain_rows(gains: Group) -> list[GainRow]:
    """The gains of a controller, in the order of their class."""
    rows = []
    for name, field in type(gains).model_fields.items():
        extra = field.json_schema_extra
        unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
        value = getattr(gains, name)
        factor, practical = PRACTICE.get(unit, (0.0, ""))
        in_practice = f"{factor * value:.4g} {practical}" if practical else ""
        meaning = str(field.description or "")
        rows.append(GainRow(name, value, in_practice, meaning.removeprefix(f"{unit}; ") if practical else meaning))
    return rows


def gains_text(gains: Group) -> str:
    """The gains as YAML; a comment beside each tells it in the units of a PLC, and what it does."""
    lines = ["# A command of 1 is 10 V; lengths in m, times in s. Beside each gain: the same for a PLC."]
    for row in gain_rows(gains):
        entry = yaml.safe_dump({row.name: row.value}).strip()
        lines.append(f"{entry}  # {', '.join(part for part in (row.in_practice, row.meaning) if part)}")
    return "\n".join(lines) + "\n"


def controller_from_gains(path: str | Path, config: TaskConfig) -> Controller:
    """The classical controller whose gains a file holds; the names of the gains tell which one it is.

    Raises:
        ConfigurationError: the file cannot be read, or holds the gains of no controller.
    """
    values = read_yaml(path)
    kinds = [kind for kind, (_, gains) in CONTROLLERS.items() if values and set(values) <= set(gains.model_fields)]
    if len(kinds) != 1:
        raise ConfigurationError(f"{path}: must hold the gains of one controller ({', '.join(CONTROLLERS)})")
    try:
        return make_controller(kinds[0], config, values)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
