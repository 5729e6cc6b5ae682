"""Progress of long work on the console: bars on a terminal, occasional lines elsewhere, and the remaining time."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Collection
from types import TracebackType
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.table import Table as ConsoleTable
from rich.text import Text

from hydro_agents.running.text import Table, duration

SECONDS_BETWEEN_LINES = 20.0  # off a terminal


class PlainConsole(Console):
    """A console that prints text unchanged: no markup (a path may hold brackets), no emoji, no coloured numbers."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def on_broken_pipe(self) -> None:
        """Let the caller handle it: Rich would end the program."""
        raise BrokenPipeError

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
    for place, cells in enumerate(table.rows):
        if place in table.breaks:
            shown.add_section()
            shown.add_row(Text(table.breaks[place], style="bold"))
        shown.add_row(*(cell if isinstance(cell, str) else cell.text for cell in cells))
    return shown


def discard_output() -> None:
    """Drop the buffer of standard output after a failed write; it would fail again when the program ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class ProgressDisplay:
    """Progress of one or more phases, each with its remaining time; use as a context manager.

    On a terminal each phase is a bar of :mod:`rich.progress`. Elsewhere (a log, CI, a terminal that cannot move its
    cursor) a line appears at the beginning and the end of a phase, and every twenty seconds. The remaining time comes
    from the rate of the phase since its first piece: imports and compilation come before that.

    Args:
        console: where to show it; default: standard output.
        clock: seconds of a clock that never goes back.
    """

    def __init__(self, console: PlainConsole | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = console or PlainConsole()
        # FORCE_COLOR makes Rich believe in a terminal at the other end of a pipe.
        self._lines = not (self.console.is_interactive and self.console.file.isatty())
        self._bars = Progress(
            TextColumn("{task.description}", markup=False, table_column=_cut(ratio=2)),
            BarColumn(bar_width=20 if self.console.width >= 76 else 10),
            TextColumn("{task.percentage:3.0f} %"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}", markup=False, table_column=_cut(ratio=1)),
            console=self.console,
            get_time=clock,
            speed_estimate_period=math.inf,
            expand=True,
            disable=self._lines,
        )
        self._tasks: dict[str, TaskID] = {}
        self._lock = threading.RLock()
        self._ended = threading.Event()

    def __enter__(self) -> ProgressDisplay:
        self._bars.start()
        if self._lines:
            threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._bars.stop()

    def update(self, phase: str, done: int, total: int, note: str = "") -> None:
        """Show the progress of a phase; call it with ``done = 0`` before the work, to show the phase at once."""
        with self._lock:
            new = phase not in self._tasks
            if new:  # a resumed phase does not begin at 0
                self._tasks[phase] = self._bars.add_task(phase, total=total, completed=done, note=note)
            self._bars.update(self._tasks[phase], completed=done, total=total, note=note)
            if self._lines and (new or done >= total):
                self._print(phase)

    def remind(self) -> None:
        """Off a terminal: print how far the phases at work are."""
        with self._lock:
            for phase in self._tasks:
                if self._lines and not self._task(phase).finished:
                    self._print(phase)

    def say(self, text: str) -> None:
        """Print a separate line."""
        self.console.lines(text, soft_wrap=True)

    def _watch(self) -> None:
        while not self._ended.wait(SECONDS_BETWEEN_LINES):
            self.remind()

    def _task(self, phase: str) -> Task:
        return self._bars.tasks[self._tasks[phase]]

    def _print(self, phase: str) -> None:
        self.console.lines(_line(self._task(phase))[: self.console.width], soft_wrap=True)


def _cut(ratio: int) -> Column:
    """A column that a narrow terminal cuts short."""
    return Column(ratio=ratio, no_wrap=True, overflow="ellipsis")


def _line(task: Task) -> str:
    """How far a phase is, the most important first."""
    left = task.time_remaining
    time_left = f"{duration(left)} left" if left else f"at work for {duration(task.elapsed or 0.0)}"
    parts = [f"{task.description}: {task.percentage:3.0f} %", "" if task.finished else time_left]
    parts += [task.fields["note"], f"{task.completed:,.0f} of {task.total:,.0f}"]
    return ", ".join(filter(None, parts))
