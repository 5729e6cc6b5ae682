"""The liveliest windows of a recording of any length, in bounded memory.

The rows come piece by piece. Of each section of five minutes the window in which the signals vary most is kept, and of
these the best dozen. Which windows these are does not depend on the size of the pieces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.looks import MOVING_FROM
from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.task.sensors import COMMAND, POSITION
from hydro_env.types import Floats
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.recording import FULL_COMMAND, Recording
from hydro_rig.recordings.sampling import LONGEST_FILL, Sampled, sampled

SECTION = 300.0  # s; one window of each is kept, about 25 kB
MARGIN = 5  # rows before and after a window, from which lost rows at its ends are completed
MOST_SATURATED = 0.5  # largest share of rows at full command in a useful window
LEAST_ROWS = 0.8  # of a whole window
UNUSABLE = -1e3  # added to the score of a window that lacks commands

Places = NDArray[np.int64]


class Candidate(NamedTuple):
    """A window of a recording with its margins."""

    score: float
    begin: float  # s, by the clock of the file
    rows: Recording


class Overview(NamedTuple):
    """What was seen of the whole recording."""

    windows: int
    moving: float  # share of the windows in motion; NaN without a position
    clock_back: float  # s, the most by which the clock ran back; 0: never
    findings: list[Finding]  # about the clock, and signals that were not recorded


class Liveliest:
    """Takes the pieces of one recording in turn (:meth:`add`), and keeps the liveliest windows (:meth:`finish`).

    Args:
        window: s.
        config: of the rig, for the size of its signals.
    """

    def __init__(self, window: float, config: TaskConfig) -> None:
        self.window, self.config = window, config
        plant = config.plant
        self.size = np.array([plant.cylinder.stroke, plant.supply.pressure, plant.supply.pressure, 1.0, 1.0])
        self.first = self.last = self.origin = np.nan  # s; origin: where window 0 begins since the clock ran back
        self.windows = self.located = self.moving = 0
        self.next = 0  # number of the first window that was not weighed
        self.rest: Recording | None = None  # rows of windows that may go on
        self.best: dict[int, Candidate] = {}  # by section
        self.jumps: list[tuple[float, float]] = []  # when the clock ran back, and by how much, s
        self.findings: list[Finding] = []

    def add(self, piece: Recording) -> None:
        """The next rows of the recording."""
        if np.isnan(self.first):
            self.first = self.origin = piece.begin
            self.findings = [finding for finding in piece.findings if finding.absent]
        self.last = piece.begin + float(piece.time[-1])
        rows = piece if self.rest is None else _joined(self.rest, piece)
        back = np.flatnonzero(np.diff(rows.time) < 0.0) + 1
        runs = [rows.part(int(begin), int(end)) for begin, end in zip([0, *back], [*back, len(rows.time)], strict=True)]
        for place, run in enumerate(runs):
            if place > 0:
                before = runs[place - 1]
                self.jumps.append((before.begin + float(before.time[-1]), before.begin + before.time[-1] - run.begin))
                self.origin, self.next = run.begin, 0
            self._weigh(run, ended=place + 1 < len(runs))

    def finish(self, most: int) -> tuple[list[Candidate], Overview]:
        """After the last piece: at most ``most`` windows in the order of time, and the overview."""
        if self.rest is not None:
            self._weigh(self.rest, ended=True)
        findings = list(self.findings)
        if self.jumps:
            when, by = self.jumps[0]
            often = f" {len(self.jumps)} times" if len(self.jumps) > 1 else ""
            what = f"runs back{often} by {number(by, digits=3)} s, {number(when - self.first, 1)} s after the first row"
            findings.append(Finding("clock", f"{what}; no window crosses it", Weight.NOTE))
        best = sorted(self.best.values(), key=lambda one: (-one.score, one.begin))[:most]
        share = self.moving / self.located if self.located else np.nan
        back = max((by for _, by in self.jumps), default=0.0)
        overview = Overview(self.windows, share, back, findings)
        return sorted(best, key=lambda one: one.begin), overview

    def _weigh(self, run: Recording, ended: bool) -> None:
        """Weigh the windows of rows whose clock runs forward; unless it ends, the last one and its margin may go on."""
        stamps = run.begin - self.origin + run.time
        index = np.floor(stamps / self.window + 1e-6).astype(np.int64)
        done = int(index[-1]) + (1 if ended else -1)  # windows before this one are whole
        starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
        ends = np.append(starts[1:], len(index))
        fresh = np.flatnonzero((index[starts] >= self.next) & (index[starts] < done))
        if len(fresh):
            score, travel = self._scores(run, starts, ends)
            self.windows += len(fresh)
            self.located += int(np.isfinite(travel[fresh]).sum())
            self.moving += int((travel[fresh] >= MOVING_FROM * self.window).sum())
            for place in fresh:
                begin = self.origin + float(index[starts[place]]) * self.window
                rows = max(int(starts[place]) - MARGIN, 0), min(int(ends[place]) + MARGIN, len(index))
                section = int((begin - self.first) // SECTION)
                if section not in self.best or score[place] > self.best[section].score:
                    self.best[section] = Candidate(float(score[place]), begin, run.part(*rows))
            self.next = done
        keep = int(np.searchsorted(index, done - 1)) if not ended else len(index)
        self.rest = None if ended else run.part(keep, len(index))

    def _scores(self, run: Recording, starts: Places, ends: Places) -> tuple[Floats, Floats]:
        """Liveliness of windows of rows, and travel in m (NaN without a position)."""
        span = np.fmax.reduceat(run.signals, starts, axis=1) - np.fmin.reduceat(run.signals, starts, axis=1)
        score = np.nansum(np.minimum(span / self.size[:, None], 1.0), axis=0)
        command, count = run.signals[COMMAND], ends - starts
        way = np.add.reduceat(np.abs(np.nan_to_num(np.diff(command, prepend=command[0]))), starts)
        full = np.add.reduceat((np.abs(command) >= FULL_COMMAND).astype(np.int64), starts)
        step = float(np.median(np.diff(run.time))) if len(run.time) > 1 else self.window
        period = max(self.config.control_period, step)
        known = np.flatnonzero(np.isfinite(command))
        gap = np.full(len(command), 0.0 if len(known) else np.inf)
        between = np.diff(run.time[known])
        gap[known[1:]] = between
        gap[known[:-1]] = np.maximum(gap[known[:-1]], between)
        useless = np.maximum.reduceat(gap, starts) > (LONGEST_FILL + 1.5) * period
        useless |= (count < LEAST_ROWS * self.window / step) | (full > MOST_SATURATED * count)
        return score + np.minimum(way / self.window, 1.0) + UNUSABLE * useless, span[POSITION]


def sampled_windows(candidates: Sequence[Candidate], window: float, config: TaskConfig) -> Sampled:
    """The samples of windows (at least one) as those of one recording, for ``cut``.

    Two windows lie one window apart; their margins stand between them. A window whose samples are not as the task
    expects is left out, unless all are: then the first tells why.
    """
    length = round(window / config.control_period)
    found = [(candidate, sampled(candidate.rows, config)) for candidate in candidates]
    good = [(candidate, one) for candidate, one in found if len(one.place)]
    if not good:
        return found[0][1]
    parts = []
    for place, (candidate, one) in enumerate(good):
        before = round((candidate.begin - candidate.rows.begin - one.time[0]) / config.control_period)
        places = one.place - before + (1 + 2 * place) * length
        parts.append(one._replace(place=places, time=places * config.control_period))
    return parts[0]._replace(
        place=np.concatenate([part.place for part in parts]),
        time=np.concatenate([part.time for part in parts]),
        signals=np.concatenate([part.signals for part in parts], axis=1),
        findings=list({(one.signal, one.weight): one for part in parts for one in part.findings}.values()),
        auxiliary=_concatenated([part.auxiliary for part in parts]),
    )


def _joined(one: Recording, other: Recording) -> Recording:
    """Rows and those that follow."""
    return one._replace(
        time=np.concatenate([one.time, other.begin - one.begin + other.time]),
        signals=np.concatenate([one.signals, other.signals], axis=1),
        auxiliary=_concatenated([one.auxiliary, other.auxiliary]),
    )


def _concatenated(parts: Sequence[Mapping[str, Floats]]) -> dict[str, Floats]:
    """The signals that all parts hold, one part after the other."""
    shared = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in shared}
