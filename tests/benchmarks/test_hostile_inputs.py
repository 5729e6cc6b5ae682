"""The judge of mangled recordings tells wrong answers from right ones."""

import pandas as pd
import pytest

from benchmarks.hostile_inputs import COLUMNS, Answer, manglings, outcome
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
        (Kind.LEAK, "valve.rated_flow", LARGE, LEAKING, "whole seconds, numbers", "wrong cause"),
        (Kind.LEAK, "valve.rated_flow", LARGE, LEAKING, "position: gain of 1.05", "right"),
        (Kind.LEAK, "", TWICE, LEAKING, "row of means", "wrong size"),
        (Kind.UNKNOWN, "", None, HEALTHY, "summer time ends", "cannot tell"),
        ("refused", "", None, LEAKING, "UTF-16", "refused"),
        ("traceback", "", None, LEAKING, "UTF-16", "traceback"),
    ],
)
def test_an_answer_is_judged_by_the_truth(verdict, causes, leak, truth, mangling, judged):
    true = manglings()[mangling].true
    assert outcome(Answer(str(verdict), frozenset(causes.split()), leak), truth, true) == judged


def test_manglings_make_236_recordings_and_each_writes_a_file():
    table = pd.DataFrame({name: [0.1 * k + 0.005 * row for row in range(400)] for k, name in enumerate(COLUMNS)})
    found = manglings()
    assert 4 * len(found) == 236
    plain = found["semicolons and decimal commas"].write(table)
    files = {name: mangling.write(mangling.change(table)) for name, mangling in found.items()}
    assert all(files.values())
    assert len({files[name] for name in files if files[name] != plain}) == len(files) - 1
