"""Tables in text files: where headings and numbers stand, and the rows."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from hydro_env import ConfigurationError
from hydro_rig.recordings.columns import UNITS, split_heading

OTHER_ENCODING = "cp1252"  # of texts that are not UTF-8: that of Western Windows programs
BEGINNING = 200_000  # bytes, in which the headings stand
MOST_LINES = 200  # in which the headings must stand
SPACES = r"\s+"  # any number of spaces between two columns
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
_UNITS = {unit for units in UNITS.values() for unit in units} - {"1", "-"}


class Layout(NamedTuple):
    """Where a table stands in a text, and how it is written."""

    headings: list[str]
    separator: str
    decimal: str  # mark of its numbers
    first_line: int  # line of the first row, from 1


def text_table(path: Path) -> tuple[pd.DataFrame, int]:
    """The rows of a table with their headings, and the line of the first.

    Raises:
        ConfigurationError: the file cannot be read, or is not a table.
    """
    encoding, text = _beginning(path)
    try:
        layout = layout_of(text)
        table = pd.DataFrame() if layout is None else _rows(path, encoding, layout)
    except pd.errors.ParserWarning:
        raise ConfigurationError(f"{path}: rows have more columns than the line of headings") from None
    except csv.Error:
        raise ConfigurationError(f"{path}: is not a table: it holds other bytes than text, or endless lines") from None
    except (ValueError, OverflowError, RecursionError) as error:  # pandas' own errors are ValueErrors
        raise ConfigurationError(f"{path}: is not a table: {' '.join(str(error).split())[:200]}") from None
    if layout is None:
        raise ConfigurationError(f"{path}: holds no table")
    return table.set_axis(layout.headings, axis=1), layout.first_line


def _rows(path: Path, encoding: str, layout: Layout) -> pd.DataFrame:
    with open(path, encoding=encoding, errors="replace", newline="\n") as file, warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        for _ in range(layout.first_line - 1):
            file.readline()
        return pd.read_csv(
            file,
            sep=layout.separator,
            decimal=layout.decimal,
            header=None,
            names=range(len(layout.headings)),
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
        )


def layout_of(text: str) -> Layout | None:
    """Headings and first row of a table, from the beginning of its file; ``None``: it holds no line.

    The headings are the first line that has as many cells as most lines, more than half of them filled and none a
    number; without such a line, the first one. If the line below holds units, each heading gets its own: ``P_A [bar]``.
    What stands before the headings, empty lines and lines that begin with ``#`` or ``%`` are skipped; without headings,
    the last comment above the numbers counts if it has as many cells. Spaces separate columns where nothing else does.

    Raises:
        csv.Error: a line is too long for a table.
        ValueError: the line above the numbers has another number of cells.
    """
    lines = text.split("\n")
    used = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)][:MOST_LINES]
    if not used:
        return None
    separator = _separator_of([lines[k] for k in used])
    rows = [_cells(lines[k].strip("\r"), separator) for k in used]
    widths = [len(row) for row in rows]
    usual = max(set(widths), key=widths.count)
    place = _headings_among(rows, usual)
    if place is None:
        comment = _last_comment(lines[: used[0]], separator)
        if len(comment) == usual and _are_headings(comment):
            return _layout(comment, separator, used[0] + 1, text)
        place = _line_above_numbers(rows, usual, used)
    headings = rows[place]
    below = rows[place + 1] if place + 1 < len(rows) else []
    if len(below) == len(headings) and _are_units(below):
        place += 1
        headings = [_with_unit(name, unit) for name, unit in zip(headings, below, strict=True)]
    return _layout(headings, separator, used[place] + 2, text)


def _separator_of(lines: Sequence[str]) -> str:
    """A mark that stands in most lines; else spaces, if the last line holds numbers alone."""
    for mark in ";\t,":
        if 2 * sum(mark in line for line in lines) > len(lines):
            return mark
    return SPACES if all(_NUMBER.fullmatch(cell) for cell in lines[-1].split()) else ","


def _headings_among(rows: Sequence[list[str]], usual: int) -> int | None:
    for place, row in enumerate(rows):
        if len(row) == usual and _are_headings(row):
            return place
    return None


def _last_comment(lines: Sequence[str], separator: str) -> list[str]:
    """Cells of the last comment among the lines above a table."""
    comments = [line.strip().lstrip("#% ") for line in lines if _is_comment(line)]
    if not comments:
        return []
    return _cells(comments[-1], "," if separator == SPACES and "," in comments[-1] else separator)


def _line_above_numbers(rows: Sequence[list[str]], usual: int, lines: Sequence[int]) -> int:
    """Place of the row above the first with numbers; ``lines``: number of the line of each row, from 0.

    A separator at the end of lines makes no column.
    """
    first = 0
    for place, row in enumerate(rows):
        if len(row) == usual and any(map(_NUMBER.fullmatch, row)):
            first = place
            break
    if first == 0:
        return 0
    above = rows[first - 1]
    shorter = min(len(above), usual)
    if len(above) != usual and any(any(row[shorter:]) for row in [above, *rows[first:]]):
        raise ValueError(
            f"line {lines[first - 1] + 1} with the headings has {len(above)} cells, the rows below it {usual}"
        )
    return first - 1


def _layout(headings: list[str], separator: str, first_line: int, text: str) -> Layout:
    rows = text.split("\n", first_line - 1)[-1]
    return Layout(headings, separator, "," if separator != "," and "," in rows else ".", first_line)


def _beginning(path: Path) -> tuple[str, str]:
    """Encoding of a file, and the whole lines of its beginning."""
    try:
        with open(path, "rb") as file:
            content = file.read(BEGINNING)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:  # it holds a null or a surrogate
        raise ConfigurationError(f"{str(path)!a}: is no possible file name") from None
    if len(content) == BEGINNING:
        content = content[: content.rfind(b"\n") + 1]
    try:
        return "utf-8-sig", content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return OTHER_ENCODING, content.decode(OTHER_ENCODING, "replace")


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _cells(line: str, separator: str) -> list[str]:
    if separator == SPACES:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def _are_headings(cells: list[str]) -> bool:
    """More than half of the cells are filled, and none is a number."""
    return 2 * sum(map(bool, cells)) > len(cells) and not any(map(_NUMBER.fullmatch, cells))


def _are_units(cells: list[str]) -> bool:
    """Whether cells are units, in brackets or not: most of those that are not empty are known ones."""
    units = [cell.strip("[]()").replace("μ", "u").replace("µ", "u") for cell in cells if cell]
    return 2 * sum(unit in _UNITS for unit in units) > len(units)


def _with_unit(name: str, unit: str) -> str:
    unit = unit.strip("[]()")
    return f"{name} [{unit}]" if unit and split_heading(name)[1] is None else name
