"""Progress of long work on the console: a bar on a terminal, occasional lines elsewhere."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Column

SECONDS_BETWEEN_LINES = 10.0


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


def discard_output() -> None:
    """Drop the buffer of standard output after a failed write; it would fail again when the program ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class ProgressDisplay:
    """Progress of one or more phases; use as a context manager.

    On a terminal each phase is a bar. Elsewhere (a log, CI) a line appears at most every ten seconds.
    """

    def __init__(self, console: PlainConsole | None = None) -> None:
        self.console = console or PlainConsole()
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._last_line: dict[str, float] = {}
        if self.console.is_terminal:
            self._bars = Progress(
                TextColumn("{task.description}", style="bold", markup=False),
                BarColumn(bar_width=20),
                TextColumn("{task.percentage:3.0f} %", markup=False),
                TimeRemainingColumn(compact=True),
                TextColumn("{task.fields[note]}", markup=False, table_column=_rest_of_the_line()),
                console=self.console,
                expand=True,
            )

    def __enter__(self) -> ProgressDisplay:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def update(self, phase: str, done: int, total: int, note: str = "") -> None:
        """Show the progress of a phase; call it with ``done = 0`` before the work, to show the phase at once."""
        if self._bars is not None:
            if phase not in self._tasks:
                self._tasks[phase] = self._bars.add_task(phase, total=total, note=note)
            self._bars.update(self._tasks[phase], completed=done, total=total, note=note)
            return
        now = time.monotonic()
        first = phase not in self._last_line
        if first or done >= total or now - self._last_line[phase] >= SECONDS_BETWEEN_LINES:
            self._last_line[phase] = now
            share = f"{100 * done / total:3.0f} %" if total else ""
            self.say(f"{phase}: {share} ({done:,} of {total:,}) {note}".rstrip())

    def say(self, text: str) -> None:
        """Print a separate line."""
        self.console.lines(text, soft_wrap=True)


def _rest_of_the_line() -> Column:
    """A column that shrinks before the others: a narrow terminal cuts the note, not the bar."""
    return Column(ratio=1, no_wrap=True, overflow="ellipsis")
