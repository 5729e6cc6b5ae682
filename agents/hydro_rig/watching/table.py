"""The table of ``hydro trend``: one CSV file with a row per reading; and the recordings that it is made of.

It is written as a whole, so that an interruption leaves no half of it. It may be edited by hand: a mark in the
column ``repaired`` says that the seal was new from that row on, and further columns stay.
"""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from hydro_env import ConfigurationError
from hydro_env.files import write_text
from hydro_env.types import ByName, Floats
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.recordings.files import ENDINGS

SIZES = ["size_40", "low_40", "high_40"]
NUMBERS = [*SIZES, "temperature", "bytes"]
TEXTS = ("time", "until", "axis", "file", "verdict", "reason", "repaired")
COLUMNS = (*TEXTS[:5], *NUMBERS, *TEXTS[5:])
"""Sizes with the ends of their 90 % intervals in l/min at 100 bar and 40 °C; ``temperature`` of the oil in °C;
``bytes`` of the file: a file that has grown is read again; ``repaired``: any mark."""

_DATE = re.compile(r"(?<!\d)20\d\d(?:[-_.:T ]*\d\d)*(?!\d)")  # in the name of a file, with or without a time
_DATE_FOLDERS = re.compile(r"(?:^|/)20\d\d(?:[-_./ ]?W?\d\d?){0,2}(?=/|$)")  # 2026-10-03, 2026/10/03


class File(NamedTuple):
    """A recording."""

    path: Path
    axis: str
    name: str  # in the table: axis, and path within its folder
    size: int  # bytes


def files_of(places: Sequence[Path], table: Path) -> tuple[list[File], str]:
    """The recordings in folders, and single ones, in the order of their names; and what else the folders hold.

    What begins with ``.`` or ``_`` is hidden.

    Raises:
        ConfigurationError: a place does not exist, holds no recording, or holds a file of the same name as another.
    """
    found: dict[str, File] = {}
    others: Counter[str] = Counter()
    own = (table.resolve(), table.with_suffix(".html").resolve())
    for place in places:
        if not place.exists():
            raise ConfigurationError(f"{place}: does not exist")
        single, recordings = place.is_file(), 0
        folder = place.parent if single else place
        for path in [place] if single else sorted(place.rglob("*")):
            parts = path.relative_to(folder).parts
            hidden = not single and any(part.startswith((".", "_")) for part in parts)
            if hidden or not path.is_file() or path.resolve() in own:
                continue
            if not single and path.suffix.lower() not in ENDINGS:
                others[path.suffix or path.name] += 1
                continue
            recordings += 1
            axis, name = axis_of(parts, folder.resolve().name)
            same = found.setdefault(name, File(path, axis, name, path.stat().st_size))
            if same.path.resolve() != path.resolve():
                raise ConfigurationError(f"{path}: {same.path} is '{name}' as well; give the folder above both")
        if not recordings:
            raise ConfigurationError(f"{place}: holds no recording ({', '.join(ENDINGS)})")
    told = ", ".join(f"{count} {ending}" for ending, count in sorted(others.items()))
    return [found[name] for name in sorted(found)], f"files that are no recordings: {told}" if told else ""


def axis_of(parts: Sequence[str], given: str) -> tuple[str, str]:
    """The axis of a file, and the name of the file in the table, from its path below the folder ``given``.

    The axis is the path of the file's folder without dates (``axis=3`` is 3). Without such a folder it is the name of
    the file without its date, or of the given folder if no letter is left.
    """
    *folders, file = parts
    axis = _DATE_FOLDERS.sub("", "/".join(part.split("=", 1)[-1] for part in folders)).strip("/")
    if not axis:
        stem = _DATE.sub("", Path(file.removesuffix(".gz")).stem).strip(" -_.")
        axis = stem if any(map(str.isalpha, stem)) else given or "axis"
    dates = [part for part in folders if part.split("=", 1)[-1] not in axis.split("/")]
    return axis, "/".join([axis, *dates, file])


def read_table(path: Path) -> pd.DataFrame:
    """The rows so far; none if the file does not exist; ConfigurationError: the file is no such table."""
    if not path.exists():
        return pd.DataFrame({name: pd.Series(dtype=str if name in TEXTS else float) for name in COLUMNS})
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(TEXTS, str), keep_default_na=False, na_values=[""])
        if missing := [name for name in COLUMNS if name not in table]:
            raise ValueError(f"has no column '{missing[0]}'")
        table = table.fillna(dict.fromkeys(TEXTS, ""))
        table[NUMBERS] = table[NUMBERS].astype(float)
        seconds(table["time"]), seconds(table["until"])
        if not set(table["verdict"]) <= set(Kind) or (table[["axis", "file"]] == "").any(axis=None):
            raise ValueError("an axis, a file or a verdict is missing")
    except ValueError as error:
        raise ConfigurationError(f"{path}: is no table of hydro trend: {' '.join(str(error).split())[:200]}") from None
    return table


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write the rows."""
    write_text(path, table.to_csv(index=False, lineterminator="\n"))


def with_row(table: pd.DataFrame, file: File, found: ByName) -> pd.DataFrame:
    """The table with the row of a file, in place of an older one of the same file; in the order of axis and time."""
    old = table["file"] == file.name
    row = found | {
        "axis": file.axis,
        "file": file.name,
        "bytes": file.size,
        "time": stamp(found["time"]),
        "until": stamp(found["until"]),
        "repaired": "".join(table["repaired"][old][:1]),
    }
    fresh = pd.DataFrame([row]).round(5)
    whole = pd.concat([table[~old], fresh], ignore_index=True) if (~old).any() else fresh
    names = [*COLUMNS, *(name for name in table if name not in COLUMNS)]
    return whole.reindex(columns=names).sort_values(["axis", "time"], kind="stable", ignore_index=True)


def stamp(time: float) -> str:
    """Seconds since 1970 as ``2026-10-03T08:00:00``."""
    return pd.Timestamp(time, unit="s").strftime("%Y-%m-%dT%H:%M:%S")


def seconds(stamps: pd.Series) -> Floats:
    """Seconds since 1970 of ``2026-10-03T08:00:00`` or ``2026-10-03``; ValueError: a text is no date."""
    when = pd.to_datetime(stamps, utc=True, format="ISO8601")
    return (when - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(float)
