"""Synchronises a window with the simulated time, independent of the drawing time."""

from __future__ import annotations

import time
from collections.abc import Callable

BETWEEN_FRAMES = 1 / 50
"""s between two frames of the window."""

BETWEEN_LATE_FRAMES = 1 / 10
"""s between two frames while the window lags behind."""

FORGIVEN = 1.0
"""s; a larger lag counts as a pause, such as training between two steps: the window continues from there."""


class Pace:
    """Decides which samples a window draws, and waits for their time."""

    def __init__(
        self, clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock, self._sleep = clock, sleep
        self._origin = 0.0  # clock at time zero of the episode
        self._next: float | None = None  # s, of the next frame

    def begin(self) -> None:
        """Begin an episode: the next sample is drawn immediately."""
        self._next = None

    def due(self, now: float) -> bool:
        """Whether the sample at ``now`` (s, simulated) is drawn; if so, wait for its time."""
        if self._next is None:
            self._origin, self._next = self._clock() - now, now
        if now < self._next - 1e-9:
            return False
        ahead = self._origin + now - self._clock()
        if ahead > 0.0:
            self._sleep(ahead)
        elif ahead < -FORGIVEN:
            self._origin -= ahead
            ahead = 0.0
        self._next = now + (BETWEEN_LATE_FRAMES if ahead < -BETWEEN_FRAMES else BETWEEN_FRAMES)
        return True
