"""The table of ``hydro trend``: one CSV file with a row per reading, to which each call adds the files it has not read.

The table is written as a whole after each file, so that an interruption loses nothing. It may be edited by hand: a
mark in the column ``repaired`` says that the seal was new from that row on, and further columns stay.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_env import ConfigurationError
from hydro_env.files import write_text
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.monitoring.oil import Oil

SIZES = ("size", "low", "high", "moving", "temperature", "size_40", "low_40", "high_40")
NEEDED = ("time", "until", "axis", "file", "verdict")
TEXTS = (*NEEDED, "reason", "oil", "repaired")
COLUMNS = (*NEEDED, *SIZES, "oil", "reason", "bytes", "clock_back", "repaired")
"""Sizes with the ends of their 90 % intervals in l/min at 100 bar, as measured and at 40 °C; ``moving`` is a share;
``temperature`` in °C; ``bytes`` of the file: a file that has grown is read again; ``clock_back``: by how much the clock
ran back, s; ``repaired``: any mark."""

SUFFIXES = (".csv", ".txt", ".tsv", ".parquet", ".mat")
DECIMALS = 5

_DATE_FOLDERS = re.compile(r"(?:^|/)20\d\d(?:[-_./ ]?W?\d\d?){0,2}(?=/|$)")  # 2026-10-03, 2026/10/03
_DATE = re.compile(r"(?<!\d)20\d\d(?:[-_.:T ]*\d\d)*(?!\d)")  # in the name of a file, with or without a time


class File(NamedTuple):
    """A recording."""

    path: Path
    axis: str
    name: str  # in the table: axis, and path within its folder
    size: int  # bytes
    changed: float = 0.0  # s since 1970


def files_of(places: Sequence[Path], table: Path) -> tuple[list[File], str]:
    """The recordings in folders, and single ones, in the order of their names; and what else the folders hold.

    What begins with ``.`` or ``_`` is hidden.

    Raises:
        ConfigurationError: a place does not exist, holds no recording, or holds a file of the same name as another.
    """
    found: dict[str, File] = {}
    others: Counter[str] = Counter()
    own = {table.resolve(), table.with_suffix(".html").resolve()}
    for place in places:
        if not place.exists():
            raise ConfigurationError(f"{place}: does not exist")
        folder = place if place.is_dir() else place.parent
        paths = [path for path in place.rglob("*") if _visible(path, place)] if place.is_dir() else [place]
        paths = [path for path in paths if path.resolve() not in own]
        recordings = [path for path in paths if path.suffix.lower() in SUFFIXES or path == place]
        others.update(path.suffix or path.name for path in {*paths} - {*recordings})
        if not recordings:
            raise ConfigurationError(f"{place}: holds no recording ({', '.join(SUFFIXES)})")
        for path in recordings:
            (axis, name), facts = _axis_of(path, folder), path.stat()
            same = found.setdefault(name, File(path, axis, name, facts.st_size, facts.st_mtime))
            if same.path.resolve() != path.resolve():
                raise ConfigurationError(f"{path}: {same.path} is '{name}' as well; give the folder above both")
    told = ", ".join(f"{count} {ending}" for ending, count in sorted(others.items()))
    return [found[name] for name in sorted(found)], f"files that are no recordings: {told}" if told else ""


def _visible(path: Path, place: Path) -> bool:
    return path.is_file() and not any(part.startswith((".", "_")) for part in path.relative_to(place).parts)


def _axis_of(path: Path, folder: Path) -> tuple[str, str]:
    """The axis of a file, and the name of the file in the table.

    The axis is the path of the file's folder below the given one, without dates (``axis=3`` is 3). Without such a
    folder it is the name of the file without its date, or of the given folder if no letter is left.
    """
    parts = [part.split("=", 1)[-1] for part in path.relative_to(folder).parts[:-1]]
    axis = _DATE_FOLDERS.sub("", "/".join(parts)).strip("/")
    if not axis:
        stem = _DATE.sub("", path.stem).strip(" -_.")
        axis = stem if any(map(str.isalpha, stem)) else folder.resolve().name or "axis"
    dates = [part for part in path.relative_to(folder).parts[:-1] if part.split("=", 1)[-1] not in axis.split("/")]
    return axis, "/".join([axis, *dates, path.name])


def read_table(path: Path) -> pd.DataFrame:
    """The rows so far; none if the file does not exist.

    Raises:
        ConfigurationError: the file is no such table.
    """
    if not path.exists():
        return pd.DataFrame({name: pd.Series(dtype=str if name in TEXTS else float) for name in COLUMNS})
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(TEXTS, str), keep_default_na=False, na_values=[""])
        for name in COLUMNS:
            if name not in table:
                raise ValueError(f"it has no column '{name}'")
        for name in NEEDED:
            if table[name].isna().any():
                raise ValueError(f"column '{name}' has an empty cell")
        for name in (*SIZES, "bytes", "clock_back"):
            table[name] = pd.to_numeric(table[name])
            if (table[name].abs() > 1e15).any():
                raise ValueError(f"'{name}' goes beyond 1e15")
        seconds(table["time"]), seconds(table["until"])
        unknown = {*table["verdict"]} - {*Kind}
        if unknown:
            raise ValueError(f"verdict '{min(unknown)}': must be one of {', '.join(Kind)}")
    except ValueError as error:
        raise ConfigurationError(f"{path}: is no table of hydro trend: {' '.join(str(error).split())[:200]}") from None
    return table.fillna(dict.fromkeys(TEXTS, ""))


def unread(files: Iterable[File], table: pd.DataFrame) -> list[File]:
    """The files that are not in the table, or have another size than when they were read."""
    known = dict(zip(table["file"], table["bytes"], strict=True))
    return [file for file in files if known.get(file.name) != file.size]


def with_rows(table: pd.DataFrame, file: File, found: Mapping[str, NDArray[Any]], oil: Oil) -> pd.DataFrame:
    """The table with the rows of a file, in place of older ones of the same file; in the order of axis and time."""
    fresh = pd.DataFrame(dict(found)).assign(
        time=[stamp(value) for value in found["time"]],
        until=[stamp(value) for value in found["until"]],
        file=file.name,
        bytes=file.size,
        oil=f"{oil.at_40:g}/{oil.at_100:g}",
    )
    numbers = [*SIZES, "clock_back"]
    fresh[numbers] = fresh[numbers].astype(np.float64).round(DECIMALS)
    old = table[table["file"] == file.name]
    marks = dict(zip(old["time"], old["repaired"], strict=True))
    fresh["repaired"] = [marks.get(when, "") for when in fresh["time"]]
    rest = table[table["file"] != file.name]
    whole = fresh if rest.empty else pd.concat([rest, fresh], ignore_index=True)
    names = [*COLUMNS, *(name for name in table if name not in COLUMNS)]
    return whole.reindex(columns=names).sort_values(["axis", "time"], kind="stable", ignore_index=True)


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write the whole table.

    Raises:
        ConfigurationError: it cannot be written.
    """
    text = table.assign(bytes=table["bytes"].astype("Int64")).to_csv(index=False, lineterminator="\n")
    write_text(path, text)


def stamp(time: float) -> str:
    """Seconds since 1970 as ``2026-10-03T08:00:00``."""
    return datetime.fromtimestamp(float(time), UTC).strftime("%Y-%m-%dT%H:%M:%S")


def seconds(stamps: pd.Series) -> NDArray[np.float64]:
    """Seconds since 1970 of ``2026-10-03T08:00:00`` or ``2026-10-03``.

    Raises:
        ValueError: a text is no date.
    """
    when = pd.to_datetime(stamps, utc=True, format="ISO8601")
    found: NDArray[np.float64] = (when - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(dtype=np.float64)
    return found
