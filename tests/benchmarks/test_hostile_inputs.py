"""The judge of mangled recordings tells wrong answers from right ones."""

import pandas as pd
import pytest

from benchmarks.hostile_inputs import CHANGES, COLUMNS, Answer, outcome, true_causes
from hydro_rig.diagnosis.verdict import Kind, Leak

HEALTHY, LEAKING = 0.01, 0.3  # l/min
SMALL, LARGE, TWICE = Leak(0.01, 0.005, 0.015), Leak(0.3, 0.29, 0.31), Leak(0.617, 0.594, 0.64)


@pytest.mark.parametrize(
    ("verdict", "causes", "leak", "truth", "mangling", "judged"),
    [
        (Kind.HEALTHY, "", SMALL, HEALTHY, "number of the row", "right"),
        (Kind.LEAK, "", LARGE, LEAKING, "number of the row", "right"),
        (Kind.LEAK, "", LARGE, HEALTHY, "number of the row", "healthy called leaking"),
        (Kind.HEALTHY, "", SMALL, LEAKING, "number of the row", "leaking called healthy"),
        (Kind.OTHER, "pressure_a", SMALL, LEAKING, "pressure_a: stuck", "leaking called healthy"),
        (Kind.OTHER, "pressure_a", None, LEAKING, "pressure_a: stuck", "right"),
        (Kind.OTHER, "pressure_a", SMALL, HEALTHY, "pressures in steps of 1 bar", "wrong cause"),
        (Kind.OTHER, "", SMALL, HEALTHY, "pressure_a: stuck", "wrong cause"),
        (Kind.LEAK, "valve.rated_flow", LARGE, LEAKING, "whole seconds", "wrong cause"),
        (Kind.LEAK, "valve.rated_flow", LARGE, LEAKING, "position: gain of 1.05", "right"),
        (Kind.LEAK, "", TWICE, LEAKING, "row of means", "wrong size"),
        (Kind.UNKNOWN, "", None, HEALTHY, "clock set back by 0.3 s", "cannot tell"),
        ("refused", "", None, LEAKING, "one row per reading", "refused"),
        ("traceback", "", None, LEAKING, "one row per reading", "traceback"),
    ],
)
def test_an_answer_is_judged_by_the_truth(verdict, causes, leak, truth, mangling, judged):
    assert mangling in CHANGES
    answer = Answer(str(verdict), frozenset(causes.split()), leak)
    assert outcome(answer, truth, true_causes(mangling)) == judged


def test_each_mangling_changes_the_recording_in_its_own_way():
    table = pd.DataFrame({name: [0.1 * k + 0.005 * row for row in range(1200)] for k, name in enumerate(COLUMNS)})
    files = {change(table).to_csv() for change in CHANGES.values()}
    assert len(files | {table.to_csv()}) == len(CHANGES) + 1
