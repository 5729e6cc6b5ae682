"""What a person sees while long work runs: a progress bar on a terminal, sparse lines elsewhere."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

SECONDS_BETWEEN_LINES = 10.0


class ProgressDisplay:
    """Progress of one or more phases; use as a context manager.

    On a terminal each phase is a bar. Elsewhere (a log, CI) a line appears at most every ten seconds.
    """

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console()
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._last_line: dict[str, float] = {}
        if self.console.is_terminal:
            self._bars = Progress(
                TextColumn("[bold]{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=self.console,
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
        """Say how far a phase is."""
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
            self.console.print(f"{phase}: {share} ({done:,} of {total:,}) {note}".rstrip(), highlight=False)

    def say(self, text: str) -> None:
        """A line of its own."""
        self.console.print(text, highlight=False, soft_wrap=True)
