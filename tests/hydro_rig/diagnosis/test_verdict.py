"""The rules of the verdict, as a table."""

import numpy as np
import pytest

from hydro_agents.detection.detector import Cause, Reading, Why
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_rig.diagnosis.verdict import NO_LEAK, Case, Kind, Leak, Limits, combined, judge
from hydro_rig.recordings.findings import Finding, Weight

LIMITS = Limits(0.03, 0.1)
NOTE = Finding("time", "has a gap of 200 ms", Weight.NOTE)
STUCK = Finding("pressure_a", "is stuck at one value", Weight.FAULT)
WRONG = Finding("position", "reads metres", Weight.SEVERE)
DIFFERS = Finding("model", "differs slowly from several signals", Weight.DOUBT)


def reading(*leaks, width=0.01, cause=Cause.NONE, fault="", why=Why.ANSWERED):
    """Windows with these leaks; the other arguments hold for all."""
    leak, count = np.array(leaks, dtype=np.float64), len(leaks)
    ends = {"low_lpm": leak - width, "high_lpm": leak + width}
    return Reading.of(leak, np.full(count, cause), flow_lpm=leak, fault=fault, why=why, **ends)


def misfit(count=4):
    return reading(*[0.5] * count, cause=Cause.UNKNOWN, why=Why.MISFIT)


NOTHING = Reading.of(np.zeros(0))
HEALTHY, LEAK = reading(0.01, 0.012, 0.011), reading(1.0, 1.02, 0.99)
UNDETERMINED = reading(0.2, 0.2, cause=Cause.UNDETERMINED, why=Why.UNDETERMINED)
GAPS = reading(0.2, cause=Cause.UNDETERMINED, why=Why.NO_COMMANDS)
HALF_MISFIT = Reading.of([0.2, 0.2], [Cause.UNKNOWN, Cause.UNDETERMINED], why=[Why.MISFIT, Why.UNDETERMINED])
CASES = {
    "healthy": ([], HEALTHY, Kind.HEALTHY, "healthy: leak past the piston 0.011 [0.001, 0.021]"),
    "leak": ([], LEAK, Kind.LEAK, "internal leak of 1.000 ["),
    "leak that has just begun": (
        [],
        reading(*[0.01] * 9, 0.5),
        Kind.UNKNOWN,
        "but 1 of 10 windows read a faulty one, the last 0.500 [",
    ),
    "no pressures, seems tight": ([], HEALTHY, Kind.UNKNOWN, "record one pressure"),
    "no pressures, leak": ([], LEAK, Kind.LEAK, "internal leak"),
    "no pressures, leak and worn valve": (
        [],
        reading(1.0, fault="worn edges"),
        Kind.UNKNOWN,
        "besides worn edges, but without pressures",
    ),
    "notes change nothing": ([NOTE], LEAK, Kind.LEAK, ""),
    "differs slowly, seems tight": ([DIFFERS], HEALTHY, Kind.HEALTHY, "although the model differs slowly"),
    "differs slowly, a fault would fit": (
        [DIFFERS],
        reading(0.01, 0.01, cause=Cause.RETURN_LINE, fault="pressure in the return line"),
        Kind.UNKNOWN,
        "but the model differs slowly",
    ),
    "differs slowly, may leak": ([DIFFERS], reading(0.05, width=0.06), Kind.UNKNOWN, "faulty; the model differs"),
    "differs slowly, surely leaks": ([DIFFERS], reading(1.0, 1.0, fault="worn"), Kind.LEAK, "at 100 bar"),
    "severe finding": ([NOTE, WRONG], LEAK, Kind.UNKNOWN, "cannot tell: position reads metres"),
    "several severe findings": ([WRONG, WRONG], LEAK, Kind.UNKNOWN, "(and 1 more)"),
    "model misfits": ([], misfit(), Kind.UNKNOWN, "cannot tell: the model does not describe this rig"),
    "stuck sensor, tight seal": ([STUCK], HEALTHY, Kind.OTHER, "something else: sensor fault: pressure_a"),
    "stuck sensor, no reading": ([STUCK], NOTHING, Kind.UNKNOWN, "one window; pressure_a is stuck at one value"),
    "stuck sensor, model misfits": ([STUCK], misfit(), Kind.UNKNOWN, "check --rig; pressure_a is stuck"),
    "stuck sensor, leak undetermined": ([STUCK], UNDETERMINED, Kind.OTHER, "something else: sensor fault: pressure_a"),
    "stuck sensor and leak": ([STUCK], LEAK, Kind.LEAK, "besides, sensor fault: pressure_a is stuck"),
    "worn valve": ([], reading(0.01, 0.01, fault="worn edges"), Kind.OTHER, "something else: worn edges;"),
    "worn valve and leak": ([], reading(1.0, 1.0, fault="worn edges"), Kind.LEAK, "besides, worn edges"),
    "nothing read": ([], NOTHING, Kind.UNKNOWN, "cannot tell: the recording is shorter than one window"),
    "answers without a size": ([], reading(np.nan), Kind.UNKNOWN, "no size"),
    "standstill": ([], UNDETERMINED, Kind.UNKNOWN, f"cannot tell: {Why.UNDETERMINED.word}"),
    "gaps": ([], GAPS, Kind.UNKNOWN, "cannot tell: commands are missing in every window; record without gaps"),
    "half of the windows misfit": ([], HALF_MISFIT, Kind.UNKNOWN, "cannot tell: "),
    "interval holds both": ([], reading(0.05, 0.05, width=0.06), Kind.UNKNOWN, "may be healthy or faulty"),
    "small but sure": ([], reading(0.05, 0.05), Kind.LEAK, "internal leak of 0.050"),
}


@pytest.mark.parametrize("case", CASES)
def test_rule(case):
    findings, read, kind, words = CASES[case]
    verdict = judge(Case(findings, read, LIMITS, blind="no pressures" in case))
    assert verdict.kind is kind
    assert words in verdict.line()
    assert "\n" not in verdict.line()
    assert verdict.leak is None or "misfits" not in case  # no number for a rig that the model does not describe


def test_limits_grow_with_the_flow_of_the_rig_and_stay_if_the_task_gives_its_own():
    default = TaskConfig()
    assert Limits.of(default) == LIMITS
    wide = default.plant.replace(valve={"rated_flow": 4.0 * default.plant.valve.rated_flow})
    assert Limits.of(task_config(default, plant=wide)) == pytest.approx((0.12, 0.4))
    own = {"leakage": {"class_bounds": [0.05, 0.3, 1.0]}}
    assert Limits.of(task_config(task_config(default, **own), plant=wide)) == (0.05, 0.1)


def test_a_person_reads_no_size_below_zero():
    assert Leak(0.01, -0.02, 0.04).positive == Leak(0.01, 0.0, 0.04)
    assert np.isnan(NO_LEAK.positive).all()


def test_a_leak_that_has_changed_is_that_of_the_end():
    leak, change = combined(reading(0.01, 0.01, 0.01, 0.5, 0.51, 0.5, 0.5, 0.5, 0.5))
    assert leak.value == 0.5
    assert change == "it grew from 0.010 during the recording"
    assert combined(reading(0.01, 0.012, 0.011, 0.01, 0.012, 0.011))[1] == ""


def test_windows_that_scatter_widen_the_interval():
    narrow, _ = combined(reading(1.0, 1.001, 0.999, 1.0))
    wide, _ = combined(reading(0.8, 1.2, 0.9, 1.1))
    assert narrow.high - narrow.low == pytest.approx(0.02)
    assert wide.high - wide.low > 0.3
