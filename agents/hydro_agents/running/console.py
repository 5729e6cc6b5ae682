"""Progress of long work on the console: bars on a terminal, occasional lines elsewhere, and the time that is left."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Column
from rich.text import Text

from hydro_agents.running.pace import Pace, in_words

SECONDS_BETWEEN_LINES = 10.0
SECONDS_OF_SILENCE = 20.0
"""Without a terminal, a line shows that the work continues when nothing was printed for so long, s."""

MEASURED_SECONDS = 5.0
"""The expected duration is shown after the rate has been measured for so long, s."""

SHORTEST_TOLD = 30.0
"""A shorter expected duration, s, gets no line of its own."""

IN_ALL = "in all"


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
    """Progress of one or more phases, with the time that is left; use as a context manager.

    On a terminal each phase is a bar. Elsewhere (a log, CI, a terminal that cannot move its cursor) a line appears at
    most every ten seconds, and at least every thirty. The time comes from the rate of the work itself
    (:mod:`hydro_agents.running.pace`).

    Args:
        console: where to show it; default: standard output.
        clock: seconds of a clock that never goes back.
    """

    def __init__(self, console: PlainConsole | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = console or PlainConsole()
        self._clock = clock
        self._began = clock()
        self._pace = Pace()
        self._told: set[str] = set()  # names whose expected duration was shown
        self._notes: dict[str, str] = {}
        self._states: dict[str, tuple[int, int]] = {}
        self._starts: dict[str, float] = {}
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._last_line: dict[str, float] = {}
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

    def expect(self, work: Mapping[str, float]) -> None:
        """Announce all phases and their work, from which the total remaining time is estimated.

        Args:
            work: relative work of each phase by its name, in any unit; phases that a resumed job skips are left out.
        """
        self._pace = Pace(work)
        if self._bars is not None and len(work) > 1:
            self._tasks[IN_ALL] = self._bars.add_task(IN_ALL, total=1.0, note="")

    def update(self, phase: str, done: int, total: int, note: str = "") -> None:
        """Show the progress of a phase; call it with ``done = 0`` before the work, to show the phase at once."""
        with self._lock:
            now, self._latest = self._clock(), phase
            self._pace.update(phase, done, total, now)
            self._starts.setdefault(phase, now)
            self._states[phase], self._notes[phase] = (done, total), note
            self._tell_duration(phase, now)
            if self._bars is not None:
                self._show_bars(self._bars, phase)
                return
            first = phase not in self._last_line
            if first or done >= total or now - self._last_line[phase] >= SECONDS_BETWEEN_LINES:
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

    def _tell_duration(self, phase: str, now: float) -> None:
        """Show the expected duration once, when the rate has been measured for some seconds."""
        name, left = phase, self._pace.left(phase, now)
        began = self._starts[phase]
        if phase in self._pace.work:
            name, left, began = IN_ALL, self._pace.left_in_all(now), self._began
        if name in self._told or left is None or self._pace.measured(phase) < MEASURED_SECONDS:
            return
        self._told.add(name)
        expected = now - began + left
        if left > SHORTEST_TOLD:
            self.console.lines(f"{name}: about {in_words(expected)} on this machine, as measured just now")

    def _show_bars(self, bars: Progress, phase: str) -> None:
        if phase not in self._tasks:
            self._tasks[phase] = bars.add_task(phase, note="")
        done, total = self._states[phase]
        bars.update(self._tasks[phase], completed=done, total=total, note=self._notes[phase])
        if IN_ALL in self._tasks:
            bars.update(self._tasks[IN_ALL], completed=self._pace.done_in_all())

    def _time_left(self, name: str) -> str:
        now = self._clock()
        if name == IN_ALL:
            return _left(self._pace.left_in_all(now))
        left, passed = self._pace.left(name, now), now - self._starts[name]
        return f"{in_words(passed)} so far" if left is None and passed >= SECONDS_OF_SILENCE else _left(left)

    def _show_line(self, phase: str, now: float) -> None:
        """Print how far a phase is: as much as fits into one line, the most important first."""
        self._last_line[phase] = self._printed = now
        done, total = self._states[phase]
        line = f"{phase}: {100 * done / total:3.0f} %" if total > 1 else f"{phase}: {'done' if done else 'begun'}"
        own, in_all = self._pace.left(phase, now), self._pace.left_in_all(now)
        own = own if done < total else 0.0
        passed = now - self._starts[phase]
        work = f"at work for {in_words(passed)}" if own is None and passed >= SECONDS_OF_SILENCE else ""
        rest = f"in all {_left(in_all)}" if in_all and phase in self._pace.work else ""
        count = f"{done:,} of {total:,}" if total > 1 else ""
        for part in (_left(own) or work, rest, self._notes[phase], count):
            if part and len(line) + 2 + len(part) <= self.console.width:
                line += f", {part}"
        self.console.lines(line[: self.console.width], soft_wrap=True)


def _left(seconds: float | None) -> str:
    return "" if seconds is None or seconds <= 0.0 else f"{in_words(seconds)} left"


class _TimeLeft(ProgressColumn):
    """The time that is left now; it also falls between two updates."""

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
