"""Finds the table in a text file of a measuring program: the lines of its head, headings, a line of units, numbers."""

from __future__ import annotations

import csv
import re
from typing import NamedTuple

from hydro_agents.recordings.columns import split_heading
from hydro_agents.recordings.units import UNITS

MOST_LINES = 200
"""Lines in which the headings must stand."""


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
    What stands before the headings, empty lines and lines that begin with ``#`` are skipped.

    Raises:
        csv.Error: a line is too long for a table.
    """
    lines = _lines(text)
    if not lines:
        return None
    separator = next((mark for mark in ";\t" if 2 * sum(mark in line.text for line in lines) > len(lines)), ",")
    rows = [_cells(line.text, separator) for line in lines]
    widths = [len(row) for row in rows]
    usual = max(set(widths), key=widths.count)
    place = next((k for k, row in enumerate(rows) if len(row) == usual and _are_headings(row)), 0)
    headings = rows[place]
    if place + 1 < len(rows) and len(rows[place + 1]) == len(headings) and _are_units(rows[place + 1]):
        place += 1
        headings = [_with_unit(name, unit) for name, unit in zip(headings, rows[place], strict=True)]
    return Found(headings, separator, lines[place].end, lines[place].number + 1)


class _Line(NamedTuple):
    end: int  # characters up to the next line
    number: int  # from 1
    text: str


def _lines(text: str) -> list[_Line]:
    """The first lines that are neither empty nor comments."""
    lines: list[_Line] = []
    start, number = 0, 0
    while start < len(text) and len(lines) < MOST_LINES:
        end = text.find("\n", start)
        end = end if end >= 0 else len(text)
        line, number = text[start:end].strip("\r"), number + 1
        if line.strip() and not line.lstrip().startswith("#"):
            lines.append(_Line(end + 1, number, line))
        start = end + 1
    return lines


def _cells(line: str, separator: str) -> list[str]:
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
