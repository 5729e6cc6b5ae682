"""Numbers, lists, durations and tables as text, the same on the console, in files and on all pages."""

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

MOST_DECIMALS = 9


def number(value: float, decimals: int | None = None, digits: int = 3) -> str:
    """A number with ``digits`` significant digits, or with ``decimals`` decimals; without exponent; – for NaN.

    The minus is a minus sign (−), and zero has no sign.
    """
    if np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    if decimals is None:
        decimals = decimals_for(value, digits)
    text = f"{value:.{decimals}f}"
    if float(text) == 0.0:
        return text.lstrip("-")
    return text.replace("-", "−")


def decimals_for(size: float, digits: int) -> int:
    """Number of decimals for ``digits`` significant digits of a value of this size."""
    if size == 0.0 or not np.isfinite(size):
        return 0
    return min(max(digits - 1 - int(np.floor(np.log10(abs(size)))), 0), MOST_DECIMALS)


def setting(value: float) -> str:
    """A setting in its shortest form: 0.01, 4, −30."""
    return f"{value:g}".replace("-", "−")


def listed(parts: Sequence[str]) -> str:
    """Parts as a list in a sentence: a, b and c."""
    if len(parts) == 1:
        return parts[0]
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def capitalised(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def duration(seconds: float) -> str:
    """A duration in seconds, minutes or hours, as text."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s"


FAMILY_NAMES = {
    "step": "steps",
    "point_to_point": "point-to-point moves",
    "ramp": "ramps",
    "sine": "sines",
    "multi_sine": "sums of sines",
    "start_stop": "start–stop runs",
    "pause": "moves after a pause",
    "creep": "slow runs",
    "staircase": "small steps",
    "user": "own reference",
}


class Table(NamedTuple):
    """A table of texts; the first column names its rows."""

    caption: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """A table as Markdown: the columns ``left`` hold words, the others numbers, which stand at the right."""
    ends = "|".join("---" if column in left else "---:" for column in range(len(header)))
    lines = [" | ".join(cell.replace("|", r"\|") for cell in line) for line in (header, *rows)]
    return "\n".join([f"| {lines[0]} |", f"|{ends}|", *(f"| {line} |" for line in lines[1:])])


NAME_RULE = r"^\w[\w .+-]{0,39}$"  # names of controllers: they stand in tables, pages, file names and on the terminal
