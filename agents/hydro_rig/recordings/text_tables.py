"""Tables in text files: where headings and numbers stand, and how ``pandas`` reads them."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from hydro_env import ConfigurationError
from hydro_rig.recordings.columns import UNITS, split_heading

OTHER_ENCODING = "cp1252"  # of texts that are not UTF-8: that of Western Windows programs
MOST_LINES = 200  # in which the headings must stand

SPACES = r"\s+"  # any number of spaces between two columns

_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)


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


def found_table(text: str, path: Path) -> Found:
    """Where the table of a file stands (:func:`find_table`).

    Raises:
        ConfigurationError: there is none.
    """
    try:
        found = find_table(text)
    except csv.Error as error:
        raise ConfigurationError(f"{path}: is not a table: {error}") from None
    if found is None:
        raise ConfigurationError(f"{path}: holds no table")
    return found


def decoded(content: bytes) -> tuple[str, str]:
    """Encoding and text of the beginning of a file."""
    try:
        return "utf-8-sig", content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return OTHER_ENCODING, content.decode(OTHER_ENCODING, "replace")


def decimal_of(found: Found, text: str) -> str:
    """The decimal mark of a table's numbers."""
    return "," if found.separator != "," and "," in text[found.start : found.start + 100_000] else "."


def csv_options(found: Found, decimal: str) -> dict[str, Any]:
    """Options of ``pandas.read_csv`` for the rows of a table."""
    return {
        "sep": found.separator,
        "decimal": decimal,
        "header": None,
        "names": range(len(found.headings)),
        "index_col": False,
        "skipinitialspace": True,
        "low_memory": False,
    }


@contextmanager
def csv_errors(path: Path) -> Iterator[None]:
    """Errors of ``pandas.read_csv`` in one line each.

    Raises:
        ConfigurationError: for any of them.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            yield
    except pd.errors.ParserWarning:
        raise ConfigurationError(f"{path}: rows have more columns than the line of headings") from None
    except (ValueError, OverflowError, RecursionError) as error:  # pandas' own errors are ValueErrors
        raise ConfigurationError(f"{path}: is not a table: {' '.join(str(error).split())[:200]}") from None
