"""Progress of long work on the console: bars on a terminal, occasional lines elsewhere, and the remaining time."""

import contextlib
import math
import os
import sys
import time
from collections.abc import Collection
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.table import Table as ConsoleTable

from hydro_agents.running.text import Table, duration

SECONDS_BETWEEN_LINES = 10.0
WIDEST = 1000  # characters of a table
ESTIMATED_FROM = 600.0  # s of a phase from which its remaining time follows


class PlainConsole(Console):
    """A console that prints text unchanged: no markup (a path may hold brackets), no emoji, no coloured numbers."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def on_broken_pipe(self) -> None:
        """Let the caller handle it: Rich would end the program."""
        raise BrokenPipeError

    def table(self, table: ConsoleTable) -> None:
        """Print a table with all its columns, also where the terminal is narrower than it."""
        before, self.width = self.width, WIDEST
        self.lines(table)
        self.width = before

    def lines(self, *parts: Any, **options: Any) -> None:
        """Print; after a failed write (a closed pipe, a full disk) stay silent, and let the work continue."""
        try:
            self.print(*parts, **options)
        except OSError:
            self.quiet = True
            if self.file is sys.stdout:
                discard_output()


def console_table(table: Table, left: Collection[int] = (0,), whole: bool = False) -> ConsoleTable:
    """A table for the console: the columns ``left`` hold words, the others numbers, which stand at the right.

    With ``whole`` a number stays on one line even if the console is narrow.
    """
    shown = ConsoleTable(
        title=table.caption or None, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    for place, heading in enumerate(table.header):
        words = place in left
        shown.add_column(heading, justify="left" if words else "right", no_wrap=whole and not words)
    for cells in table.rows:
        shown.add_row(*cells)
    return shown


def discard_output() -> None:
    """Drop the buffer of standard output after a failed write; it would fail again when the program ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class ProgressDisplay:
    """Progress of one or more phases, each with its remaining time; use as a context manager.

    On a terminal each phase is a bar. Elsewhere (a log, CI) a line appears at most every ten seconds.
    """

    def __init__(self, console: PlainConsole | None = None) -> None:
        self.console = console or PlainConsole()
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:3.0f} %", markup=False),
            TimeRemainingColumn(compact=True),
            TextColumn("{task.fields[note]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis")),
            console=self.console,
            speed_estimate_period=ESTIMATED_FROM,
        )
        self._tasks: dict[str, TaskID] = {}
        self._printed: dict[str, float] = {}  # time of the latest line about a phase
        # FORCE_COLOR makes Rich believe in a terminal at the other end of a pipe.
        self._live = self.console.is_interactive and self.console.file.isatty()

    def __enter__(self) -> "ProgressDisplay":
        if self._live:
            self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._progress.stop()

    def update(self, phase: str, done: int, total: int, note: str = "") -> None:
        """Show the progress of a phase; call it with ``done = 0`` before the work, to show the phase at once."""
        if phase not in self._tasks:
            self._tasks[phase] = self._progress.add_task(phase, completed=done, total=total, note=note)
        self._progress.update(self._tasks[phase], completed=done, total=total, note=note)
        silence = time.monotonic() - self._printed.get(phase, -math.inf)
        if self._live or (done < total and silence < SECONDS_BETWEEN_LINES):
            return
        self._printed[phase] = time.monotonic()
        task = self._progress.tasks[self._tasks[phase]]
        parts = [f"{phase}: {task.percentage:3.0f} %, {done:,} of {total:,}"]
        if task.time_remaining:
            parts.append(f"{duration(task.time_remaining)} left")
        if note:
            parts.append(note)
        self.say(", ".join(parts))

    def say(self, text: str) -> None:
        """Print a separate line."""
        self.console.lines(text, soft_wrap=True)
