"""Files of measuring programs as columns: CSV, Parquet, MDF4, TDMS and MAT.

Channels of MDF4 and TDMS have their own time stamps, which are kept. If the stamps of the chosen channels differ,
:func:`together` interpolates them at the stamps of the command and reports it as a finding.
"""

from __future__ import annotations

import csv
import importlib
import io
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.recordings.columns import UNITS, split_heading
from hydro_agents.recordings.findings import Finding, Weight
from hydro_agents.recordings.mat_files import Channel, read_mat
from hydro_env import ConfigurationError
from hydro_env.files import read_text

LARGEST_RECORDING = 200_000_000  # largest size in bytes; about three hours at 200 rows per second as CSV
OTHER_ENCODING = "cp1252"  # of texts that are not UTF-8: that of Western Windows programs

LONGEST_STEP = 2.0
"""Longest distance between a channel's own stamps for interpolation, as a multiple of the usual distance."""

TIME_HEADING = "time [s]"  # heading of the common time of channels with their own stamps
MOST_LINES = 200  # in which the headings must stand

SPACES = r"\s+"  # any number of spaces between two columns

_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)

Floats = NDArray[np.float64]


class Columns(NamedTuple):
    """The columns of a file, C of them."""

    headings: list[str]  # (C,)
    cells: list[pd.Series]  # (C,)
    stamps: list[Floats | None]  # (C,), s, a column's own time stamps; None: those of the time column
    first_line: int  # line of the first row in the file; 0 for a file without lines


def read_columns(path: Path) -> Columns:
    """Read a file; the end of its name gives its kind (.parquet, .mf4, .mdf, .tdms, .mat, otherwise CSV).

    Raises:
        ConfigurationError: the file is unreadable, too large or not a table, or its library is not installed.
    """
    kind = path.suffix.lower()
    if kind not in _READERS:
        return _read_csv(path)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    if size > LARGEST_RECORDING:
        raise ConfigurationError(f"{path}: is larger than {LARGEST_RECORDING / 1e6:g} MB")
    library, read = _READERS[kind]
    try:
        module = importlib.import_module(library)
    except ImportError:
        raise ConfigurationError(
            f"{path}: files of this kind need the library {library}: pip install 'hydro_env[recordings]'"
        ) from None
    try:
        columns = read(path, module)
    except ConfigurationError:
        raise
    except Exception as error:  # a damaged file makes these libraries raise errors of any kind
        reason = " ".join(str(error).split())[:150] or type(error).__name__
        raise ConfigurationError(f"{path}: is not a readable {kind} file: {reason}") from None
    if not columns.cells or not max(map(len, columns.cells)):
        raise ConfigurationError(f"{path}: holds no numbers")
    return columns


def together(columns: Columns, places: Mapping[str, int]) -> tuple[dict[str, pd.Series], list[Finding]]:
    """The chosen columns by signal, all with the same rows.

    Columns with their own time stamps are interpolated linearly at the stamps of the command, never extrapolated, and
    are missing (NaN) in their gaps. A finding names each such signal.

    Args:
        columns: of the file.
        places: index of each chosen column by signal, ``time`` and ``command`` among them.
    """
    base = columns.stamps[places["command"]]
    cells = {signal: columns.cells[place] for signal, place in places.items()}
    findings: list[Finding] = []
    if base is None:
        return cells, findings
    if columns.headings[places["time"]] == TIME_HEADING:
        cells["time"] = pd.Series(base)
    for signal, place in places.items():
        own = columns.stamps[place]
        if own is None or (len(own) == len(base) and np.allclose(own, base, rtol=0.0, atol=1e-9)):
            continue
        values = pd.to_numeric(columns.cells[place], errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        cells[signal] = pd.Series(_interpolated(base, own, values))
        usual = 1e3 * float(np.median(np.diff(own))) if len(own) > 1 else np.nan
        what = f"has its own time stamps, one every {usual:.4g} ms; it is interpolated at those of the command"
        findings.append(Finding(signal, what, Weight.NOTE))
    return cells, findings


def _interpolated(time: Floats, own: Floats, values: Floats) -> Floats:
    """Values at ``time`` between the samples (own, values); NaN before, after, and in gaps."""
    order = np.argsort(own, kind="stable")
    own, values = own[order], values[order]
    if len(own) < 2:
        return np.full(len(time), np.nan)
    after = np.clip(np.searchsorted(own, time), 1, len(own) - 1)
    step = own[after] - own[after - 1]
    inside = (time >= own[0]) & (time <= own[-1]) & (step <= LONGEST_STEP * np.median(np.diff(own)))
    share = (time - own[after - 1]) / np.where(step > 0.0, step, 1.0)
    between = values[after - 1] + share * (values[after] - values[after - 1])
    return np.where(inside, between, np.nan)


def _read_csv(path: Path) -> Columns:
    """The table of a text file: its headings stand in the line above the first line of numbers (:func:`find_table`)."""
    text = read_text(path, LARGEST_RECORDING, OTHER_ENCODING)
    try:
        found = find_table(text)
    except csv.Error as error:
        raise ConfigurationError(f"{path}: is not a table: {error}") from None
    if found is None:
        raise ConfigurationError(f"{path}: holds no table")
    decimal = "," if found.separator != "," and "," in text[found.start : found.start + 100_000] else "."
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(text[found.start :]),
                sep=found.separator,
                decimal=decimal,
                header=None,
                names=range(len(found.headings)),
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
            )
    except pd.errors.ParserWarning:
        raise ConfigurationError(f"{path}: rows have more columns than the line of headings") from None
    except (ValueError, OverflowError, RecursionError) as error:  # pandas' own errors are ValueErrors
        raise ConfigurationError(f"{path}: is not a table: {' '.join(str(error).split())[:200]}") from None
    if not len(table):
        raise ConfigurationError(f"{path}: holds headings but no rows")
    return _of_table(table.set_axis(found.headings, axis=1), found.first_line)


def _of_table(table: pd.DataFrame, first_line: int = 0) -> Columns:
    headings = [str(name) for name in table.columns]
    return Columns(headings, [table.iloc[:, k] for k in range(len(headings))], [None] * len(headings), first_line)


def _read_parquet(path: Path, _: Any) -> Columns:
    table = pd.read_parquet(path, engine="pyarrow")
    return _of_table(table.reset_index() if table.index.name is not None else table)


def _read_mdf(path: Path, asammdf: Any) -> Columns:
    channels = []
    with asammdf.MDF(path) as file:
        for number, group in enumerate(file.groups):
            for place in range(len(group.channels)):
                if place == file.masters_db.get(number):
                    continue
                signal = file.get(group=number, index=place)
                if np.ndim(signal.samples) == 1 and np.issubdtype(signal.samples.dtype, np.number):
                    stamps = np.asarray(signal.timestamps, dtype=np.float64)
                    channels.append(Channel(f"group {number}", signal.name, signal.unit or "", signal.samples, stamps))
    return _of_channels(channels)


def _read_tdms(path: Path, nptdms: Any) -> Columns:
    channels = []
    for group in nptdms.TdmsFile.read(path).groups():
        for channel in group.channels():
            values = channel[:]
            if not len(values):
                continue
            unit = str(channel.properties.get("unit_string", ""))
            # Only a waveform has stamps; otherwise a column of the file is the time.
            stamps = channel.time_track() if "wf_increment" in channel.properties else None
            channels.append(Channel(group.name, channel.name, unit, values, stamps))
    return _of_channels(channels)


def _read_mat(path: Path, scipy_io: Any) -> Columns:
    return _of_channels(read_mat(path, scipy_io))


def _of_channels(channels: Sequence[Channel]) -> Columns:
    """Headings ``name [unit]``, with the group before names that occur twice; the common time comes first."""
    names = [channel.name for channel in channels]
    headings = [
        (f"{c.group}/{c.name}" if names.count(c.name) > 1 else c.name) + (f" [{c.unit}]" if c.unit else "")
        for c in channels
    ]
    cells = [pd.Series(channel.values) for channel in channels]
    stamps = [channel.stamps for channel in channels]
    if any(one is not None for one in stamps):
        longest = max((one for one in stamps if one is not None), key=len)
        headings, cells, stamps = [TIME_HEADING, *headings], [pd.Series(longest), *cells], [None, *stamps]
    return Columns(headings, cells, stamps, 0)


_READERS: dict[str, tuple[str, Callable[[Path, Any], Columns]]] = {
    ".parquet": ("pyarrow", _read_parquet),
    ".mf4": ("asammdf", _read_mdf),
    ".mdf": ("asammdf", _read_mdf),
    ".tdms": ("nptdms", _read_tdms),
    ".mat": ("scipy.io", _read_mat),
}


class Found(NamedTuple):
    """Where the table stands."""

    headings: list[str]
    separator: str
    start: int  # characters before the first row
    first_line: int  # line of the first row, from 1


def find_table(text: str) -> Found | None:
    """Headings and first row of a table; ``None``: the text holds no line.

    The headings are the first line that has as many cells as most lines, more than half of them filled and none a
    number; without such a line, the first one. If the line below holds units, each heading gets its own: ``P_A [bar]``.
    What stands before the headings, empty lines and lines that begin with ``#`` are skipped; without headings, the
    last comment above the numbers counts if it has as many cells. Spaces separate columns where nothing else does.

    Raises:
        csv.Error: a line is too long for a table.
    """
    lines = _lines(text)
    if not lines:
        return None
    separator = next((mark for mark in ";\t," if 2 * sum(mark in line.text for line in lines) > len(lines)), SPACES)
    if separator == SPACES and not all(_NUMBER.fullmatch(cell) for cell in lines[-1].text.split()):
        separator = ","
    rows = [_cells(line.text, separator) for line in lines]
    widths = [len(row) for row in rows]
    usual = max(set(widths), key=widths.count)
    place = next((k for k, row in enumerate(rows) if len(row) == usual and _are_headings(row)), None)
    if place is None:
        above = _cells(lines[0].comment, "," if separator == SPACES and "," in lines[0].comment else separator)
        if len(above) == usual and _are_headings(above):
            return Found(above, separator, lines[0].begin, lines[0].number)
        place = 0
    headings = rows[place]
    if place + 1 < len(rows) and len(rows[place + 1]) == len(headings) and _are_units(rows[place + 1]):
        place += 1
        headings = [_with_unit(name, unit) for name, unit in zip(headings, rows[place], strict=True)]
    return Found(headings, separator, lines[place].end, lines[place].number + 1)


class _Line(NamedTuple):
    begin: int  # characters before it
    end: int  # characters up to the next line
    number: int  # from 1
    text: str
    comment: str  # the last one above, without its mark


def _lines(text: str) -> list[_Line]:
    """The first lines that are neither empty nor comments."""
    lines: list[_Line] = []
    start, number, comment = 0, 0, ""
    while start < len(text) and len(lines) < MOST_LINES:
        end = text.find("\n", start)
        end = end if end >= 0 else len(text)
        line, number = text[start:end].strip("\r"), number + 1
        if line.lstrip().startswith("#"):
            comment = line.strip().lstrip("# ")
        elif line.strip():
            lines.append(_Line(start, end + 1, number, line, comment))
        start = end + 1
    return lines


def _cells(line: str, separator: str) -> list[str]:
    if separator == SPACES:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def _are_headings(cells: list[str]) -> bool:
    """More than half of the cells are filled, and none is a number."""
    return 2 * sum(map(bool, cells)) > len(cells) and not any(map(_NUMBER.fullmatch, cells))


def _are_units(cells: list[str]) -> bool:
    """Whether cells are units, in brackets or not: most of those that are not empty are known ones."""
    known = {unit for units in UNITS.values() for unit in units}
    units = [cell.strip("[]()").replace("μ", "u").replace("µ", "u") for cell in cells if cell]
    return 2 * sum(unit in known - {"1", "-"} for unit in units) > len(units)


def _with_unit(name: str, unit: str) -> str:
    unit = unit.strip("[]()")
    return f"{name} [{unit}]" if unit and split_heading(name)[1] is None else name
