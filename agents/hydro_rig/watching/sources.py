"""The lines of a source, by a bounded queue: a slow reader never grows memory."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from queue import Empty, Queue
from threading import Thread

from hydro_env import ConfigurationError
from hydro_env.errors import reason

MOST_LINES = 10_000  # that wait; the source then waits, too
PATIENCE = 1.0  # s


def lines_of(fill: Callable[[Callable[[str], None]], None]) -> Iterator[str | None]:
    """The lines that ``fill`` puts from a thread of its own; ``None`` after each second without a line."""
    queue: Queue[str | Exception | None] = Queue(MOST_LINES)

    def run() -> None:
        try:
            fill(queue.put)
            queue.put(None)
        except Exception as error:  # of any library; the reader must not wait for ever
            queue.put(error)

    thread = Thread(target=run, daemon=True)
    thread.start()
    while True:
        try:
            line = queue.get(timeout=PATIENCE)
        except Empty:
            yield None
            continue
        if line is None:  # the end of the input
            return
        if isinstance(line, Exception):
            raise ConfigurationError(f"rows: cannot be read: {reason(line)}")
        yield line


def standard_input(put: Callable[[str], None]) -> None:
    """All lines of the standard input."""
    for line in sys.stdin:
        put(line)
