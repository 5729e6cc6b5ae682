"""How long work will take: a rate that is measured on this machine while the work runs, and what is left to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LONG_PIECE = 45.0
"""s; a first piece of work that takes longer tells the rate by itself."""


@dataclass
class _Phase:
    """What is known of a phase: its size, and where it was at three moments."""

    total: int
    done: int
    changed: float  # s, time of the latest change of `done`
    began: float
    start: int  # `done` at the first update: a phase that is resumed does not begin at 0
    first: tuple[float, int] | None = None  # time and `done` from which on the rate counts

    def update(self, done: int, total: int, now: float) -> None:
        self.total = total
        if done != self.done:
            self.done, self.changed = done, now
            if self.first is None and done > self.start:
                # The time before includes imports and compilation, which matter only if the first piece is short.
                self.first = (self.began, self.start) if now - self.began > LONG_PIECE else (now, done)

    @property
    def measured(self) -> float:
        """Seconds over which the rate was measured."""
        return self.changed - self.first[0] if self.first is not None else 0.0

    @property
    def seconds(self) -> float | None:
        """Duration of the whole phase at its rate so far; ``None`` as long as the rate is unknown."""
        if self.first is None:
            return None
        if self.done <= self.first[1]:  # one piece: its rate is known when the phase is finished
            share = (self.done - self.start) / self.total
            return (self.changed - self.began) / share if self.done >= self.total else None
        return self.total * self.measured / (self.done - self.first[1])

    def left(self, now: float) -> float | None:
        seconds = self.seconds
        if self.done >= self.total:
            return 0.0
        if seconds is None:
            return None
        return max(seconds * (1.0 - self.done / self.total) - (now - self.changed), 0.0)


class Pace:
    """Time that is left, of each phase and in all.

    Args:
        work: relative work of all phases by name, in any unit; empty: nothing is known about the phases to come.
    """

    def __init__(self, work: Mapping[str, float] | None = None) -> None:
        self.work = dict(work or {})
        self._phases: dict[str, _Phase] = {}

    def update(self, phase: str, done: int, total: int, now: float) -> None:
        """Note how far a phase is at a time in s."""
        if phase not in self._phases:
            self._phases[phase] = _Phase(total, done, now, now, done)
        self._phases[phase].update(done, total, now)

    def left(self, phase: str, now: float) -> float | None:
        """Seconds that a phase still needs; ``None`` as long as its rate is unknown."""
        return self._phases[phase].left(now)

    def measured(self, phase: str) -> float:
        """Seconds over which the rate of a phase was measured."""
        return self._phases[phase].measured

    def left_in_all(self, now: float) -> float | None:
        """Seconds that all phases of :attr:`work` still need; ``None`` as long as no rate is known.

        A phase that has not begun is taken to need the time per unit of work of those that have.
        """
        known = [(phase.seconds, self.work[name]) for name, phase in self._phases.items() if name in self.work]
        rated = [(seconds, work) for seconds, work in known if seconds is not None and work > 0.0]
        if not rated:
            return None
        per_unit = sum(seconds for seconds, _ in rated) / sum(work for _, work in rated)
        total = 0.0
        for name, work in self.work.items():
            phase = self._phases.get(name)
            left = phase.left(now) if phase is not None else None
            total += left if left is not None else work * per_unit
        return total

    def done_in_all(self) -> float:
        """Share of the work of all phases that is done, 0 to 1."""
        parts = ((self.work.get(name, 0.0), phase) for name, phase in self._phases.items())
        done = sum(work * phase.done / phase.total for work, phase in parts if phase.total > 0)
        return done / (sum(self.work.values()) or 1.0)


def in_words(seconds: float) -> str:
    """An estimated time in round numbers: 5 s, 40 s, 3 min, 1 h 20 min."""
    if seconds < 57.5:
        return f"{max(5 * round(seconds / 5.0), 5)} s"
    minutes = round(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    minutes = 5 * round(minutes / 5)
    return f"{minutes // 60} h" + (f" {minutes % 60} min" if minutes % 60 else "")
