"""The verdict of ``hydro diagnose``: the rules that turn findings and readings into an answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import HALF_WIDTH, NO_COMMANDS, Cause, Reading
from hydro_agents.running.text import decimals_for, number
from hydro_env import TaskConfig
from hydro_env.task.configuration import LeakageDraw
from hydro_rig.diagnosis.volume_balance import VolumeLeak
from hydro_rig.estimation.estimator import leak_scale
from hydro_rig.recordings.driving import AXIS
from hydro_rig.recordings.findings import NOT_RECORDED, Finding, Weight

MOST = 0.5  # share of the windows that counts as "most"
CHANGED = 3.0
"""Change of the leak within the recording that the verdict mentions, in standard deviations of a window's reading."""
SHORT = 0.5  # s; the shortest window that is recommended
SHORTER = f"shorter ones (--window {SHORT:g}) may fit between the gaps, and read the leak less exactly"


BALANCE = "balance of volumes"  # as the detector that decided

UNREAD = "not read: the model does not explain the liveliest windows"


class Kind(StrEnum):
    """The four verdicts."""

    HEALTHY = "healthy"
    LEAK = Cause.INTERNAL_LEAK.word
    OTHER = "something else"
    UNKNOWN = Cause.UNKNOWN.word


EXIT_CODES = {Kind.HEALTHY: 0, Kind.LEAK: 10, Kind.OTHER: 11, Kind.UNKNOWN: 12}
"""Of commands that give a verdict; 2 is that of bad input."""


class Leak(NamedTuple):
    """A leak in l/min at 100 bar with its 90 % interval."""

    value: float
    low: float
    high: float

    def text(self) -> str:
        """``1.02 [0.98, 1.06] l/min at 100 bar``; the width of the interval sets the number of decimals."""
        decimals = min(decimals_for(self.high - self.low, 2), 4)
        parts = (number(max(part, 0.0), decimals) for part in self)
        return "{} [{}, {}] l/min at 100 bar".format(*parts)


class Limits(NamedTuple):
    """Leaks in l/min at 100 bar."""

    healthy: float  # largest leak of a healthy seal
    fault: float  # smallest leak that counts as a fault

    @classmethod
    def of(cls, config: TaskConfig) -> Limits:
        """Those of the task; its defaults hold for the default rig, and grow with the flow of a rig."""
        given, usual = ((one.class_bounds[0], one.faulty_range[0]) for one in (config.leakage, LeakageDraw()))
        scale = leak_scale(config) if given == usual else 1.0
        return cls(scale * given[0], scale * given[1])


class Verdict(NamedTuple):
    """The answer."""

    kind: Kind
    why: str  # the fault, or the reason
    leak: Leak | None  # None: no reading
    detector: str  # that decided; empty: none

    def line(self) -> str:
        """The verdict in one line."""
        if self.kind is Kind.LEAK and self.leak is not None:
            return f"{self.kind.value} of {self.leak.text()}{f'; {self.why}' if self.why else ''}"
        if self.kind is Kind.HEALTHY and self.leak is not None:
            return f"healthy: leak past the piston {self.leak.text()}"
        seal = f"; leak past the piston {self.leak.text()}" if self.kind is Kind.OTHER and self.leak is not None else ""
        return f"{self.kind.value}: {self.why}{seal}"


def judge(
    findings: Sequence[Finding],
    estimator: Reading | None,
    head: Reading | None,
    limits: Limits,
    window: float = 2.0,
    residual: str = "",
) -> Verdict:
    """The verdict on a recording; the first rule that applies decides.

    1. A severe finding about the recording → **cannot tell**: what was found.
    2. The estimator's model explains less than half of the windows → **cannot tell**: the model does not describe this
       rig. No sensor is blamed then: a model that does not explain the other channels is no witness against one.
    3. The estimator has read windows, and none determines the leak; or no detector has read a window → **something
       else** if a sensor sticks or loses readings while the model explains the others, otherwise **cannot tell**: why.
    4. The interval of the leak lies above the largest leak of a healthy seal → **internal leak** of that size; any
       other fault is named too.
    5. A sensor sticks or loses readings, or most windows show another fault → **something else**: which.
    6. The interval lies below the smallest leak that counts as a fault → **healthy**; **cannot tell** if neither
       pressure was recorded.
    7. The interval contains healthy and faulty leaks → **cannot tell**.

    The estimator decides if it has run, because its model shows when it is not valid, and its intervals what a
    recording does not determine; the leakage head decides only where the estimator has not run.

    Args:
        findings: about the recording.
        estimator: readings of the estimator in the order of time; ``None``: it was not used.
        head: readings of the leakage head in the order of time; ``None``: it was not used.
        limits: of leaks.
        window: s, length of a window.
        residual: which signal differs from the model; for the reason where it does not hold.
    """
    severe = [finding for finding in findings if finding.weight is Weight.SEVERE]
    driven = "".join(f"; {finding.line()}" for finding in findings if finding.signal == AXIS)
    if severe:
        more = (f" (and {len(severe) - 1} more)" if len(severe) > 1 else "") + driven
        return Verdict(Kind.UNKNOWN, severe[0].line() + more, None, "")
    sensors = [finding for finding in findings if finding.weight is Weight.FAULT]
    besides = f"{Cause.SENSOR.word}: {sensors[0].line()}" if sensors else ""
    blamed = "".join(f"; {finding.line()}" for finding in sensors[:1]) + driven
    ran, misfits = estimator is not None and any(why != NO_COMMANDS for why in estimator.why), 0.0
    if estimator is not None and ran:
        read = np.array([why not in (NO_COMMANDS, UNREAD) for why in estimator.why])
        missed = estimator.cause[read] == Cause.UNKNOWN
        misfits = _share(missed)
        if misfits > MOST:
            why = "the model does not describe this rig: it explains too little in "
            why += f"{int(missed.sum())} of the {int(read.sum())} windows that were read"
            why += f"; {residual}" if residual else ""
            why += f"; check --rig{blamed}"
            return Verdict(Kind.UNKNOWN, why, None, "estimator")
    leader, reading = ("estimator", estimator) if ran else ("leakage head", head)
    if reading is None or not reading.answers.any():
        if ran and besides and misfits < MOST:
            return Verdict(Kind.OTHER, besides, None, leader)
        return Verdict(Kind.UNKNOWN, _why_nothing(window, estimator, head) + blamed, None, "")
    leak, change = combined(reading)
    besides = besides or named_fault(reading)
    if leak.low > limits.healthy:
        return Verdict(
            Kind.LEAK, "; ".join(part for part in (change, besides and f"besides, {besides}") if part), leak, leader
        )
    if besides:
        return Verdict(Kind.OTHER, besides, leak, leader)
    if leak.high < limits.fault and _without_pressures(findings):
        why = f"the leak past the piston is {leak.text()}, but without pressures a faulty seal can look healthy"
        return Verdict(Kind.UNKNOWN, f"{why}; record one pressure at least", leak, leader)
    if leak.high < limits.fault:
        return Verdict(Kind.HEALTHY, "", leak, leader)
    why = f"the leak past the piston is {leak.text()}, which may be healthy or faulty; record more motion"
    return Verdict(Kind.UNKNOWN, why, leak, leader)


def by_volume(verdict: Verdict, balance: VolumeLeak, limits: Limits) -> Verdict:
    """The verdict with a measured flow: where the detectors cannot tell, the balance of volumes decides alone.

    The caller makes sure that no severe finding speaks against the signals of the balance, and that it belongs to the
    piston of the rig (:meth:`~hydro_rig.diagnosis.volume_balance.VolumeLeak.on`).
    """
    if verdict.kind is not Kind.UNKNOWN:
        return verdict
    if balance.why:
        return verdict._replace(why=f"{verdict.why}; flow {balance.why}")
    leak = Leak(balance.value, balance.low, balance.high)
    why = f"by a balance of volumes over {balance.moves} steady moves, which needs no valve"
    if leak.low > limits.healthy:
        return Verdict(Kind.LEAK, why, leak, BALANCE)
    if leak.high < limits.fault:
        return Verdict(Kind.HEALTHY, why, leak, BALANCE)
    why = f"the leak past the piston is {leak.text()} {why}; it may be healthy or faulty"
    return Verdict(Kind.UNKNOWN, why, leak, BALANCE)


def _without_pressures(findings: Sequence[Finding]) -> bool:
    """Whether neither pressure was recorded."""
    absent = {finding.signal for finding in findings if finding.what == NOT_RECORDED}
    return {"pressure_a", "pressure_b"} <= absent


def named_fault(reading: Reading) -> str:
    """The fault other than the piston seal in most windows with an answer; empty if there is none."""
    answers = reading.answers
    named = Counter(fault for fault, answered in zip(reading.fault, answers, strict=True) if answered and fault)
    return named.most_common(1)[0][0] if named and named.total() >= MOST * answers.sum() else ""


def combined(reading: Reading) -> tuple[Leak, str]:
    """The leak of the recording, or of its last third if the leak has changed, and a phrase about the change.

    Windows of one axis share its unknown parameters; many windows are therefore no more precise than one. The interval
    is that of a typical window, widened if the windows scatter more than their intervals.
    """
    leak, low, high = (values[reading.answers] for values in (reading.flow_lpm, reading.low_lpm, reading.high_lpm))
    change = ""
    third = len(leak) // 3
    if third >= 2:
        before, after = float(np.median(leak[:third])), float(np.median(leak[-third:]))
        sigma = float(np.median(high - low)) / (2.0 * HALF_WIDTH)
        scatter = float(np.median(np.abs(np.diff(leak)))) / 0.954  # of one window: a difference has √2 of it
        if abs(after - before) > CHANGED * max(sigma, scatter):
            word = "grew" if after > before else "fell"
            change = f"it {word} from {number(max(before, 0.0), 3)} during the recording"
            leak, low, high = leak[-third:], low[-third:], high[-third:]
    value = float(np.median(leak))
    below, above = float(np.median(leak - low)), float(np.median(high - leak))
    if len(leak) >= 3:
        scatter = HALF_WIDTH * 1.483 * float(np.median(np.abs(leak - value)))
        below, above = max(below, scatter), max(above, scatter)
    return Leak(value, value - below, value + above), change


def _share(mask: NDArray[np.bool_]) -> float:
    return float(mask.mean()) if len(mask) else 0.0


def _why_nothing(window: float, *readings: Reading | None) -> str:
    """The most frequent reason of the first detector that ran."""
    for reading in readings:
        if reading is not None and any(reading.why):
            why = Counter(why for why in reading.why if why).most_common(1)[0][0]
            if why != NO_COMMANDS:
                return why
            return f"commands are missing in every window; {SHORTER if window > SHORT else 'record without gaps'}"
    return "the recording is shorter than one window"
