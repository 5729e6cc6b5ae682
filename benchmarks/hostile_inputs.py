"""What ``hydro diagnose`` answers on recordings that are mangled as maintenance people export them.

Run: python benchmarks/hostile_inputs.py FOLDER [--jobs 1]

Only what is true of the axis, or what no reading can tell apart from it, is a right cause: a sensor that sticks really
sticks, and a position that reads 5 % too much looks like a larger valve. ``cases.csv`` in the folder holds every case.
"""

import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmarks import command_line, kept_rows
from hydro_agents.learning.loading import shipped
from hydro_env import HydroError, TaskConfig
from hydro_rig.diagnosis.diagnose import Diagnosis, diagnose
from hydro_rig.diagnosis.verdict import Kind, Leak, Limits
from hydro_rig.estimation.estimator import WEAR
from hydro_rig.recordings.findings import Weight
from hydro_rig.recordings.simulated import record_axis

TASK = TaskConfig(episode_duration=10.0)
LIMITS = Limits.of(TASK)
AXES = [(2, 0.01), (1, 0.3), (1, 0.01), (2, 0.3)]  # seed, leak in l/min at 100 bar
WRONG = ["traceback", "healthy called leaking", "leaking called healthy", "wrong cause", "wrong size"]
COLUMNS = ["time [s]", "position [mm]", "pressure_a [bar]", "pressure_b [bar]", "spool_position [%]", "command [V]"]
TIME, POSITION, A, B, SPOOL, COMMAND = COLUMNS


def on(columns: str | Sequence[str], function: Callable[[pd.Series], Any]) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Apply a function to the values of some columns."""
    listed = [columns] if isinstance(columns, str) else columns
    return lambda table: table.assign(**{name: function(table[name]) for name in listed})


CHANGES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "whole seconds": on(TIME, lambda s: np.floor(s + 1e-6)),
    "number of the row": lambda table: table.rename(columns={TIME: "time"}).assign(time=range(len(table))),
    "clock 5 % fast": on(TIME, lambda s: 1.05 * s),
    "clock set back by 0.3 s": on(TIME, lambda s: s - 0.3 * (s.index >= len(s) // 2)),
    "row of means": lambda table: pd.concat([table, table.mean().to_frame().T.assign(**{TIME: 2000.0})]),
    "a second of rows lost": lambda table: table.drop(index=table.index[900:1100]),
    "one row per reading": lambda table: table.melt(TIME, var_name="tag").sort_values(TIME, kind="stable"),
    "position in cm, called mm": on(POSITION, lambda mm: 0.1 * mm),
    "pressures in MPa, called bar": on([A, B], lambda bar: 0.1 * bar),
    "position reversed": on(POSITION, lambda mm: -mm),
    "chambers exchanged": lambda table: table.rename(columns={A: B, B: A}),
    "pressures in steps of 1 bar": on([A, B], lambda bar: bar.round()),
    "pressure_a: offset of 2 bar": on(A, lambda bar: bar + 2.0),
    "pressure_a: gain of 1.05": on(A, lambda bar: 1.05 * bar),
    "pressure_a: stuck": on(A, lambda bar: bar.iloc[0]),
    "position: gain of 1.05": on(POSITION, lambda mm: 1.05 * mm),
    "spool_position: offset of 2 %": on(SPOOL, lambda percent: percent + 2.0),
}


def true_causes(mangling: str) -> frozenset[str]:
    """Causes that a verdict may name."""
    signal, fault, _ = mangling.partition(":")
    larger_valve = mangling == "position: gain of 1.05"
    return frozenset([signal] * bool(fault) + ["valve.rated_flow"] * larger_valve)


class Answer(NamedTuple):
    """What was answered."""

    kind: str  # of the verdict, "refused" or "traceback"
    causes: frozenset[str] = frozenset()  # that the verdict names
    leak: Leak | None = None
    text: str = ""


def outcome(answer: Answer, truth: float, true: frozenset[str]) -> str:
    """One of :data:`WRONG`, "cannot tell", "refused" or "right"; ``truth`` is the leak, l/min at 100 bar.

    A leak has the wrong size if its whole interval is more than a fifth of the truth away; a verdict of another fault
    with a leak that is surely no fault calls the axis healthy. ``true`` holds the causes that may be named.
    """
    kind, leak, leaking = answer.kind, answer.leak, truth >= LIMITS.fault
    no_fault = kind == Kind.HEALTHY or (kind == Kind.OTHER and leak is not None and leak.high < LIMITS.fault)
    distance = np.inf if leak is None else max(leak.low - truth, truth - leak.high)
    found = {
        "traceback": kind == "traceback",
        "healthy called leaking": kind == Kind.LEAK and not leaking,
        "leaking called healthy": leaking and no_fault,
        "wrong cause": not answer.causes <= true or (kind == Kind.OTHER and not answer.causes),
        "wrong size": kind == Kind.LEAK and distance > 0.2 * truth,
        "cannot tell": kind == Kind.UNKNOWN,
        "refused": kind == "refused",
    }
    return next((name for name, holds in found.items() if holds), "right")


def causes_of(diagnosis: Diagnosis) -> frozenset[str]:
    """Signals and unknowns of the estimator that a verdict names."""
    verdict = diagnosis.verdict
    if verdict.kind not in (Kind.OTHER, Kind.LEAK):
        return frozenset()
    signals = (one.signal for one in diagnosis.checked.findings if one.weight is Weight.FAULT)
    unknowns = {name.removesuffix("_bias"): wear.what for name, wear in WEAR.items()}
    named = {signal for signal in signals if f"{signal} " in verdict.why}
    return frozenset(named | {name for name, what in unknowns.items() if what in verdict.why})


def answer_of(file: Path) -> Answer:
    """The answer of the command."""
    try:
        diagnosis = diagnose(file, TASK)
    except HydroError as error:
        return Answer("refused", text=str(error))
    except Exception:
        return Answer("traceback", text=traceback.format_exc()[-500:])
    return Answer(diagnosis.verdict.kind.value, causes_of(diagnosis), diagnosis.verdict.leak, diagnosis.verdict.why)


def rows_of(case: int, folder: Path) -> list[dict[str, Any]]:
    """The row of a case."""
    (seed, leak), mangling = AXES[case % len(AXES)], list(CHANGES)[case // len(AXES)]
    table, file = pd.read_csv(folder / f"axis_{seed}_{leak:g}.csv", comment="#"), folder / f"mangled_{case}.csv"
    CHANGES[mangling](table).to_csv(file, index=False)
    answer = answer_of(file)
    row = {"case": case, "axis": seed, "leak": leak, "mangling": mangling, "causes": " ".join(sorted(answer.causes))}
    row["outcome"] = outcome(answer, leak, true_causes(mangling))
    return [row | {"verdict": f"{answer.kind}: {' '.join(answer.text.split())[:160]}"}]


def main() -> None:
    """Diagnose all mangled recordings; print how many answers are right, and the cases with a wrong one."""
    given = command_line(__doc__, "folder", jobs=1)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed, leak in AXES:
        record_axis(given.folder / f"axis_{seed}_{leak:g}.csv", TASK, shipped("pid", TASK), seed, leak)
    cases = range(len(AXES) * len(CHANGES))
    table = kept_rows(given.folder / "cases.csv", "case", cases, partial(rows_of, folder=given.folder), given.jobs)
    print(table.outcome.value_counts().to_string(), end="\n\n")
    for row in table[table.outcome.isin(WRONG)].itertuples():
        print(f"{row.outcome}: axis {row.axis}, {row.leak:g} l/min, {row.mangling}: {row.verdict}")


if __name__ == "__main__":
    main()
