"""Signal and unit of each column of a file: from the names that ``hydro record`` writes, or from a map file."""

from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from hydro_agents.detection.detector import AUXILIARY
from hydro_env import ConfigurationError
from hydro_env.files import Group, read_yaml, validate
from hydro_env.folders import page
from hydro_env.task.sensors import SENSORS
from hydro_env.units import FULL_VOLTAGE, Number, split_heading, unit_factor
from hydro_env.units import UNITS as QUANTITIES

MEASURED = (*SENSORS, "command")  # names of the signals in a file, in the order of a window's rows
LOAD_PRESSURE = "load_pressure"

ALIASES = {"voltage": "command", "previous_command": "command", "spool": "spool_position"}
"""Other accepted headings; ``Trajectory.to_dataframe`` writes ``voltage``."""

_PARTS = {"V": 1.0 / FULL_VOLTAGE, "%": 1e-2, "1": 1.0, "-": 1.0, "mV": 1e-3 / FULL_VOLTAGE}

UNITS = {
    "time": QUANTITIES["s"] | {"d": 86400.0},
    "position": QUANTITIES["m"],
    "pressure_a": QUANTITIES["Pa"],
    "pressure_b": QUANTITIES["Pa"],
    "load_pressure": QUANTITIES["Pa"],
    "spool_position": _PARTS,
    "command": _PARTS,
    "supply_pressure": QUANTITIES["Pa"],
    "tank_pressure": QUANTITIES["Pa"],
    "flow": QUANTITIES["m³/s"],
    "oil_temperature": {"°C": 1.0, "C": 1.0},
}
"""SI units per unit, by signal, the usual ones first; command and spool are fractions of full scale. Pressures are
gauge pressures. The temperature of the oil stays in °C."""


def factor(signal: str, unit: str, place: str) -> float:
    """SI units per ``unit`` of a signal; ``place``: for the message.

    Raises:
        ConfigurationError: the signal is not measured in this unit.
    """
    try:
        return unit_factor(unit, UNITS[signal])
    except ValueError as error:
        raise ConfigurationError(f"{place}: {error}") from None


class Column(Group):
    """One signal of a recording: value = gain · cell + offset, in ``unit``."""

    column: str | Annotated[int, Field(ge=1)]  # heading, or number of the column from 1
    unit: str | None = None  # unit of the value; default: the one in the heading, [mm] or (mm)
    gain: Number = Field(1.0, ge=-1e12, le=1e12)  # scale of a raw signal; −1 reverses the sign
    offset: Number = Field(0.0, ge=-1e12, le=1e12)  # in the unit of the value

    @model_validator(mode="before")
    @classmethod
    def _heading_alone(cls, values: Any) -> Any:
        return {"column": values} if isinstance(values, str | int) else values


class TimeColumn(Column):
    """The time stamps."""

    # Whether the rows lie at equal distances, whatever their stamps say; or this distance, as in 5 ms
    equidistant: bool | Annotated[Number, Field(gt=0.0, le=1.0)] = Field(False, json_schema_extra={"unit": "s"})


class CommandColumn(Column):
    """The command; the rig's program may write it before it acts."""

    # Number of rows by which a command precedes the row in which it begins to act
    rows_early: int = Field(0, ge=-100, le=100)


class ColumnMap(Group):
    """The columns of a recording; an absent signal was not measured."""

    time: TimeColumn
    command: CommandColumn
    position: Column | None = None
    pressure_a: Column | None = None
    pressure_b: Column | None = None
    load_pressure: Column | None = None  # pressure a minus b, in place of both
    spool_position: Column | None = None
    supply_pressure: Column | None = None  # at the valve
    tank_pressure: Column | None = None  # at the valve
    flow: Column | None = None  # into chamber a; with a pump: displacement as gain of its speed
    oil_temperature: Column | None = None

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        owners: dict[str | int, str] = {}
        for name, column in self.columns().items():
            if name in ("command", "flow"):  # a pump's speed may be both
                continue
            if column.column in owners:
                raise ValueError(
                    f"{name}: column {column.column!r} is already {owners[column.column]}; each signal needs its own"
                )
            owners[column.column] = name
        if self.load_pressure and (self.pressure_a or self.pressure_b):
            raise ValueError("load_pressure: is pressure a minus b; give it or the two pressures")
        return self

    def columns(self) -> dict[str, Column]:
        """The given columns by signal."""
        given = {name: getattr(self, name) for name in ("time", *MEASURED, LOAD_PRESSURE, *AUXILIARY)}
        return {name: column for name, column in given.items() if column}


def read_map(path: Path | None) -> ColumnMap | None:
    """A map from a YAML file, or none; ConfigurationError: the file is unreadable, or not a map."""
    return validate(ColumnMap, read_yaml(path), path) if path else None


def maps_of(texts: Sequence[str], paths: Sequence[Path]) -> list[ColumnMap | None]:
    """The map of each recording, from FILE (for all) or PATTERN=FILE; the last pattern that matches counts.

    Raises:
        ConfigurationError: a map is unreadable, a pattern matches no recording, or two maps are for all.
    """
    maps: dict[Path, ColumnMap | None] = {}
    for text in texts:
        pattern, _, file = text.rpartition("=")
        if not pattern and len(texts) > 1:
            raise ConfigurationError(f"--map {text}: several maps need patterns: --map '*_a.csv={file}'")
        own = matching(paths, pattern, f"--map {text}") if pattern else paths
        maps |= dict.fromkeys(own, read_map(Path(file)))
    return [maps.get(path) for path in paths]


def matching(paths: Sequence[Path], pattern: str, option: str) -> list[Path]:
    """The paths whose name, or which as a whole, match a pattern.

    Raises:
        ConfigurationError: there is none; ``option``: for the message.
    """
    own = [path for path in paths if fnmatch(path.name, pattern) or fnmatch(str(path), pattern)]
    if not own:
        raise ConfigurationError(f"{option}: '{pattern}' matches none of the recordings, such as {paths[0].name}")
    return own


def own_map(headings: Sequence[str], source: str) -> ColumnMap:
    """The map of a file with the headings of this project, such as ``pressure_a [bar]``.

    Raises:
        ConfigurationError: time or command is missing, or a name occurs twice.
    """
    found = {}
    for place, heading in enumerate(headings, 1):
        plain, unit = split_heading(heading)
        name = ALIASES.get(plain.lower(), plain.lower())
        auxiliary = name in AUXILIARY and unit is not None
        if name not in ("time", *MEASURED, LOAD_PRESSURE) and not auxiliary:
            continue
        if name in found:
            raise ConfigurationError(f"{source}: two columns have the heading '{name}'; --map FILE selects one")
        found[name] = {"column": place}
    missing = [name for name in ("time", "command") if name not in found]
    if missing:
        raise ConfigurationError(
            f"{source}: no column has the heading '{missing[0]}'; --map FILE names the columns, as in "
            f"{page('diagnose.md')}; {_shown(headings)}"
        )
    return validate(ColumnMap, found, source)


def place_of(column: Column, signal: str, headings: Sequence[str], source: str) -> int:
    """Index of a column in the file.

    Raises:
        ConfigurationError: the column does not exist, or several columns have that heading.
    """
    given = column.column
    if isinstance(given, int):
        if given > len(headings):
            raise ConfigurationError(f"{source}: {signal}: column {given}: the file has {len(headings)} columns")
        return given - 1
    wanted = given.strip()
    places = [place for place, heading in enumerate(headings) if heading.strip() == wanted]
    places = places or [place for place, heading in enumerate(headings) if split_heading(heading)[0] == wanted]
    if len(places) != 1:
        count = "several columns have" if places else "no column has"
        raise ConfigurationError(f"{source}: {signal}: {count} the heading '{wanted[:40]}'; {_shown(headings)}")
    return places[0]


def _shown(headings: Sequence[str]) -> str:
    return f"headings: {', '.join(heading[:30] for heading in headings[:12])}"


def unit_of(column: Column, signal: str, heading: str, source: str) -> tuple[str, float]:
    """Unit of a column, from the map or its heading, and SI units per unit.

    Raises:
        ConfigurationError: the unit is missing, or does not fit the signal.
    """
    unit = column.unit if column.unit is not None else split_heading(heading)[1]
    if unit is None:
        if signal == "time":
            return "s", 1.0
        raise ConfigurationError(
            f"{source}: {signal}: column '{heading[:40]}' has no unit; write it in the heading, "
            f"{signal} [{next(iter(UNITS[signal]))}], or in the map"
        )
    if unit == "mA":
        raise ConfigurationError(
            f"{source}: {signal}: column '{heading[:40]}' is a current; give unit, gain and offset in the map, as in "
            "'{column: 3, unit: bar, gain: 15.625, offset: -62.5}' for 4 to 20 mA of a sensor of 0 to 250 bar"
        )
    return unit, factor(signal, unit, f"{source}: {signal}")
