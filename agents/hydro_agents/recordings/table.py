"""Tables of numbers from measuring programs: comma, semicolon or tab as separator, decimal point or decimal comma."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env import ConfigurationError
from hydro_env.files import read_text

LARGEST_TABLE = 50_000_000
"""Largest size in bytes; about a million rows of four columns."""

_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)


class NumberTable(NamedTuple):
    """Columns of a file."""

    names: tuple[str, ...]  # headings, empty without a line of headings
    values: NDArray[np.float64]  # (rows, columns)
    lines: NDArray[np.int64]  # (rows,), line of the file, from 1


def read_table(path: Path) -> NumberTable:
    """Read a table; the first line may hold headings; empty lines and lines that begin with ``#`` are skipped.

    If the file has semicolons or tabs, these separate columns, and decimals may have commas; otherwise commas separate
    columns. A file with an ambiguous comma (``0,5`` without headings) is an error.

    Raises:
        ConfigurationError: the file is unreadable or empty, a cell is not a number, rows have different lengths, or a
            comma is ambiguous; the message names the line.
    """
    text = read_text(path, LARGEST_TABLE)
    separator = next((mark for mark in ";\t" if mark in text), ",")
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        reader = csv.reader(text.splitlines(), delimiter=separator)
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells) and not cells[0].startswith("#"):
                rows.append(cells)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise ConfigurationError(f"{path}: is not a table: {error}") from None
    names: tuple[str, ...] = ()
    if rows and not any(_NUMBER.fullmatch(cell) for cell in rows[0]):
        names = tuple(rows.pop(0))
        first_line = lines.pop(0)
    if not rows:
        raise ConfigurationError(f"{path}: holds no numbers")
    width = len(names) or len(rows[0])
    for row, line in zip(rows, lines, strict=True):
        if len(row) != width:
            other = first_line if names else lines[0]
            raise ConfigurationError(
                f"{path}: line {line} has {len(row)} columns, line {other} has {width}"
                + ("; if commas separate columns, decimals need a point" if separator == "," else "")
            )
    cells = [cell for row in rows for cell in row]
    if separator == "," and not names and width > 1 and not any("." in cell for cell in cells):
        raise ConfigurationError(
            f"{path}: line {lines[0]}: '{','.join(rows[0])}' may be {width} columns or decimals with a comma; "
            "write decimals with a point, or separate columns by semicolons"
        )
    decimal = "," if any("," in cell for cell in cells) else "."
    for row, line in zip(rows, lines, strict=True):
        for cell in row:
            if not _NUMBER.fullmatch(cell) or not math.isfinite(float(cell.replace(",", "."))):
                raise ConfigurationError(f"{path}: line {line}: {cell[:40]!r} is not a number")
            if decimal == "," and "." in cell:
                raise ConfigurationError(f"{path}: line {line}: '{cell}' has a decimal point, other lines have commas")
    values = np.array([float(cell.replace(",", ".")) for cell in cells]).reshape(len(rows), width)
    return NumberTable(names, values, np.array(lines, dtype=np.int64))
