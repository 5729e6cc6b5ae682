"""Tables in text files: where headings and numbers stand, and the rows."""

import codecs
import csv
import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from hydro_env.files import encoding_of
from hydro_env.units import split_heading
from hydro_rig.recordings.columns import UNITS

OTHER_ENCODING = "cp1252"  # of texts that are not UTF-8: that of Western Windows programs
BEGINNING = 200_000  # bytes, in which the headings stand
MOST_LINES = 400  # in the first half of which the headings must stand; and so many show how numbers are written
SPACES = r"\s+"  # any number of spaces between two columns
HEADER_END = "***End_of_Header***"  # closes each header of LabVIEW's .lvm
_NUMBER = re.compile(
    r"[+-]?(?:[1-9]\d{0,2}(?:(?P<group>[., '])\d{3})(?:(?P=group)\d{3})*|\d+|(?=[.,]\d))(?:(?P<mark>[.,])\d*)?"
    r"(?:[eE][+-]?\d+)?",
    re.ASCII,
)
_UNITS = {unit for units in UNITS.values() for unit in units} - {"1", "-"}


def text_table(source: Path | io.BytesIO) -> tuple[pd.DataFrame, int]:
    """The rows of a table with their headings, and the line of the first.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not a table; pandas' own errors are such.
        csv.Error: it holds other bytes than text, or endless lines.
    """
    with open(source, "rb") if isinstance(source, Path) else source as file, warnings.catch_warnings():
        encoding, text = _beginning(file)
        headings, first_line, writing = _layout(text)
        file.seek(0)
        lines = io.TextIOWrapper(file, encoding, errors="replace", newline="\n")
        for _ in range(first_line - 1):
            lines.readline()
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            table = pd.read_csv(
                lines,
                **writing,
                header=None,
                names=range(len(headings)),
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
            )
        except pd.errors.ParserWarning:
            raise ValueError("rows have more columns than the line of headings") from None
    return table.set_axis(headings, axis=1), first_line


def _layout(text: str) -> tuple[list[str], int, dict[str, str | None]]:
    """Headings, line of the first row from 1, and separator and marks of numbers, from the beginning of a file.

    The headings stand above a row with numbers; they have as many cells as most lines of the later half, more than half
    of them filled and none a number. Without such a line, the first one counts. If the line below holds units, each
    heading gets its own: ``P_A [bar]``. What stands before the headings, empty lines and lines with ``#`` or ``%`` are
    skipped; without headings, the last comment above the numbers counts if it has as many cells. Spaces separate
    columns where nothing else does.

    Raises:
        csv.Error: a line is too long for a table.
        ValueError: it holds no line, or the one above the numbers has another number of cells.
    """
    lines = text.split("\n")
    header = max((k + 1 for k, line in enumerate(lines) if line.startswith(HEADER_END)), default=0)
    filled = [k for k in range(header, len(lines)) if lines[k].strip() and not _is_comment(lines[k])]
    used = filled[:MOST_LINES]
    if not used:
        raise ValueError("it holds no table")
    half = len(used) // 2
    separator = _separator_of([lines[k] for k in used[half:]])
    rows = [_cells(lines[k], separator) for k in used]
    widths = list(map(len, rows[half:]))
    usual = max(set(widths), key=widths.count)
    decimal, thousands = _marks([_cells(lines[k], separator) for k in filled[:: len(filled) // MOST_LINES + 1]])
    writing = {"sep": separator, "decimal": decimal, "thousands": thousands}
    place = 0 if header else _headings_among(rows, usual)
    comment = _last_comment(lines[: used[0]], separator)
    if place is None and len(comment) == usual and _are_headings(comment):
        return comment, used[0] + 1, writing
    if place is None:
        place = _line_above_numbers(rows, usual, used)
    headings = rows[place]
    below = [*rows, []][place + 1]
    if len(below) == len(headings) and _are_units(below):
        place += 1
        headings = [_with_unit(name, unit) for name, unit in zip(headings, below, strict=True)]
    return headings, used[place] + 2, writing


def _separator_of(lines: Sequence[str]) -> str:
    """A mark that stands in most lines; else spaces, if the last line holds numbers alone."""
    for mark in ";\t,":
        if 2 * sum(mark in line for line in lines) > len(lines):
            return mark
    return SPACES if all(map(_NUMBER.fullmatch, lines[-1].split())) else ","


def _headings_among(rows: Sequence[list[str]], usual: int) -> int | None:
    """Place of the headings: the first that stand above numbers, or above units; otherwise the first line like them."""
    alike = [place for place, row in enumerate(rows) if len(row) == usual and _are_headings(row)]
    for place in alike:
        if place + 1 < len(rows) and len(rows[place + 1]) == usual and any(map(_NUMBER.fullmatch, rows[place + 1])):
            return place - (place - 1 in alike and _are_units(rows[place]))
    return alike[0] if alike else None


def _marks(rows: Sequence[list[str]]) -> tuple[str, str | None]:
    """Decimal mark of the numbers in rows, and the mark between their thousands.

    Without a doubtless decimal mark, as in 12.5, that of three digits counts as one: 1,234 is less than two.
    """
    numbers = [found for row in rows for cell in row if (found := _NUMBER.fullmatch(cell))]
    marks = [found["mark"] for found in numbers if found["mark"]]
    groups = [found["group"] for found in numbers if found["group"]]
    doubtless = marks or [mark for mark in groups if mark in ".,"]
    decimal = max(set(doubtless), key=doubtless.count, default=".")
    return decimal, max(set(groups) - {decimal}, default=None)


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
    numbers = (place for place, row in enumerate(rows) if len(row) == usual and any(map(_NUMBER.fullmatch, row)))
    first = next(numbers, 0)
    if first == 0:
        return 0
    above = rows[first - 1]
    shorter = min(len(above), usual)
    if len(above) != usual and any(any(row[shorter:]) for row in [above, *rows[first:]]):
        raise ValueError(
            f"line {lines[first - 1] + 1} with the headings has {len(above)} cells, the rows below it {usual}"
        )
    return first - 1


def _beginning(file: io.BufferedIOBase) -> tuple[str, str]:
    """Encoding of a file, and the whole lines of its beginning."""
    content = file.read(BEGINNING)
    encoding, whole = encoding_of(content), len(content) < BEGINNING
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(content, final=whole)
    except UnicodeDecodeError:
        encoding, text = OTHER_ENCODING, content.decode(OTHER_ENCODING, "replace")
    return encoding, text if whole else text[: text.rfind("\n") + 1]


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _cells(line: str, separator: str) -> list[str]:
    if separator == SPACES:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line.strip("\r")], delimiter=separator, skipinitialspace=True))]


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
