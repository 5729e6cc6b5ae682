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
from hydro_env.types import Floats
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
        step = float(np.median(np.diff(run.time))) if len(run.time) > 1 else window
        for rows in np.split(np.arange(len(index)), np.flatnonzero(np.diff(index)) + 1):
            within = float(index[rows[0]]) * window
            at = run.begin + within
            section = int((at - first) // SECTION)
            score = _score(run.time[rows] - within, run.signals[:, rows], max(step, 1e-9), window, config)
            if section not in best or score > best[section].score:
                chosen = run.part(max(int(rows[0]) - MARGIN, 0), int(rows[-1]) + 1 + MARGIN)
                best[section] = Candidate(score, at, chosen)
    windows = sorted(best.values(), key=lambda one: (-one.score, one.begin))[:most]
    return Lively(sorted(windows, key=lambda one: one.begin), first, last, findings)


def _score(time: Floats, signals: Floats, step: float, window: float, config: TaskConfig) -> float:
    """Liveliness of the rows of a window: time from its begin (n,), signals (5, n); usual distance of rows ``step``."""
    pressure = config.plant.supply.pressure
    sizes = np.array([config.plant.cylinder.stroke, pressure, pressure, 1.0, 1.0])
    spans = np.fmax.reduce(signals, axis=1) - np.fmin.reduce(signals, axis=1)
    known = np.isfinite(signals[COMMAND])
    command, gaps = signals[COMMAND, known], np.diff(time[known], prepend=0.0, append=window)
    way = float(np.abs(np.diff(command)).sum())
    score = float(np.nansum(np.minimum(spans / sizes, 1.0))) + min(way / window, 1.0)
    longest = (LONGEST_FILL + 1.5) * max(config.control_period, step)
    lacking = len(time) < LEAST_ROWS * window / step or gaps.max() > longest
    full = (np.abs(command) >= FULL_COMMAND).sum() > MOST_ROWS_AT_FULL_COMMAND * len(time)
    return score + UNUSABLE * bool(lacking or full)


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
