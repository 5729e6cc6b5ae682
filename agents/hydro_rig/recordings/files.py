"""Files of measuring programs as columns: CSV, Parquet and MAT, packed or not.

A struct of a MAT file that holds a time has its own time stamps, and so has a tag of a historian's long table; they are
kept. :func:`together` brings the chosen channels to the stamps of the command, and reports it as a finding.
"""

import gzip
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.io

from hydro_env import ConfigurationError
from hydro_env.types import Floats
from hydro_rig.recordings.findings import Finding, Findings
from hydro_rig.recordings.stamps import time_stamps, with_whole_stamps
from hydro_rig.recordings.text_tables import text_table

LARGEST_RECORDING = 1_000_000_000  # largest size in bytes; about twenty hours at 200 rows per second as CSV
LONGEST_STEP = 2.0  # between a channel's own stamps for interpolation, as a multiple of their usual distance
AS_FAST = 1.5  # longest usual distance of a channel's stamps for interpolation, as a multiple of that of the command
TIME_HEADING = "time [s]"  # heading of the common time of channels with their own stamps
CONVERSIONS = {
    ".mf4": "asammdf.MDF('run.mf4').to_dataframe(raster='NAME OF THE COMMAND')",
    ".xlsx": "pandas.read_excel('run.xlsx')",
    ".tdms": "nptdms.TdmsFile.read('run.tdms')['GROUP'].as_dataframe(time_index=True).rename_axis('time')",
}
"""Python that makes a table of a file of another kind, by the end of its name."""

ENDINGS = (".csv", ".txt", ".tsv", ".lvm", ".parquet", ".mat", ".gz")  # of the names of recordings
LONG = {
    "tag": ("tag", "tagname", "tag name", "name", "point", "varname", "variable", "signal", "channel"),
    "time": ("time", "timestamp", "timestring", "datetime", "date/time"),
    "value": ("value", "varvalue"),
    "quality": ("quality", "status", "validity"),
}
"""Headings of a long table, with a row per reading of any tag, in lower case; the quality may be absent."""

GOOD = {"good", "ok", "valid", "true", "1", "192"}  # qualities, in lower case: words, 1 of WinCC, 192 of OPC
TIMES = ("time", "t", "zeit", "timestamps")
CONTENTS = ("values", "value", "data", "signals", "signal")
"""Names of the fields of a MAT struct that hold its time, and its numbers, in lower case."""

_Channel = tuple[str, Floats, Floats | None]  # heading, values, and its own stamps


class Columns(NamedTuple):
    """The columns of a file, C of them."""

    headings: list[str]  # (C,)
    cells: list[pd.Series]  # (C,)
    stamps: list[Floats | None]  # (C,), s, a column's own time stamps; None: those of the time column
    first_line: int  # line of the first row in the file; 0 for a file without lines


def read_columns(path: Path) -> Columns:
    """Read a file; the end of its name gives its kind: .parquet, .mat, otherwise CSV; .gz is unpacked.

    Raises:
        ConfigurationError: the file is unreadable, too large or not a table, or its library is not installed.
    """
    kind = path.suffix.lower()
    file: Path | io.BytesIO = path
    with library_errors(path):
        size = path.stat().st_size
        if kind == ".gz":
            kind = Path(path.stem).suffix.lower()
            with gzip.open(path) as packed:
                content = packed.read(LARGEST_RECORDING + 1)
            size, file = len(content), io.BytesIO(content)
    if size > LARGEST_RECORDING:
        raise ConfigurationError(f"{path}: is larger than {LARGEST_RECORDING / 1e6:g} MB; cut it into several files")
    if kind in CONVERSIONS:
        raise ConfigurationError(f"{path}: convert the file first: {CONVERSIONS[kind]}.to_parquet('run.parquet')")
    with library_errors(path):
        if kind == ".parquet":
            columns = of_table(pd.read_parquet(file, partitioning=None))
        elif kind == ".mat":
            columns = read_mat(file)
        else:
            columns = of_table(*text_table(file))
    if not columns.cells or not max(map(len, columns.cells)):
        raise ConfigurationError(f"{path}: holds {'headings but no rows' if columns.first_line else 'no numbers'}")
    return columns


@contextmanager
def library_errors(path: Path) -> Iterator[None]:
    """Errors of the library that reads a file, in one line each.

    Raises:
        ConfigurationError: it is not installed, or any of its errors.
    """
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ImportError:
        raise ConfigurationError(f"{path}: such files need more: pip install 'hydro_env[recordings]'") from None
    except Exception as error:  # a damaged file makes these libraries raise errors of any kind
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigurationError(f"{path}: is not a readable {path.suffix.lower() or 'text'} file: {reason}") from None


def together(columns: Columns, places: Mapping[str, int]) -> tuple[dict[str, pd.Series], Findings]:
    """The chosen columns by signal, all with the same rows; ``places``: their index, ``time`` and ``command`` included.

    Columns with their own time stamps that are as dense as those of the command are interpolated linearly at these,
    never extrapolated, and are missing (NaN) in their gaps. A reading of a slower one stands in the row of the nearest
    stamp; between two of them nothing is known. A finding names each such signal.
    """
    base = columns.stamps[places["command"]]
    cells = {signal: columns.cells[place] for signal, place in places.items()}
    findings: Findings = []
    if base is None:
        return cells, findings
    if places["time"] == 0:  # that of the channel with the most stamps
        cells["time"] = pd.Series(base)
    for signal, place in places.items():
        own = columns.stamps[place]
        if own is None or (len(own) == len(base) and np.allclose(own, base, 0.0, 1e-9)):
            continue
        values = numbers_of(columns.cells[place])
        usual, row = _usual_step(own), _usual_step(base)
        what = f"has its own time stamps, one every {1e3 * usual:.4g} ms; "
        if usual > AS_FAST * row:
            cells[signal] = pd.Series(placed(base, own, values, 0.5 * row))
            what += "its readings stand in the nearest rows of the command"
        else:
            cells[signal] = pd.Series(interpolated(base, own, values))
            what += "it is interpolated at those of the command"
        findings.append(Finding(signal, what))
    return cells, findings


def _usual_step(stamps: Floats) -> float:
    return np.median(np.diff(stamps)) if len(stamps) > 1 else np.nan


def numbers_of(cells: pd.Series) -> Floats:
    """The values of cells; what is no number is NaN."""
    return np.array(pd.to_numeric(cells, errors="coerce").to_numpy(float, na_value=np.nan))


def interpolated(time: Floats, own: Floats, values: Floats, longest: float = 0.0) -> Floats:
    """Values at ``time`` between the samples (own, values); NaN before, after, and in gaps longer than ``longest``.

    Default: LONGEST_STEP usual steps.
    """
    order = np.argsort(own, kind="stable")
    own, values = own[order], values[order]
    if len(own) < 2:
        return np.full(len(time), np.nan)
    steps = np.diff(own)
    after = np.clip(np.searchsorted(own, time), 1, len(own) - 1)
    gap = steps[after - 1] > (longest or LONGEST_STEP * np.median(steps))
    return np.where(gap, np.nan, np.interp(time, own, values, left=np.nan, right=np.nan))


def placed(time: Floats, own: Floats, values: Floats, farthest: float) -> Floats:
    """Values at the nearest ``time``, rising, of the samples (own, values), if no farther away; NaN elsewhere."""
    after = np.clip(np.searchsorted(time, own), 1, len(time) - 1)
    nearest = after - (own - time[after - 1] < time[after] - own)
    near = np.abs(time[nearest] - own) <= farthest
    there = np.full(len(time), np.nan)
    there[nearest[near]] = values[near]
    return there


def of_table(table: pd.DataFrame, first_line: int = 0) -> Columns:
    """The columns of a table; an index with a name is one of them, and one without is the time if it is no number."""
    if table.index.name is not None or table.index.dtype.kind in "fM":
        table = table.rename_axis(table.index.name or "time").reset_index()
    table = with_whole_stamps(table)
    headings = [str(name) for name in table.columns]
    found = {part: k for part, names in LONG.items() for k, name in enumerate(headings) if name.lower() in names}
    if {"tag", "time", "value"} <= found.keys() and len(table):
        return _of_channels(_channels_of_tags(table, found), headings[found["time"]])
    return Columns(headings, [table.iloc[:, k] for k in range(len(headings))], [None] * len(headings), first_line)


def _channels_of_tags(table: pd.DataFrame, places: Mapping[str, int]) -> list[_Channel]:
    """The readings of each tag of a long table; those of bad quality are missing; ValueError: no reading is good."""
    stamps, begin = time_stamps(table.iloc[:, places["time"]])
    time = numbers_of(table.iloc[:, places["time"]]) if stamps is None else begin + stamps
    values = numbers_of(table.iloc[:, places["value"]])
    if "quality" in places:
        quality = table.iloc[:, places["quality"]].astype(str).str.strip().str.lower().str.removesuffix(".0")
        good = quality.isin(GOOD)
        if not good.any():
            heading = table.columns[places["quality"]]
            raise ValueError(f"no reading is good: '{heading}' holds '{quality.iloc[0][:20]}'; leave it out if it is")
        values[~good] = np.nan
    tags = table.iloc[:, places["tag"]].astype(str).str.strip()
    return [(tag, values[rows], time[rows]) for tag, rows in tags.groupby(tags, sort=False).indices.items()]


def read_mat(file: Path | io.BytesIO) -> Columns:
    """Vectors, matrices and structs of a MAT file of version 5 to 7 (7.3 is another format); a time comes first."""
    channels: list[_Channel] = []
    try:
        content = scipy.io.loadmat(file, simplify_cells=True)
    except NotImplementedError as error:
        raise ValueError(f"{error}; in MATLAB: save('run.mat', '-v7')") from None
    for name, value in content.items():
        if not name.startswith("__"):
            channels += _channels_of(name, value)
    return _of_channels(channels, TIME_HEADING)


def _of_channels(channels: list[_Channel], time_heading: str) -> Columns:
    """The columns of channels; the longest stamps come first."""
    longest = max((stamps for _, _, stamps in channels if stamps is not None), key=len, default=None)
    if longest is not None:
        channels.insert(0, (time_heading, longest, None))
    headings, values, stamps = zip(*channels, strict=True) if channels else ((), (), ())
    return Columns(list(headings), list(map(pd.Series, values)), list(stamps), 0)


def _channels_of(name: str, value: Any, stamps: Floats | None = None, unit: str = "") -> Iterator[_Channel]:
    """The channels in a variable of a MAT file: numbers, or a struct of them, of structs, or of a list of them."""
    if isinstance(value, list):
        for number, part in enumerate(value, 1):
            yield from _channels_of(f"{name}.{number}", part, stamps, unit)
    elif isinstance(value, dict):
        fields = {key.lower(): part for key, part in value.items()}
        times = [np.ravel(fields[key]).astype(float) for key in TIMES if _are_numbers(fields.get(key))]
        stamps = times[0] if times else stamps
        unit = str(fields.get("unit", fields.get("units", unit)))
        for key, part in value.items():
            if key.lower() not in TIMES:
                yield from _channels_of(name if key.lower() in CONTENTS else f"{name}.{key}", part, stamps, unit)
    elif _are_numbers(value):
        table = value.astype(float).reshape(len(value), -1)
        if stamps is None and 1 < table.shape[0] < table.shape[1] and (np.diff(table[0]) > 0.0).all():
            stamps, table = table[0], table[1:].T  # To File has the time in the first row
        for number, column in enumerate(table.T, 1):
            if stamps is None or len(column) == len(stamps):
                heading = name if table.shape[1] == 1 else f"{name}.{number}"
                yield f"{heading} [{unit}]" if unit else heading, column, stamps


def _are_numbers(value: Any) -> bool:
    """Whether a part of a MAT file is a vector or a matrix of numbers."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.ndim in (1, 2) and value.size > 1
