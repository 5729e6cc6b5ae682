"""The one table of ``hydro benchmark``: rows, their medians and ratios, and its two files."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hydro_env import ConfigurationError
from hydro_env.files import write_whole

COLUMNS = (
    *("group", "row", "unit", "runs", "median", "lowest", "highest"),
    *("against", "ratio", "ratio_lowest", "ratio_highest", "note", "values"),
)


class UnavailableError(Exception):
    """What a row measures is not there on this machine; the message says why."""


@dataclass(frozen=True)
class Row:
    """One line of the table: what it is, its unit, and the row of the same group that it is set beside."""

    name: str
    unit: str
    against: str = ""
    note: str = ""


@dataclass(frozen=True)
class Case:
    """One measurement, which fills one or more rows.

    ``measure(run)`` gives a value per row; it may raise :class:`UnavailableError`. Whatever is built or compiled
    beforehand is not in its values.
    """

    rows: tuple[Row, ...]
    measure: Callable[[int], Sequence[float]]
    runs: int


@dataclass
class Result:
    """A row with what was measured, one value per run."""

    group: str
    row: Row
    values: list[float] = field(default_factory=list)
    note: str = ""

    @property
    def median(self) -> float:
        """Of the runs."""
        return statistics.median(self.values)


def ratios(result: Result, results: Iterable[Result]) -> list[float]:
    """Value over that of the row it is set beside, run by run (both were measured in the same round)."""
    others = [r for r in results if r.group == result.group and r.row.name == result.row.against]
    if not result.row.against or not others:
        return []
    return [own / other for own, other in zip(result.values, others[0].values, strict=False) if other]


def shown(value: float) -> str:
    """A figure as a person reads it: three to four digits that count."""
    if value == 0.0 or 1000.0 <= abs(value) < 1e9:
        return f"{value:,.0f}"
    if abs(value) >= 1e9 or abs(value) < 1e-3:
        return f"{value:.2e}"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _span(values: Sequence[float]) -> str:
    return f"{shown(min(values))}–{shown(max(values))}"


def markdown_table(results: Sequence[Result], group: str) -> str:
    """The rows of a group: median, lowest–highest, and how often the row beside it."""
    lines = ["| what | unit | median | lowest–highest | runs | beside | note |", "|---|---|---:|---|---:|---|---|"]
    for result in (r for r in results if r.group == group):
        note = "; ".join(part for part in (result.row.note, result.note) if part)
        if not result.values:
            lines.append(f"| {result.row.name} | {result.row.unit} | – | – | 0 | | {note} |")
            continue
        beside = ratios(result, results)
        against = f"{shown(statistics.median(beside))} × {result.row.against} ({_span(beside)})" if beside else ""
        lines.append(
            f"| {result.row.name} | {result.row.unit} | {shown(result.median)} | {_span(result.values)} "
            f"| {len(result.values)} | {against} | {note} |"
        )
    return "\n".join(lines)


def write_markdown(path: Path, results: Sequence[Result], titles: Mapping[str, str], heading: str) -> None:
    """Write all groups, each under ``## group``; ``heading`` names machine, versions and threads."""
    parts = ["# Benchmark", heading]
    for group, title in titles.items():
        if any(r.group == group for r in results):
            parts += [f"## {group}", title, markdown_table(results, group)]
    write_whole(path, ("\n\n".join(parts) + "\n").encode())


def write_csv(path: Path, results: Sequence[Result]) -> None:
    """Write every row with all its values, unrounded."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for r in results:
        beside = ratios(r, results)
        figures = [r.median, min(r.values), max(r.values)] if r.values else [""] * 3
        compared = [statistics.median(beside), min(beside), max(beside)] if beside else [""] * 3
        note = "; ".join(part for part in (r.row.note, r.note) if part)
        values = " ".join(repr(float(value)) for value in r.values)
        writer.writerow(
            [r.group, r.row.name, r.row.unit, len(r.values), *figures, r.row.against, *compared, note, values]
        )
    write_whole(path, text.getvalue().encode())


def read_csv(path: Path) -> list[Result]:
    """Read what :func:`write_csv` wrote.

    Raises:
        ConfigurationError: another file, or a damaged one.
    """
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
        return [
            Result(
                line["group"],
                Row(line["row"], line["unit"], line["against"], line["note"]),
                [float(value) for value in line["values"].split()],
            )
            for line in rows
        ]
    except (OSError, KeyError, ValueError, AttributeError) as error:
        raise ConfigurationError(f"{path}: is not a table of hydro benchmark ({type(error).__name__})") from None
