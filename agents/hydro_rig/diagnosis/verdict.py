"""The verdict of ``hydro diagnose``: the rules that turn findings and readings into an answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.running.text import decimals_for, number
from hydro_env import TaskConfig
from hydro_env.task.configuration import LeakageDraw
from hydro_rig.diagnosis.volume_balance import VolumeLeak
from hydro_rig.recordings.channels import AXIS
from hydro_rig.recordings.findings import Finding, Weight

MOST = 0.5  # share of the windows that counts as "most"
CHANGED = 3.0
"""Change of the leak within the recording that the verdict mentions, in standard deviations of a window's reading."""
SHORT = 0.5  # s; the shortest window that is recommended
SHORTER = f"shorter ones (--window {SHORT:g}) may fit between the gaps, and read the leak less exactly"

BALANCE = "balance of volumes"  # as the detector that decided


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
    companion: Reading | None,
    limits: Limits,
    window: float = 2.0,
    residual: str = "",
    companion_name: str = "leakage head",
) -> Verdict:
    """The verdict on a recording: that of the first rule which applies.

    1. A severe finding about the recording → **cannot tell**: what was found.
    2. The estimator's model explains less than half of the windows → **cannot tell**: the model does not describe this
       rig. No sensor is blamed then: a model that does not explain the other channels is no witness against one.
    3. The estimator has read windows, and none determines the leak; or no detector has read a window → **something
       else** if a sensor sticks or loses readings while the model explains the others, otherwise **cannot tell**: why.
    4. The interval of the leak lies above the largest leak of a healthy seal → **internal leak** of that size; any
       other fault is named too. **Cannot tell** if there is one and neither pressure was recorded.
    5. A sensor sticks or loses readings, or most windows show another fault → **something else**: which.
    6. The interval lies below the smallest leak that counts as a fault → **healthy**; **cannot tell** if neither
       pressure was recorded, or if the model differs slowly from several signals.
    7. The interval contains healthy and faulty leaks → **cannot tell**.

    Where the model differs slowly from several signals, by more than their noise, it names no fault.

    The estimator decides if it has run, because its model shows when it is not valid, and its intervals what a
    recording does not determine; the detector beside it decides only where the estimator has not run.

    Args:
        findings: about the recording.
        estimator: readings of the estimator in the order of time; ``None``: it was not used.
        companion: those of the detector beside it; ``None``: it was not used.
        limits: of leaks.
        window: s, length of a window.
        residual: which signal differs from the model; for the reason where it does not hold.
        companion_name: of the detector beside the estimator.
    """
    nothing = Reading.of(np.zeros(0))
    estimator, companion = estimator or nothing, companion or nothing
    severe, stuck = ([one for one in findings if one.weight is weight] for weight in (Weight.SEVERE, Weight.FAULT))
    lacking = "; ".join(finding.line() for finding in findings if finding.weight is Weight.DOUBT)
    driven = "".join(f"; {finding.line()}" for finding in findings if finding.signal == AXIS)
    blamed = "".join(f"; {finding.line()}" for finding in stuck[:1]) + driven
    if severe:  # rule 1
        more = f" (and {len(severe) - 1} more)" if len(severe) > 1 else ""
        return Verdict(Kind.UNKNOWN, f"{severe[0].line()}{more}{driven}", None, "")

    tried = ~np.isin(estimator.why, (Why.NO_COMMANDS, Why.NOT_READ))
    missed = int((estimator.cause[tried] == Cause.UNKNOWN).sum())
    share = missed / max(int(tried.sum()), 1)
    if share > MOST:  # rule 2
        why = f"the model does not describe this rig: it explains too little in {missed} of the {tried.sum()} windows "
        why += f"that were read{f'; {residual}' if residual else ''}; check --rig{blamed}"
        return Verdict(Kind.UNKNOWN, why, None, "estimator")

    ran = bool((estimator.why != Why.NO_COMMANDS).any())
    reading, leader = (estimator, "estimator") if ran else (companion, companion_name)
    fault = f"{Cause.SENSOR.word}: {stuck[0].line()}" if stuck else "" if lacking else named_fault(reading)
    if not reading.sized.any():  # rule 3
        if stuck and tried.any() and share < MOST:
            return Verdict(Kind.OTHER, fault, None, leader)
        return Verdict(Kind.UNKNOWN, _why_nothing(window, estimator, companion) + blamed, None, "")

    leak, change = combined(reading)
    absent = {finding.signal for finding in findings if finding.absent}
    blind = {"pressure_a", "pressure_b"} <= absent
    size = f"the leak past the piston is {leak.text()}"
    if leak.low > limits.healthy and blind and fault:
        why = f"{size}, besides {fault}, but without pressures another machine than "
        why += "that of the rig file looks the same; record one pressure at least, or check the file by hydro identify"
        return Verdict(Kind.UNKNOWN, why, leak, leader)
    if leak.low > limits.healthy:  # rule 4
        parts = [change, f"besides, {fault}" if fault else ""]
        return Verdict(Kind.LEAK, "; ".join(part for part in parts if part), leak, leader)
    if fault:  # rule 5
        return Verdict(Kind.OTHER, fault, leak, leader)
    if leak.high >= limits.fault:  # rule 7
        advice = f"the {lacking}" if lacking else "record more motion, or run the leak test (hydro leak-test)"
        why = f"{size}, which may be healthy or faulty; {advice}"
        return Verdict(Kind.UNKNOWN, why, leak, leader)
    if blind:
        why = f"{size}, but without pressures a faulty seal can look healthy; record one pressure at least"
        return Verdict(Kind.UNKNOWN, why, leak, leader)
    if lacking:
        why = f"{size}, but the {lacking}"
        return Verdict(Kind.UNKNOWN, why, leak, leader)
    return Verdict(Kind.HEALTHY, "", leak, leader)  # rule 6


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


def named_fault(reading: Reading) -> str:
    """The fault other than the piston seal in most windows with an answer; empty if there is none."""
    answers = reading.answers
    named = Counter(fault for fault, answered in zip(reading.fault, answers, strict=True) if answered and fault)
    return named.most_common(1)[0][0] if named and named.total() >= MOST * answers.sum() else ""


def combined(reading: Reading) -> tuple[Leak, str]:
    """The leak of the recording, or of its last third if the leak has changed, and a phrase about the change.

    Windows of one axis share its unknown parameters; many windows are therefore no more precise than one. The interval
    is that of a typical window, widened if the windows scatter more than their intervals. NaN: no window gives a size.
    """
    leak, low, high = (values[reading.sized] for values in (reading.flow_lpm, reading.low_lpm, reading.high_lpm))
    if not len(leak):
        return Leak(np.nan, np.nan, np.nan), ""
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


def _why_nothing(window: float, *readings: Reading) -> str:
    """The most frequent reason of the first detector that gives one."""
    for reading in readings:
        reasons = Counter(reading.why[reading.why != Why.ANSWERED].tolist())
        if not reasons:
            continue
        why = Why(reasons.most_common(1)[0][0])
        if why is not Why.NO_COMMANDS:
            return why.word
        return f"commands are missing in every window; {SHORTER if window > SHORT else 'record without gaps'}"
    return "the recording is shorter than one window"
