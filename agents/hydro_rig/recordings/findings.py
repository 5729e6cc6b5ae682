"""Findings about a recording: one line each, with its first time in seconds and its share of the recording."""

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from hydro_agents.running.text import number
from hydro_env.types import Floats, Indices, Mask

MOST_MISSING = 0.9  # largest share of missing readings of a sensor: every tenth row, by a slower program, tells enough
MOST_SPIKES = 0.05  # largest share of out-of-range values that count as single spikes, which are left out
MOST_MISSING_COMMANDS = 0.2  # the same for the command, without which the axis cannot be simulated


class Weight(StrEnum):
    """Effect of a finding on the verdict."""

    NOTE = "note"  # no effect
    DOUBT = "doubt"  # the model explains the readings only in part: nothing is healthy, and no other fault is sure
    FAULT = "fault"  # a sensor of the rig is faulty
    SEVERE = "severe"  # no verdict is possible


class Finding(NamedTuple):
    """One defect of a recording."""

    signal: str  # or "time"
    what: str  # rest of the sentence, beginning with a verb
    weight: Weight = Weight.NOTE
    begin: float = np.nan  # s, first place; NaN for the whole recording
    end: float = np.nan  # s, end of the first place
    share: float = np.nan  # of the recording, 0 to 1

    def line(self) -> str:
        """The finding in one line."""
        parts = [f"{self.signal} {self.what}"]
        if np.isfinite(self.begin):
            to = f" to {number(self.end, 3)}" if self.end > self.begin else ""
            parts.append(f"first at {number(self.begin, 3)}{to} s")
        if np.isfinite(self.share):
            parts.append(f"{number(100.0 * self.share, digits=2)} % of the recording")
        return ", ".join(parts)


Findings = list[Finding]


def severe_of(findings: Iterable[Finding]) -> Findings:
    """Those that rule out a verdict."""
    return [finding for finding in findings if finding.weight is Weight.SEVERE]


def lines_of(findings: Iterable[Finding]) -> list[str]:
    """The findings in a line each."""
    return [finding.line() for finding in findings]


def runs_of(mask: Mask) -> tuple[Indices, Indices]:
    """First index of each run of true values, and the index after its last."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def missing_weight(signal: str, share: float) -> Weight:
    """Weight of a share of missing readings of a signal."""
    return severe_if(share > (MOST_MISSING_COMMANDS if signal == "command" else MOST_MISSING))


def severe_if(condition: object) -> Weight:
    """The weight of what counts under a condition alone."""
    return Weight.SEVERE if condition else Weight.NOTE


def finding_of(mask: Mask, time: Floats, signal: str, what: str, weight: Weight = Weight.NOTE) -> Finding:
    """A finding about the rows where ``mask`` (n,) is true (at least one); ``time`` (n,), s."""
    begins, ends = runs_of(mask)
    return Finding(signal, what, weight, time[begins[0]], time[ends[0] - 1], mask.mean())
