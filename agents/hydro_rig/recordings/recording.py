"""Reads a recording of a rig: a file with time stamps and one column per measured signal."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import AUXILIARY
from hydro_env import ConfigurationError
from hydro_env.task.sensors import PRESSURE_A, PRESSURE_B
from hydro_env.types import Floats
from hydro_rig.recordings.columns import LOAD_PRESSURE, MEASURED, ColumnMap, own_map, place_of, unit_of
from hydro_rig.recordings.files import Columns, numbers_of, read_columns, together
from hydro_rig.recordings.findings import MOST_SPIKES, Finding, Findings, missing_weight, severe_if
from hydro_rig.recordings.stamps import EXCEL_BEGIN, equidistant, time_stamps

LARGEST_NUMBER = 1e25  # in any unit; a cell beyond it is no measurement
FEWEST_ROWS = 3
OIL = -20.0, 100.0  # °C, of oil in service: valves are made for up to 80 °C, and 100 °F is oil of 38 °C
FULL_COMMAND = 0.99  # of the largest command, from which the valve counts as fully open


class Recording(NamedTuple):
    """Rows of a file in their order; a cell that is empty or not a number is NaN."""

    source: str
    time: Floats  # (n,), s, from the first row
    signals: Floats  # (5, n), SI, in the order of MEASURED; the command acts at the time of the row
    units: dict[str, str]  # by signal, from the file or the map
    findings: Findings
    auxiliary: Mapping[str, Floats] = {}  # the recorded ones of AUXILIARY by name, each (n,), SI
    begin: float = 0.0  # s, stamp of the first row in the file; of dates and times since 1970
    differential: bool = False  # pressure a is pressure a minus b

    @property
    def has_pressure(self) -> bool:
        """Whether one pressure was recorded at least."""
        return bool(np.isfinite(self.signals[[PRESSURE_A, PRESSURE_B]]).any())

    def part(self, first: int, end: int) -> Self:
        """A copy of the rows from ``first`` to before ``end``."""
        shift = self.time[first] if first < end else 0.0
        return self._replace(
            time=self.time[first:end] - shift,
            signals=self.signals[:, first:end].copy(),
            auxiliary={name: values[first:end].copy() for name, values in self.auxiliary.items()},
            begin=self.begin + shift,
        )

    def with_plausible_oil(self) -> Self:
        """With NaN for temperatures that no oil in service has, and a finding that says so.

        Where these are more than single ones, or all are 0 °C as those of a dead input, none of the readings counts.
        """
        values = self.auxiliary.get("oil_temperature", np.zeros(0))
        known = np.isfinite(values)
        wrong = known & ((values < OIL[0]) | (values > OIL[1]))
        if wrong.sum() > MOST_SPIKES * known.sum() or not values[known].any():
            wrong = known
        if not wrong.any():
            return self
        ends = f"{values[wrong].min():.4g} to {values[wrong].max():.4g} °C"
        what = f"reads {ends}, must be {OIL[0]:g} to {OIL[1]:g} °C and not always 0: counts as not measured"
        finding = Finding("oil_temperature", what, share=wrong.mean())
        auxiliary = {**self.auxiliary, "oil_temperature": np.where(wrong, np.nan, values)}
        return self._replace(auxiliary=auxiliary, findings=[*self.findings, finding])


def read_recording(path: Path, columns: ColumnMap | None = None) -> Recording:
    """Read a recording; ``columns``: the signal of each column; default: the names that ``hydro record`` writes.

    CSV in UTF-8, UTF-16 or Windows-1252: the headings stand above the numbers, with units in them or in the line below;
    what stands before is skipped. Semicolons, tabs, commas or spaces separate the columns. The end of the name
    identifies packed, Parquet and MAT files (:mod:`hydro_rig.recordings.files`).

    Raises:
        ConfigurationError: the file is unreadable, too large or not a table, or a column or its unit is missing.

    Example:
        >>> from pathlib import Path
        >>> from hydro_rig.recordings.recording import read_recording
        >>> signals = "position [mm]", "pressure_a [bar]", "pressure_b [bar]", "spool_position [%]", "command [V]"
        >>> with Path("axis.csv").open("w") as file:
        ...     print("time [s]", *signals, sep=",", file=file)
        ...     for k in range(100):
        ...         print(f"{0.005 * k},0.0,30.0,30.0,0.0,0.1", file=file)
        >>> read_recording(Path("axis.csv")).signals.shape  # position, pressures, spool position, command
        (5, 100)
    """
    source, file = str(path), read_columns(path)
    columns = columns or own_map(file.headings, source)
    values, units, begin, findings = _values_of(file, columns, source)
    stamps = _time_of(values.pop("time"), columns.time.equidistant, source, findings)
    values["command"] = pd.Series(values["command"]).shift(columns.command.rows_early).to_numpy()
    differential = LOAD_PRESSURE in values
    if differential:
        values["pressure_a"], units["pressure_a"] = values.pop(LOAD_PRESSURE), units.pop(LOAD_PRESSURE)
    findings += [Finding(signal, "was not recorded") for signal in MEASURED if signal not in values]
    known = np.isfinite(stamps)
    if not known.all():
        share = 1.0 - known.mean()
        what = "is missing in some rows, which are left out"
        findings.append(Finding("time", what, severe_if(share > 0.2), share=share))
    time, absent = stamps[known], np.full(len(stamps), np.nan)
    signals = np.array([values.get(signal, absent)[known] for signal in MEASURED])
    auxiliary = {name: values[name][known] for name in AUXILIARY if name in values}
    begin += time[0]
    time = time - time[0]
    return Recording(source, time, signals, units, findings, auxiliary, begin, differential).with_plausible_oil()


def _values_of(
    file: Columns, columns: ColumnMap, source: str
) -> tuple[dict[str, Floats], dict[str, str], float, Findings]:
    """Values in SI by signal, (n,) each, their units in the file, time of the first date and time, and findings."""
    chosen = columns.columns()
    places = {signal: place_of(column, signal, file.headings, source) for signal, column in chosen.items()}
    cells, findings = together(file, places)
    rows = len(cells["command"])
    units = {}
    values = {}
    dates, begin = time_stamps(cells["time"])
    for signal, column in chosen.items():
        heading, own = file.headings[places[signal]], cells[signal]
        if len(own) != rows:
            raise ConfigurationError(
                f"{source}: {signal}: column '{heading[:40]}' has {len(own)} values, that of the command has {rows}, "
                "and one of them has no time of its own"
            )
        if signal == "time" and dates is not None:
            values[signal] = dates
            if "/" in str(own.iloc[0]):
                what = f"has dates with slashes; the first is read as {pd.Timestamp(begin, unit='s'):%d %B %Y}"
                findings.append(Finding(signal, what))
            continue
        numbers = _numbers(own, signal, file.first_line, findings)
        units[signal], size = unit_of(column, signal, heading, source)
        if units[signal] == "d":
            begin = EXCEL_BEGIN
        found = size * (column.gain * numbers + column.offset)
        values[signal] = np.where(np.isfinite(found), found, np.nan)
    return values, units, begin, findings


def _time_of(time: Floats, given: bool | float, source: str, findings: Findings) -> Floats:
    """The stamps (n,), s; those of rows that the map calls equidistant are steady."""
    known = np.isfinite(time)
    if known.sum() < FEWEST_ROWS and isinstance(given, bool):
        raise ConfigurationError(
            f"{source}: fewer than {FEWEST_ROWS} rows have a time stamp; allowed are numbers, 2026-03-01T08:00:00.005, "
            "01.03.2026 08:00:00,005, 01-Mar-2026 08:00:00.005 and 3/1/2026 8:00:00.005 AM; rows at equal distances "
            "need none, with 'equidistant: 5 ms' for the time in the map"
        )
    if given is False:
        return time
    distance = equidistant(time) if given is True else given
    if distance is None:
        raise ConfigurationError(
            f"{source}: time: the stamps do not tell the distance of the rows; give it in the map, as in "
            "'equidistant: 5 ms'"
        )
    what = f"is taken as equidistant, one row every {1e3 * distance:.4g} ms, as the map says"
    findings.append(Finding("time", what))
    return np.asarray((time[known][0] if known.any() else 0.0) + distance * np.arange(len(time)), float)


def _numbers(cells: pd.Series, signal: str, first_line: int, findings: Findings) -> Floats:
    """Values of a column; text becomes NaN and a finding."""
    values = numbers_of(cells)
    values[np.abs(values) > LARGEST_NUMBER] = np.nan
    text = np.flatnonzero(np.isnan(values) & cells.notna().to_numpy())
    if len(text):
        example, share = str(cells.iloc[text[0]])[:20], len(text) / len(values)
        place = f"line {first_line + text[0]}" if first_line else f"row {text[0] + 1}"
        what = f"has {len(text)} cells that are not numbers, the first one {example!r} in {place}"
        findings.append(Finding(signal, what, missing_weight(signal, share), share=share))
    return values
