"""The verdict of ``hydro diagnose``: the rules that turn findings and readings into an answer."""

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple, Self

import numpy as np

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.running.statistics import UNKNOWN, Interval
from hydro_agents.running.text import decimals_for, number
from hydro_env import TaskConfig
from hydro_env.task.configuration import LeakageDraw
from hydro_env.types import Mask
from hydro_rig.recordings.findings import Finding, Weight

MOST = 0.5  # share of the windows that counts as "most"
CHANGED = 3.0  # change of the leak within a recording that is told, in standard deviations of a window's reading


class Kind(StrEnum):
    """The four verdicts."""

    HEALTHY = "healthy"
    LEAK = Cause.INTERNAL_LEAK.word
    OTHER = "something else"
    UNKNOWN = Cause.UNKNOWN.word


EXIT_CODES = {Kind.HEALTHY: 0, Kind.LEAK: 10, Kind.OTHER: 11, Kind.UNKNOWN: 12}  # 2: bad input


class Leak(Interval):
    """A leak in l/min at 100 bar with its 90 % interval."""

    @property
    def positive(self) -> Self:
        """Without sizes below zero, for people; NaN stays."""
        return type(self)(*np.maximum(self, 0.0))

    def text(self) -> str:
        """``1.02 [0.98, 1.06] l/min at 100 bar``; the width of the interval sets the number of decimals."""
        decimals = min(decimals_for(self.high - self.low, 2), 4)
        return "{} [{}, {}] l/min at 100 bar".format(*(number(part, decimals) for part in self.positive))


NO_LEAK = Leak(*UNKNOWN)  # no reading


class Limits(NamedTuple):
    """Leaks in l/min at 100 bar."""

    healthy: float  # largest leak of a healthy seal
    fault: float  # smallest leak that counts as a fault

    @classmethod
    def of(cls, config: TaskConfig) -> Self:
        """Those of the task; its defaults hold for the default rig, and grow with the flow of a rig."""
        given, usual = config.leakage, LeakageDraw()
        healthy, fault = given.class_bounds[0], given.faulty_range[0]
        if (healthy, fault) != (usual.class_bounds[0], usual.faulty_range[0]):
            return cls(healthy, fault)
        scale = leak_scale(config)
        return cls(scale * healthy, scale * fault)


class Verdict(NamedTuple):
    """The answer."""

    kind: Kind
    why: str  # the fault, or the reason
    leak: Leak | None  # None: no reading

    def line(self) -> str:
        """The verdict in one line."""
        kind = self.kind
        line = f"{kind}: {self.why}"
        if not self.leak or kind is Kind.UNKNOWN:
            return line
        size = self.leak.text()
        if kind is Kind.LEAK:
            return "; ".join(filter(None, [f"{kind} of {size}", self.why]))
        seal = f"leak past the piston {size}"
        if kind is Kind.HEALTHY:
            return ", ".join(filter(None, [f"{kind}: {seal}", self.why]))
        return f"{line}; {seal}"


class Case(NamedTuple):
    """What the rules of the verdict look at."""

    findings: Sequence[Finding]  # about the recording
    reading: Reading  # of the estimator in the order of time; empty: nothing was read
    limits: Limits
    residual: str = ""  # which signal differs from the model; for the reason where it does not hold
    blind: bool = False  # neither pressure was recorded

    def of_weight(self, weight: Weight) -> list[str]:
        """The findings of a weight, a line each."""
        return [finding.line() for finding in self.findings if finding.weight is weight]

    @property
    def missed(self) -> Mask:
        """Of the windows that the estimator has tried to explain, those that its model does not explain."""
        tried = ~np.isin(self.reading.why, (Why.NO_COMMANDS, Why.NOT_READ))
        return self.reading.cause[tried] == Cause.UNKNOWN

    @property
    def blamed(self) -> str:
        """A faulty sensor, for reasons: it may be why a model does not hold."""
        return "; ".join(["", *self.of_weight(Weight.FAULT)[:1]])

    @property
    def leak(self) -> Leak:
        """The leak of the recording."""
        return combined(self.reading)[0]

    @property
    def fault(self) -> str:
        """What else than the seal is faulty; where the model differs slowly from several signals, it names no fault."""
        stuck = self.of_weight(Weight.FAULT)
        if stuck:
            return f"{Cause.SENSOR.word}: {stuck[0]}"
        return "" if self.of_weight(Weight.DOUBT) else named_fault(self.reading)

    def answer(self, kind: Kind, why: str = "") -> Verdict:
        """A verdict with the leak."""
        return Verdict(kind, why, self.leak)


def severe_finding(case: Case) -> Verdict | None:
    """A severe finding about the recording → cannot tell: what was found."""
    severe = case.of_weight(Weight.SEVERE)
    if not severe:
        return None
    more = f" (and {len(severe) - 1} more)" if len(severe) > 1 else ""
    return Verdict(Kind.UNKNOWN, severe[0] + more, None)


def other_rig(case: Case) -> Verdict | None:
    """The model explains less than half of the windows → cannot tell: it does not describe this rig.

    No sensor is blamed then: a model that does not explain the other channels is no witness against one.
    """
    missed = case.missed
    if missed.sum() <= MOST * len(missed):
        return None
    why = f"the model does not describe this rig: it explains too little in {missed.sum()} of the {len(missed)} "
    why += "windows that were read"
    if case.residual:
        why += f"; {case.residual}"
    return Verdict(Kind.UNKNOWN, f"{why}; check --rig{case.blamed}", None)


def no_size(case: Case) -> Verdict | None:
    """No window gives a size → something else if a sensor is faulty while the model explains the others.

    Otherwise → cannot tell: why.
    """
    if case.reading.sized.any():
        return None
    if case.of_weight(Weight.FAULT) and case.missed.sum() < MOST * len(case.missed):
        return Verdict(Kind.OTHER, case.fault, None)
    return Verdict(Kind.UNKNOWN, _why_nothing(case) + case.blamed, None)


def leaks(case: Case) -> Verdict | None:
    """The interval lies above the largest leak of a healthy seal → internal leak; another fault is named too.

    Cannot tell if there is one, and neither pressure was recorded.
    """
    if case.leak.low <= case.limits.healthy:
        return None
    if case.blind and case.fault:
        why = f"the leak past the piston is {case.leak.text()}, besides {case.fault}, but without pressures another "
        why += "machine than that of the rig file looks the same; record one pressure at least, or check the file by "
        return case.answer(Kind.UNKNOWN, why + "hydro identify")
    besides = f"besides, {case.fault}" if case.fault else ""
    return case.answer(Kind.LEAK, "; ".join(filter(None, [combined(case.reading)[1], besides])))


def other_fault(case: Case) -> Verdict | None:
    """A sensor is faulty, or most windows show another fault → something else: which."""
    return case.answer(Kind.OTHER, case.fault) if case.fault else None


def both_fit(case: Case) -> Verdict | None:
    """The interval contains healthy and faulty leaks → cannot tell."""
    if case.leak.high < case.limits.fault:
        return None
    doubt = "; ".join(case.of_weight(Weight.DOUBT))
    advice = f"the {doubt}" if doubt else "record more motion, or run the leak test (hydro leak-test)"
    why = f"the leak past the piston is {case.leak.text()}, which may be healthy or faulty; {advice}"
    return case.answer(Kind.UNKNOWN, why)


def leaks_in_a_part(case: Case) -> Verdict | None:
    """A window surely shows a faulty leak, the others do not → cannot tell: a leak may just have begun."""
    reading = case.reading
    faulty = np.flatnonzero(reading.sized & (reading.low_lpm > case.limits.fault))
    if not len(faulty):
        return None
    leak = Leak(*reading.sizes[:, faulty[-1]])
    count = f"{len(faulty)} of {int(reading.sized.sum())} windows"
    why = f"the leak past the piston is {case.leak.text()}, but {count} read a faulty one, the last {leak.text()}"
    return case.answer(Kind.UNKNOWN, f"{why}; it may have just begun: record again")


def tight(case: Case) -> Verdict:
    """What is left → healthy; where the model differs slowly, the interval holds the largest leak that this hides.

    Cannot tell if neither pressure was recorded, or if the model differs slowly and another fault would fit.
    """
    doubt = "; ".join(case.of_weight(Weight.DOUBT))
    if case.blind:
        why = "without pressures a faulty seal can look healthy; record one pressure at least"
    elif doubt and named_fault(case.reading):
        why = f"the {doubt}, or another fault"
    else:
        return case.answer(Kind.HEALTHY, f"although the {doubt}" if doubt else "")
    return case.answer(Kind.UNKNOWN, f"the leak past the piston is {case.leak.text()}, but {why}")


RULES = (severe_finding, other_rig, no_size, leaks, other_fault, both_fit, leaks_in_a_part, tight)
"""The rules in their order; each gives a verdict, or ``None`` if it does not apply; the last one always does."""


def judge(case: Case) -> Verdict:
    """The verdict of the first of :data:`RULES` that applies."""
    return next(verdict for rule in RULES if (verdict := rule(case)))


def named_fault(reading: Reading) -> str:
    """The fault other than the piston seal in most windows with an answer; empty if there is none."""
    answers = reading.answers
    named = Counter(fault for fault, answered in zip(reading.fault, answers, strict=True) if answered and fault)
    return named.most_common(1)[0][0] if named and named.total() > MOST * answers.sum() else ""


def combined(reading: Reading) -> tuple[Leak, str]:
    """The leak of the recording, or of its last third if the leak has changed, and a phrase about the change.

    Windows of one axis share its unknown parameters; many windows are therefore no more precise than one. The interval
    is that of a typical window, widened if the windows scatter more than their intervals. NaN: no window gives a size.
    """
    leak, low, high = reading.sizes[:, reading.sized]
    if not len(leak):
        return NO_LEAK, ""
    change = ""
    third = len(leak) // 3
    if third >= 2:
        before, after = np.median(leak[:third]), np.median(leak[-third:])
        sigma = np.median(high - low) / (2.0 * HALF_WIDTH)
        scatter = np.median(np.abs(np.diff(leak))) / 0.954  # of one window: a difference has √2 of it
        if abs(after - before) > CHANGED * max(sigma, scatter):
            word = "grew" if after > before else "fell"
            change = f"it {word} from {number(max(before, 0.0), 3)} during the recording"
            leak, low, high = leak[-third:], low[-third:], high[-third:]
    value, below, above = np.median(leak), np.median(leak - low), np.median(high - leak)
    if len(leak) >= 3:
        below, above = np.maximum([below, above], HALF_WIDTH * 1.483 * np.median(np.abs(leak - value)))
    return Leak(*map(float, (value, value - below, value + above))), change


def _why_nothing(case: Case) -> str:
    """The most frequent reason of the windows."""
    why = case.reading.why
    if not len(why):
        return "the recording is shorter than one window"
    refused = Counter(why[why != Why.ANSWERED])
    if not refused:
        return "the answers give the leak no size"
    most = Why(refused.most_common(1)[0][0])
    if most is not Why.NO_COMMANDS:
        return most.word
    return "commands are missing in every window; record without gaps, or read shorter ones (hydro diagnose --window)"
