"""The tables of ``hydro benchmark``: measured rows, their medians and ratios, files; rates, fresh processes, calls."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import pandas as pd

from hydro_agents.running.text import markdown, number
from hydro_env.files import write_whole

HEADINGS = ("what", "unit", "median", "lowest–highest", "runs", "beside", "note")


class UnavailableError(Exception):
    """A row cannot be measured on this machine; the message gives the reason."""


@dataclass
class Row:
    """One row of the table: name, unit, the row of its group for comparison, and one value per run."""

    name: str
    unit: str
    against: str = ""
    note: str = ""
    group: str = ""
    values: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Case:
    """One measurement, which fills one or more rows.

    ``measure(run)`` gives one value per row, without the time to build and compile; it may raise
    :class:`UnavailableError`.
    """

    rows: Sequence[Row]
    measure: Callable[[int], Sequence[float]]
    runs: int


def one_row(name: str, unit: str, measure: Callable[[], float], runs: int, against: str = "", note: str = "") -> Case:
    """A measurement of one value."""
    return Case([Row(name, unit, against, note)], lambda run: [measure()], runs)


def ratios(row: Row, rows: Sequence[Row]) -> list[float]:
    """Value divided by the value of the row for comparison, for each run (both from the same round)."""
    others = [other.values for other in rows if (other.group, other.name) == (row.group, row.against)]
    return [own / other for own, other in zip(row.values, others[0], strict=False) if other] if others else []


def figure(value: float) -> str:
    """A figure with three significant digits: large ones as whole numbers, small ones with an exponent."""
    if 0.0 < abs(value) < 1e-3:
        return f"{value:.2e}"
    return f"{value:,.0f}" if abs(value) >= 1000.0 else number(value)


def cells(row: Row, rows: Sequence[Row]) -> list[str]:
    """A row of the table as text, in the order of :data:`HEADINGS`."""

    def spread(values: Sequence[float]) -> str:
        return f"{figure(min(values))}–{figure(max(values))}"

    compared = ratios(row, rows)
    beside = f"{figure(median(compared))} × {row.against} ({spread(compared)})" if compared else ""
    middle = [figure(median(row.values)), spread(row.values)] if row.values else ["–", "–"]
    return [row.name, row.unit, *middle, str(len(row.values)), beside, row.note]


def markdown_table(rows: Sequence[Row], group: str) -> str:
    """The rows of a group: median, lowest–highest, and ratio to the row for comparison."""
    lines = [cells(row, rows) for row in rows if row.group == group]
    return markdown(HEADINGS, lines, left=(0, 1, 3, 5, 6))


def write_markdown(path: Path, rows: Sequence[Row], titles: Mapping[str, str], heading: str) -> None:
    """Write all groups, each under ``## group``; ``heading`` names machine, versions and threads."""
    measured = {row.group for row in rows}
    parts = ["# Benchmark", heading]
    for group in (name for name in titles if name in measured):
        parts += [f"## {group}", titles[group], markdown_table(rows, group)]
    write_whole(path, ("\n\n".join(parts) + "\n").encode())


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write every row with all its values, unrounded."""
    table = pd.DataFrame([vars(row) for row in rows]).rename(columns={"name": "row"})
    table["median"] = [median(row.values) if row.values else None for row in rows]
    table["ratio"] = [median(own) if (own := ratios(row, rows)) else None for row in rows]
    table["values"] = [" ".join(map(repr, row.values)) for row in rows]
    write_whole(path, table.to_csv(index=False).encode())


ROOT = Path(__file__).resolve().parents[1]  # of the checkout, for fresh processes


@dataclass(frozen=True)
class Extent:
    """Extent of the benchmark."""

    runs: int
    seconds: float  # duration of one measurement of a rate
    kernel_sizes: Sequence[int]
    vector_sizes: Sequence[int]
    accuracy_rigs: int
    training_steps: int
    calls: int


FULL = Extent(
    runs=5,
    seconds=0.5,
    kernel_sizes=(1, 8, 64, 512, 4096, 65_536),
    vector_sizes=(16, 64, 256, 1024, 4096, 16_384),
    accuracy_rigs=240,
    training_steps=1_000_000,
    calls=20_000,
)
QUICK = Extent(3, 0.1, (1, 64, 4096), (16, 1024), 40, 131_072, 2000)


def rate(work: Callable[[], int], seconds: float) -> float:
    """Units of work per second. ``work`` returns the number of units that it did; its first call is not timed."""
    work()
    done, began = 0, time.perf_counter()
    while True:
        done += work()
        passed = time.perf_counter() - began
        if passed >= seconds:
            return done / passed


def fresh_process(code: str, environment: Mapping[str, str] | None = None) -> tuple[float, str]:
    """Run Python code in a new process; returns wall time (s) and standard output.

    Raises:
        RuntimeError: the code failed; the message is the last line of its output.
    """
    path = os.pathsep.join([str(ROOT), str(ROOT / "agents"), *filter(None, [os.environ.get("PYTHONPATH")])])
    variables = {**os.environ, "PYTHONPATH": path, **(environment or {})}
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=variables)
    seconds = time.perf_counter() - began
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["the process failed"])[-1])
    return seconds, done.stdout
