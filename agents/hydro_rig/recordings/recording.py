"""Reads a recording of a rig: a file with time stamps and one column per measured signal."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from hydro_env import ConfigurationError
from hydro_env.types import Floats
from hydro_rig.recordings.columns import BESIDE, COMMAND, MEASURED, ColumnMap, own_map, place_of, unit_of
from hydro_rig.recordings.files import Columns, read_columns, together
from hydro_rig.recordings.findings import NOT_RECORDED, Finding, severe_if
from hydro_rig.recordings.guessed_map import UnknownHeadingsError, guessed_map

LARGEST_NUMBER = 1e25  # in any unit; a cell beyond it is no measurement
FEWEST_ROWS = 3


class Recording(NamedTuple):
    """Rows of a file in their order; a cell that is empty or not a number is NaN."""

    source: str
    time: Floats  # (n,), s, from the first row
    signals: Floats  # (5, n), SI, in the order of MEASURED; the command acts at the time of the row
    units: dict[str, str]  # by signal, from the file or the map
    findings: list[Finding]
    beside: Floats | None = None  # (4, n), SI, in the order of BESIDE; NaN: not recorded; None: none of them
    begin: float = 0.0  # s, stamp of the first row in the file; of dates and times since 1970

    def part(self, first: int, end: int) -> Recording:
        """A copy of the rows from ``first`` to before ``end``."""
        shift = float(self.time[first]) if first < end else 0.0
        signals, beside = (None if v is None else v[:, first:end].copy() for v in (self.signals, self.beside))
        assert signals is not None
        time, begin = self.time[first:end] - shift, self.begin + shift
        return self._replace(time=time, signals=signals, beside=beside, begin=begin)


def read_recording(path: Path, columns: ColumnMap | None = None) -> Recording:
    """Read a recording.

    CSV: the headings stand above the numbers, with units in them or in the line below; what stands before is skipped.
    Semicolons or tabs, which allow decimal commas, or commas separate the columns. The end of the name identifies
    Parquet, MDF4, TDMS and MAT files (:mod:`hydro_rig.recordings.files`).

    Args:
        path: the file; text in UTF-8 or Windows-1252.
        columns: the signal of each column; default: the names that ``hydro record`` writes.

    Raises:
        ConfigurationError: the file is unreadable, too large or not a table, or a column or its unit is missing.
        UnknownHeadingsError: there is no map, and the headings are others; it holds a guess.

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
    return recording_of(read_columns(path), str(path), columns)


def recording_of(file: Columns, source: str, columns: ColumnMap | None = None) -> Recording:
    """The recording in the columns of a file; errors as :func:`read_recording`."""
    headings = file.headings
    columns = columns or map_for(file, source)
    places = {signal: place_of(column, signal, headings, source) for signal, column in columns.columns().items()}
    cells, findings = together(file, places)
    rows = len(cells["command"])
    for signal, values_of in cells.items():
        if len(values_of) != rows:
            raise ConfigurationError(
                f"{source}: {signal}: column '{headings[places[signal]][:40]}' has {len(values_of)} values, that of "
                f"the command has {rows}, and one of them has no time of its own"
            )
    units: dict[str, str] = {}
    time, begin, signals = np.zeros(0), 0.0, np.full((len(MEASURED) + len(BESIDE), rows), np.nan)
    for signal, column in columns.columns().items():
        values, origin = _time_stamps(cells[signal]) if signal == "time" else (None, 0.0)
        if values is None:
            values = _numbers(cells[signal], signal, file.first_line, findings)
            units[signal], size = unit_of(column, signal, headings[places[signal]], source)
            values = size * (column.gain * values + column.offset)
        values[~np.isfinite(values)] = np.nan
        if signal == "time":
            time, begin = values, origin
        else:
            signals[(*MEASURED, *BESIDE).index(signal)] = values
    if columns.command.rows_early:
        signals[COMMAND] = _shifted(signals[COMMAND], columns.command.rows_early)
    for signal in MEASURED:
        if getattr(columns, signal) is None:
            findings.append(Finding(signal, NOT_RECORDED, severe_if(signal == "command")))
    known = np.isfinite(time)
    if known.sum() < FEWEST_ROWS:
        example = str(cells["time"].iloc[0])[:40]
        raise ConfigurationError(
            f"{source}: fewer than {FEWEST_ROWS} rows have a time stamp (the first one is {example!r}); allowed are "
            "numbers, 2026-03-01T08:00:00.005 and 01.03.2026 08:00:00,005"
        )
    if not known.all():
        share = float(1.0 - known.mean())
        findings.append(
            Finding("time", "is missing in some rows, which are left out", severe_if(share > 0.2), share=share)
        )
    time = time[known]
    beside = signals[len(MEASURED) :, known] if any(getattr(columns, name) for name in BESIDE) else None
    measured = signals[: len(MEASURED), known]
    return Recording(source, time - time[0], measured, units, findings, beside, begin + float(time[0]))


def map_for(file: Columns, source: str) -> ColumnMap:
    """The map of a file with the headings of this project.

    Raises:
        UnknownHeadingsError: the headings are others; it holds a guess.
    """
    try:
        return own_map(file.headings, source)
    except ConfigurationError as error:
        guess = guessed_map(file.headings, file.cells, source)
        what = f"{error}; a map guessed from the headings stands above: save it as FILE, check it, add --map FILE"
        raise UnknownHeadingsError(what, guess) from None


def _numbers(cells: pd.Series, signal: str, first_line: int, findings: list[Finding]) -> Floats:
    """Values of a column; text becomes NaN and a finding."""
    values: Floats = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan).copy()
    values[np.abs(values) > LARGEST_NUMBER] = np.nan
    text = np.flatnonzero(np.isnan(values) & cells.notna().to_numpy())
    if len(text):
        example, share = str(cells.iloc[text[0]])[:20], len(text) / len(values)
        place = f"line {first_line + text[0]}" if first_line else f"row {text[0] + 1}"
        what = f"has {len(text)} cells that are not numbers, the first one {example!r} in {place}"
        findings.append(Finding(signal, what, severe_if(share > 0.2), share=share))
    return values


def _time_stamps(cells: pd.Series) -> tuple[Floats | None, float]:
    """Seconds since the first date and time, and its own since 1970; ``None`` if the cells are numbers or other text.

    ``2026-03-01T08:00:00.005`` (ISO 8601) and ``01.03.2026 08:00:00,005`` (day, month, year) are understood.
    """
    if pd.api.types.is_numeric_dtype(cells):
        return None, 0.0
    stamps = pd.to_datetime(cells, errors="coerce", utc=True, format="ISO8601")
    if stamps.isna().mean() > 0.5:
        texts = cells.astype(str).str.strip().str.replace(",", ".")
        texts = texts.where(texts.str.count(r"\.") == 3, texts + ".0")  # two in the date, one before parts of a second
        stamps = pd.to_datetime(texts, errors="coerce", utc=True, format="%d.%m.%Y %H:%M:%S.%f")
    if stamps.isna().mean() > 0.5:
        return None, 0.0
    first = stamps.dropna().iloc[0]
    seconds: Floats = (stamps - first).dt.total_seconds().to_numpy(dtype=np.float64).copy()
    return seconds, float(first.timestamp())


def _shifted(values: Floats, rows: int) -> Floats:
    """Values moved down by a number of rows; the gap is NaN."""
    result = np.full_like(values, np.nan)
    if abs(rows) < len(values):
        if rows > 0:
            result[rows:] = values[:-rows]
        else:
            result[:rows] = values[-rows:]
    return result
