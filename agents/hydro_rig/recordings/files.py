"""Files of measuring programs as columns: CSV, Parquet, MDF4, TDMS and MAT.

Channels of MDF4 and TDMS, and a struct of a MAT file that holds a time, have their own time stamps, which are kept.
:func:`together` brings the chosen channels to the stamps of the command, and reports it as a finding.
"""

from __future__ import annotations

import importlib
import logging
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
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.text_tables import text_table

LARGEST_RECORDING = 1_000_000_000  # largest size in bytes; about twenty hours at 200 rows per second as CSV

LONGEST_STEP = 2.0
"""Longest distance between a channel's own stamps for interpolation, as a multiple of the usual distance."""

AS_FAST = 1.5  # longest usual distance of a channel's stamps for interpolation, as a multiple of that of the command

TIME_HEADING = "time [s]"  # heading of the common time of channels with their own stamps
TIMES = ("time", "t", "zeit", "timestamps")
CONTENTS = ("values", "value", "data", "signals", "signal")
"""Names of the fields of a MAT struct that hold its time, and its numbers, in lower case."""


class Channel(NamedTuple):
    """A channel with or without (None) its own time stamps."""

    group: str
    name: str
    unit: str
    values: Any
    stamps: Floats | None


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
    try:
        size = path.stat().st_size
    except (OSError, ValueError):  # the reader says why
        size = 0
    if size > LARGEST_RECORDING:
        raise ConfigurationError(f"{path}: is larger than {LARGEST_RECORDING / 1e6:g} MB; cut it into several files")
    columns = _columns(path)
    if not columns.cells or not max(map(len, columns.cells)):
        raise ConfigurationError(f"{path}: holds {'headings but no rows' if columns.first_line else 'no numbers'}")
    return columns


def _columns(path: Path) -> Columns:
    kind = path.suffix.lower()
    if kind == ".parquet":
        with library_errors(path, "pyarrow.parquet") as parquet, parquet.ParquetFile(path) as file:
            return of_table(file.read().to_pandas())
    if kind in READERS:
        library, read = READERS[kind]
        with library_errors(path, library) as module:
            return of_channels(read(path, module))
    return of_table(*text_table(path))


def started(path: Path) -> float | None:
    """Start of a measurement that the header of an MDF4 file gives, s since 1970; ``None`` for other files."""
    if path.suffix.lower() not in (".mf4", ".mdf"):
        return None
    with library_errors(path, "asammdf") as asammdf, _open_mdf(path, asammdf) as file:
        return float(file.header.start_time.timestamp())


@contextmanager
def library_errors(path: Path, library: str) -> Iterator[Any]:
    """The library that reads a file, and its errors in one line each.

    Raises:
        ConfigurationError: it is not installed, or any of its errors.
    """
    if not path.is_file() and not any(path.glob("*.parquet")):
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
        raise ConfigurationError(f"{path}: is not a readable {path.suffix.lower() or library} file: {reason}") from None


def together(columns: Columns, places: Mapping[str, int]) -> tuple[dict[str, pd.Series], list[Finding]]:
    """The chosen columns by signal, all with the same rows.

    Columns with their own time stamps that are as dense as those of the command are interpolated linearly at these,
    never extrapolated, and are missing (NaN) in their gaps. A reading of a slower one stands in the row of the nearest
    stamp; between two of them nothing is known. A finding names each such signal.

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
        values = numbers_of(columns.cells[place])
        usual, row = _usual_step(own), _usual_step(base)
        what = f"has its own time stamps, one every {1e3 * usual:.4g} ms; "
        if usual > AS_FAST * row:
            cells[signal] = pd.Series(placed(base, own, values, 0.5 * row))
            what += "its readings stand in the nearest rows of the command"
        else:
            cells[signal] = pd.Series(interpolated(base, own, values))
            what += "it is interpolated at those of the command"
        findings.append(Finding(signal, what, Weight.NOTE))
    return cells, findings


def _usual_step(stamps: Floats) -> float:
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else np.nan


def numbers_of(cells: pd.Series) -> Floats:
    """The values of cells; what is no number is NaN."""
    return np.array(pd.to_numeric(cells, errors="coerce").to_numpy(np.float64, na_value=np.nan))


def interpolated(time: Floats, own: Floats, values: Floats, longest: float = 0.0) -> Floats:
    """Values at ``time`` between the samples (own, values); NaN before, after, and in gaps.

    A gap is longer than ``longest``; default: LONGEST_STEP usual steps.
    """
    order = np.argsort(own, kind="stable")
    own, values = own[order], values[order]
    if len(own) < 2:
        return np.full(len(time), np.nan)
    after = np.clip(np.searchsorted(own, time), 1, len(own) - 1)
    step = own[after] - own[after - 1]
    inside = (time >= own[0]) & (time <= own[-1]) & (step <= (longest or LONGEST_STEP * np.median(np.diff(own))))
    share = (time - own[after - 1]) / np.where(step > 0.0, step, 1.0)
    between = values[after - 1] + share * (values[after] - values[after - 1])
    return np.where(inside, between, np.nan)


def placed(time: Floats, own: Floats, values: Floats, farthest: float) -> Floats:
    """Values at the nearest ``time``, rising, of the samples (own, values), if no farther away; NaN elsewhere."""
    after = np.clip(np.searchsorted(time, own), 1, len(time) - 1)
    nearest = after - (own - time[after - 1] < time[after] - own)
    near = np.abs(time[nearest] - own) <= farthest
    there = np.full(len(time), np.nan)
    there[nearest[near]] = values[near]
    return there


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


# MDF4 ---------------------------------------------------------------------------------------------------------------


def _open_mdf(path: Path, asammdf: Any) -> Any:
    """The file; the library prints nothing of its own about a damaged one."""
    asammdf.blocks.mdf_v4.MDF4.__del__ = lambda file: None
    logging.getLogger("asammdf").disabled = True
    return asammdf.MDF(path)


def read_mdf(path: Path, asammdf: Any) -> list[Channel]:
    """All numeric channels."""
    channels: list[Channel] = []
    with _open_mdf(path, asammdf) as file:
        places = [(number, place) for number, group in enumerate(file.groups) for place in range(len(group.channels))]
        for number, place in places:
            if place == file.masters_db.get(number):
                continue
            signal = file.get(group=number, index=place)
            if np.ndim(signal.samples) == 1 and np.issubdtype(signal.samples.dtype, np.number):
                # Copies: what the library gives are views of the records of all channels.
                values, stamps = signal.samples.copy(), np.array(signal.timestamps, dtype=np.float64)
                if not np.isfinite(stamps).all():
                    raise ValueError(f"the stamps of {signal.name} are no numbers")
                channels.append(Channel(f"group {number}", signal.name, signal.unit or "", values, stamps))
    return channels


# TDMS ---------------------------------------------------------------------------------------------------------------


def read_tdms(path: Path, nptdms: Any) -> list[Channel]:
    """All channels with values; only a waveform has stamps, otherwise a column of the file is the time."""
    found = [channel for group in nptdms.TdmsFile.read(path).groups() for channel in group.channels() if len(channel)]
    starts = [np.datetime64(channel.properties.get("wf_start_time", 0), "us").astype(float) for channel in found]
    first = min((start for start in starts if start > 0.0), default=0.0)  # an unknown start is none, or 1904
    channels = []
    for channel, start in zip(found, starts, strict=True):
        values, properties, stamps = channel[:], channel.properties, None
        if "wf_increment" in properties:
            begin = 1e-6 * max(start - first, 0.0) + float(properties.get("wf_start_offset", 0.0))
            stamps = begin + float(properties["wf_increment"]) * np.arange(len(values))
        unit = str(properties.get("unit_string", ""))
        channels.append(Channel(channel.group_name, channel.name, unit, values, stamps))
    return channels


# MAT ----------------------------------------------------------------------------------------------------------------


def read_mat(path: Path, scipy_io: Any) -> list[Channel]:
    """Vectors and structs of a MAT file of version 5 to 7; version 7.3 is another format."""
    content = scipy_io.loadmat(path, simplify_cells=True)
    channels: list[Channel] = []
    for name, value in content.items():
        if not name.startswith("__"):
            channels += _channels_of(name, value)
    return channels


def _channels_of(name: str, value: Any, stamps: Floats | None = None, unit: str = "") -> Iterator[Channel]:
    """The channels in a variable of a MAT file: a vector, or a struct of vectors, of structs, or of a list of them."""
    if isinstance(value, dict):
        fields = {key.lower(): part for key, part in value.items()}
        time = next((_vector(fields[key]) for key in TIMES if key in fields), None)
        stamps = time if time is not None else stamps
        unit = next((fields[key] for key in ("unit", "units") if isinstance(fields.get(key), str)), unit)
        for key, part in value.items():
            if key.lower() not in TIMES or time is None:
                yield from _channels_of(name if key.lower() in CONTENTS else f"{name}.{key}", part, stamps, unit)
    elif isinstance(value, list):
        for number, part in enumerate(value, 1):
            label = part.get("label") if isinstance(part, dict) else None
            yield from _channels_of(str(label) if label else f"{name}.{number}", part, stamps, unit)
    else:
        values = _vector(value)
        if values is not None and (stamps is None or len(values) == len(stamps)):
            yield Channel("", name, unit, values, stamps)


def _vector(value: Any) -> Floats | None:
    """Numbers (n,), n at least 2; ``None``: something else."""
    whole = isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value)
    return np.ravel(value).astype(np.float64) if whole and value.size == max(value.shape, default=0) > 1 else None


READERS: dict[str, tuple[str, Callable[[Path, Any], list[Channel]]]] = {
    ".mf4": ("asammdf", read_mdf),
    ".mdf": ("asammdf", read_mdf),
    ".tdms": ("nptdms", read_tdms),
    ".mat": ("scipy.io", read_mat),
}
"""Library and reader of files of channels, by the end of their names."""
