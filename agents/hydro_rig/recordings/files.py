"""Files of measuring programs as columns: CSV, Parquet, MDF4, TDMS and MAT.

Channels of MDF4 and TDMS have their own time stamps, which are kept. If the stamps of the chosen channels differ,
:func:`together` interpolates them at the stamps of the command and reports it as a finding.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_env import ConfigurationError
from hydro_env.files import read_text
from hydro_env.types import Floats
from hydro_rig.recordings.channel_files import Channel, read_mat, read_mdf, read_tdms
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.text_tables import text_pieces

LARGEST_RECORDING = 200_000_000  # largest size in bytes; about three hours at 200 rows per second as CSV
ANY_LENGTH = "hydro trend reads CSV and Parquet files of any length"

LONGEST_STEP = 2.0
"""Longest distance between a channel's own stamps for interpolation, as a multiple of the usual distance."""

PIECE = 200_000  # rows that are in memory at once

TIME_HEADING = "time [s]"  # heading of the common time of channels with their own stamps


READERS: dict[str, tuple[str, Callable[[Path, Any], list[Channel]]]] = {
    ".mf4": ("asammdf", read_mdf),
    ".mdf": ("asammdf", read_mdf),
    ".tdms": ("nptdms", read_tdms),
    ".mat": ("scipy.io", read_mat),
}
"""Library and reader of files of channels, by the end of their names."""


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
    try:
        size = path.stat().st_size
    except (OSError, ValueError):  # the reader says why
        size = 0
    if size > LARGEST_RECORDING:
        raise ConfigurationError(f"{path}: is larger than {LARGEST_RECORDING / 1e6:g} MB; {ANY_LENGTH}")
    if kind == ".parquet":
        with library_errors(path, "pyarrow"):
            columns = of_table(pd.read_parquet(path, engine="pyarrow"))
    elif kind in READERS:
        library, read = READERS[kind]
        with library_errors(path, library) as module:
            columns = of_channels(read(path, module))
    else:
        return _text_columns(path)
    if not columns.cells or not max(map(len, columns.cells)):
        raise ConfigurationError(f"{path}: holds no numbers")
    return columns


def _text_columns(path: Path) -> Columns:
    ((table, first_line),) = text_pieces(path, None)
    if not len(table):
        raise ConfigurationError(f"{path}: holds headings but no rows")
    return of_table(table, first_line)


def pieces(path: Path, rows: int = PIECE) -> Iterator[Columns]:
    """The rows of a file of any length, ``rows`` at a time; MDF4, TDMS and MAT files are read as a whole.

    Raises:
        ConfigurationError: as :func:`read_columns`, but not for the size of CSV and Parquet files.
    """
    kind = path.suffix.lower()
    if kind == ".parquet":
        with library_errors(path, "pyarrow.parquet") as parquet, parquet.ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=rows):
                yield of_table(batch.to_pandas())
    elif kind in READERS:
        yield read_columns(path)
    else:
        for table, first_line in text_pieces(path, rows):
            yield of_table(table, first_line)


def started(path: Path) -> float | None:
    """Start of a measurement that the header of an MDF4 file gives, s since 1970; ``None`` for other files."""
    if path.suffix.lower() not in (".mf4", ".mdf"):
        return None
    with library_errors(path, "asammdf") as asammdf, asammdf.MDF(path) as file:
        return float(file.header.start_time.timestamp())


@contextmanager
def library_errors(path: Path, library: str) -> Iterator[Any]:
    """The library that reads a file, and its errors in one line each.

    Raises:
        ConfigurationError: it is not installed, or any of its errors.
    """
    if not path.is_file():
        read_text(path)  # says why
    try:
        module = importlib.import_module(library)
    except ImportError:
        raise ConfigurationError(
            f"{path}: files of this kind need the library {library}: pip install 'hydro_env[recordings]'"
        ) from None
    try:
        yield module
    except ConfigurationError:
        raise
    except Exception as error:  # a damaged file makes these libraries raise errors of any kind
        reason = " ".join(str(error).split())[:150] or type(error).__name__
        raise ConfigurationError(f"{path}: is not a readable {path.suffix.lower()} file: {reason}") from None


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


def of_table(table: pd.DataFrame, first_line: int = 0) -> Columns:
    """The columns of a table; an index with a name is one of them."""
    table = table.reset_index() if table.index.name is not None else table
    headings = [str(name) for name in table.columns]
    return Columns(headings, [table.iloc[:, k] for k in range(len(headings))], [None] * len(headings), first_line)


def of_channels(channels: Sequence[Channel]) -> Columns:
    """Channels as columns: headings ``name [unit]``, with the group before names that occur twice; time comes first."""
    names = Counter(channel.name for channel in channels)
    headings = []
    for channel in channels:
        group = f"{channel.group}/" if names[channel.name] > 1 else ""
        unit = f" [{channel.unit}]" if channel.unit else ""
        headings.append(f"{group}{channel.name}{unit}")
    cells = [pd.Series(channel.values) for channel in channels]
    stamps = [channel.stamps for channel in channels]
    own = [channel.stamps for channel in channels if channel.stamps is not None]
    if own:
        longest = max(own, key=len)
        headings, cells, stamps = [TIME_HEADING, *headings], [pd.Series(longest), *cells], [None, *stamps]
    return Columns(headings, cells, stamps, 0)
