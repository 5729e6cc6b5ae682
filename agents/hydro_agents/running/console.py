"""Progress of long work on the console: bars on a terminal, occasional lines elsewhere, and the remaining time."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Column
from rich.table import Table as ConsoleTable
from rich.text import Text

from hydro_agents.running.text import Table

SECONDS_BETWEEN_LINES = 10.0
SECONDS_OF_SILENCE = 20.0  # off a terminal a line says that the work goes on when nothing has been printed for so long
LONG_PIECE = 45.0  # s; if the first piece of work takes longer, the rate includes it


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


@dataclass
class _Phase:
    """Progress of a phase, and the time that it still needs at its rate so far."""

    total: int
    done: int
    start: int  # `done` at the first update: a resumed phase does not begin at 0
    began: float  # s, time of the first update
    changed: float  # s, time of the latest change of `done`
    note: str = ""
    line: float | None = None  # s, time of the latest line about it
    base: tuple[float, int] | None = None  # time and `done` from which the rate counts

    def update(self, done: int, total: int, now: float, note: str) -> None:
        self.total, self.note = total, note
        if done != self.done:
            self.done, self.changed = done, now
            if self.base is None and done > self.start:
                # Imports and compilation come before the first piece; in a long piece they do not matter.
                self.base = (self.began, self.start) if now - self.began > LONG_PIECE else (now, done)

    def left(self, now: float) -> float | None:
        """Seconds that are left; ``None`` as long as the rate is unknown."""
        if self.done >= self.total:
            return 0.0
        if self.base is None or self.done <= self.base[1]:
            return None
        per_piece = (self.changed - self.base[0]) / (self.done - self.base[1])
        return max(per_piece * (self.total - self.done) - (now - self.changed), 0.0)


def in_words(seconds: float) -> str:
    """An estimated time in round numbers: 5 s, 40 s, 3 min, 1 h 20 min."""
    if seconds < 57.5:
        return f"{max(5 * round(seconds / 5.0), 5)} s"
    minutes = round(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    minutes = 5 * round(minutes / 5)
    return f"{minutes // 60} h" + (f" {minutes % 60} min" if minutes % 60 else "")


class ProgressDisplay:
    """Progress of one or more phases, each with its remaining time; use as a context manager.

    On a terminal each phase is a bar. Elsewhere (a log, CI, a terminal that cannot move its cursor) a line appears at
    most every ten seconds, and at least every thirty. The remaining time comes from the rate of the phase itself.

    Args:
        console: where to show it; default: standard output.
        clock: seconds of a clock that never goes back.
    """

    def __init__(self, console: PlainConsole | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = console or PlainConsole()
        self._clock = clock
        self._began = clock()
        self._phases: dict[str, _Phase] = {}
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._latest = ""  # phase
        self._printed = self._began  # time of the latest line
        self._lock = threading.RLock()
        self._ended = threading.Event()
        # FORCE_COLOR makes Rich believe in a terminal at the other end of a pipe.
        if self.console.is_interactive and self.console.file.isatty():
            self._bars = _bars(self.console, self._time_left)

    def __enter__(self) -> ProgressDisplay:
        if self._bars is not None:
            self._bars.start()
        else:
            threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._bars is not None:
            self._bars.stop()

    def update(self, phase: str, done: int, total: int, note: str = "") -> None:
        """Show the progress of a phase; call it with ``done = 0`` before the work, to show the phase at once."""
        with self._lock:
            now, self._latest = self._clock(), phase
            known = self._phases.setdefault(phase, _Phase(total, done, done, now, now))
            known.update(done, total, now, note)
            if self._bars is not None:
                if phase not in self._tasks:
                    self._tasks[phase] = self._bars.add_task(phase, note="")
                self._bars.update(self._tasks[phase], completed=done, total=total, note=note)
            elif known.line is None or done >= total or now - known.line >= SECONDS_BETWEEN_LINES:
                self._show_line(phase, now)

    def remind(self) -> None:
        """Off a terminal: say how far the latest phase is if nothing was printed for a while."""
        with self._lock:
            now = self._clock()
            if now - self._printed < SECONDS_OF_SILENCE:
                return
            if self._latest:
                self._show_line(self._latest, now)
            else:  # the preparation of the first phase
                self._printed = now
                self.console.lines(f"at work for {in_words(now - self._began)}")

    def say(self, text: str) -> None:
        """Print a separate line."""
        self.console.lines(text, soft_wrap=True)

    def _watch(self) -> None:
        while not self._ended.wait(SECONDS_BETWEEN_LINES):
            self.remind()

    def _time_left(self, name: str) -> str:
        phase, now = self._phases[name], self._clock()
        left, passed = phase.left(now), now - phase.began
        return f"{in_words(passed)} so far" if left is None and passed >= SECONDS_OF_SILENCE else _left(left)

    def _show_line(self, name: str, now: float) -> None:
        """Print how far a phase is: as much as fits into one line, the most important first."""
        phase = self._phases[name]
        phase.line = self._printed = now
        done, total = phase.done, phase.total
        line = f"{name}: {100 * done / total:3.0f} %" if total > 1 else f"{name}: {'done' if done else 'begun'}"
        left, passed = phase.left(now), now - phase.began
        work = f"at work for {in_words(passed)}" if left is None and passed >= SECONDS_OF_SILENCE else ""
        count = f"{done:,} of {total:,}" if total > 1 else ""
        for part in (_left(left) or work, phase.note, count):
            if part and len(line) + 2 + len(part) <= self.console.width:
                line += f", {part}"
        self.console.lines(line[: self.console.width], soft_wrap=True)


def _left(seconds: float | None) -> str:
    return "" if seconds is None or seconds <= 0.0 else f"{in_words(seconds)} left"


class _TimeLeft(ProgressColumn):
    """The remaining time; it also falls between two updates."""

    def __init__(self, left: Callable[[str], str]) -> None:
        super().__init__(Column(no_wrap=True, min_width=11))
        self._left = left

    def render(self, task: Task) -> Text:
        return Text(self._left(task.description))


def _bars(console: PlainConsole, left: Callable[[str], str]) -> Progress:
    """Bars that fit into the terminal: a narrow one cuts the note first, then the name, and has shorter bars."""
    bar = 20 if console.width >= 76 else 10
    name = max(console.width - bar - 24, 8)
    return Progress(
        TextColumn(
            "{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", max_width=name)
        ),
        BarColumn(bar_width=bar),
        TextColumn("{task.percentage:3.0f} %", markup=False, table_column=Column(no_wrap=True)),
        _TimeLeft(left),
        TextColumn(
            "{task.fields[note]}", markup=False, table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")
        ),
        console=console,
        expand=True,
    )
