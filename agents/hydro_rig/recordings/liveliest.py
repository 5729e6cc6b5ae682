"""The liveliest windows of a long recording.

Of each section of five minutes the window in which the signals vary most is kept, and of these the best dozen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.task.sensors import COMMAND
from hydro_env.types import Floats, Indices
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.recording import FULL_COMMAND, Recording
from hydro_rig.recordings.row_distance import LARGEST_DEVIATION
from hydro_rig.recordings.sampling import LONGEST_FILL, Sampled, sampled

SECTION = 300.0  # s; one window of each is kept, about 25 kB
MARGIN = 5  # rows before and after a window, from which lost rows at its ends are completed
MOST_ROWS_AT_FULL_COMMAND = 0.5  # largest share of rows at full command in a useful window
LEAST_ROWS = 0.8  # of a whole window
UNUSABLE = -1e3  # added to the score of a window that lacks commands


class Candidate(NamedTuple):
    """A window of a recording with its margins."""

    score: float
    begin: float  # s, by the clock of the file
    rows: Recording


class Lively(NamedTuple):
    """The liveliest windows of a recording, and what was seen of the whole of it."""

    windows: list[Candidate]  # in the order of time
    first: float  # s, by the clock of the file, of the first and of the last row
    last: float
    findings: list[Finding]  # about the clock, and signals that were not recorded


def liveliest(recording: Recording, window: float, config: TaskConfig, most: int) -> Lively:
    """The liveliest windows of a recording, each ``window`` s long; none crosses a place where its clock runs back."""
    first, last = recording.begin, recording.begin + float(recording.time[-1])
    findings = [finding for finding in recording.findings if finding.absent]
    back = np.flatnonzero(np.diff(recording.time) < 0.0) + 1
    if len(back):
        often = f" {len(back)} times" if len(back) > 1 else ""
        before, after = recording.time[back[0] - 1 : back[0] + 1]
        what = f"runs back{often} by {number(before - after, digits=3)} s, {number(before, 1)} s"
        findings.append(Finding("clock", f"{what} after the first row; no window crosses it", Weight.NOTE))
    best: dict[int, Candidate] = {}  # by section
    for begin, end in zip([0, *back], [*back, len(recording.time)], strict=True):
        run = recording.part(int(begin), int(end))
        index = np.floor(run.time / window + 1e-6).astype(np.int64)
        starts = np.flatnonzero(np.diff(index, prepend=-1))
        ends = np.append(starts[1:], len(index))
        score = _scores(run, starts, ends, window, config)
        for place, start in enumerate(starts):
            at = run.begin + float(index[start]) * window
            section = int((at - first) // SECTION)
            if section not in best or score[place] > best[section].score:
                rows = max(int(start) - MARGIN, 0), min(int(ends[place]) + MARGIN, len(index))
                best[section] = Candidate(float(score[place]), at, run.part(*rows))
    windows = sorted(best.values(), key=lambda one: (-one.score, one.begin))[:most]
    return Lively(sorted(windows, key=lambda one: one.begin), first, last, findings)


def _scores(run: Recording, starts: Indices, ends: Indices, window: float, config: TaskConfig) -> Floats:
    """Liveliness of windows of rows."""
    pressure = config.plant.supply.pressure
    size = np.array([config.plant.cylinder.stroke, pressure, pressure, 1.0, 1.0])
    span = np.fmax.reduceat(run.signals, starts, axis=1) - np.fmin.reduceat(run.signals, starts, axis=1)
    score = np.nansum(np.minimum(span / size[:, None], 1.0), axis=0)
    command, count = run.signals[COMMAND], ends - starts
    way = np.add.reduceat(np.abs(np.nan_to_num(np.diff(command, prepend=command[0]))), starts)
    full = np.add.reduceat((np.abs(command) >= FULL_COMMAND).astype(np.int64), starts)
    step = float(np.median(np.diff(run.time))) if len(run.time) > 1 else window
    period = max(config.control_period, step)
    known = np.flatnonzero(np.isfinite(command))
    gap = np.full(len(command), 0.0 if len(known) else np.inf)
    between = np.diff(run.time[known])
    gap[known[1:]] = between
    gap[known[:-1]] = np.maximum(gap[known[:-1]], between)
    useless = np.maximum.reduceat(gap, starts) > (LONGEST_FILL + 1.5) * period
    useless |= (count < LEAST_ROWS * window / max(step, 1e-9)) | (full > MOST_ROWS_AT_FULL_COMMAND * count)
    return np.asarray(score + np.minimum(way / window, 1.0) + UNUSABLE * useless)


def sampled_windows(candidates: Sequence[Candidate], window: float, config: TaskConfig) -> Sampled:
    """The samples of windows (at least one) as those of one recording, for ``cut``.

    Two windows lie one window apart; their margins stand between them. A window whose samples are not as the task or
    the first one expects is left out, unless all are: then the first tells why.
    """
    found = [(candidate, sampled(candidate.rows, config)) for candidate in candidates]
    good = [(candidate, one) for candidate, one in found if len(one.place)]
    if not good:
        return found[0][1]
    period, parts = good[0][1].period, []
    length = round(window / period)
    good = [(candidate, one) for candidate, one in good if abs(one.period / period - 1.0) <= LARGEST_DEVIATION]
    for place, (candidate, one) in enumerate(good):
        before = round((candidate.begin - candidate.rows.begin - one.time[0]) / period)
        places = one.place - before + (1 + 2 * place) * length
        parts.append(one._replace(place=places, time=places * period))
    findings: dict[tuple[str, Weight], Finding] = {}  # each kind once
    for part in parts:
        for finding in part.findings:
            findings[finding.signal, finding.weight] = finding
    joined: dict[str, Any] = {}
    for name in ("place", "time", "signals"):
        joined[name] = np.concatenate([getattr(part, name) for part in parts], axis=-1)
    auxiliary = {name: np.concatenate([part.auxiliary[name] for part in parts]) for name in parts[0].auxiliary}
    return parts[0]._replace(**joined, findings=list(findings.values()), auxiliary=auxiliary)
