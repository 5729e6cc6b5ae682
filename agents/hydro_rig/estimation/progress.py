"""What a long fit has done so far, told to the display of the command that waits for it."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar

from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.jobs import Report

_display: ContextVar[Report | None] = ContextVar("display", default=None)


@contextmanager
def told_to(display: Report | None) -> Iterator[None]:
    """What is told inside the block goes to a display; ``None``: to nobody."""
    token = _display.set(display)
    try:
        yield
    finally:
        _display.reset(token)


@contextmanager
def shown(quiet: bool = False) -> Iterator[None]:
    """What is told inside the block is shown on the console, unless ``quiet``."""
    with nullcontext() if quiet else ProgressDisplay() as display, told_to(None if display is None else display.update):
        yield


def tell(phase: str, done: int, total: int) -> None:
    """How far a phase is."""
    display = _display.get()
    if display is not None:
        display(phase, done, total)
