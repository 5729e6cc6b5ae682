"""What ``hydro diagnose`` answers on 300 recordings that are mangled as maintenance people export them.

Run: python benchmarks/hostile_inputs.py FOLDER [--jobs 1]

``hostile_recordings.py`` lists the ways. ``cases.csv`` in the folder holds every case; those in it are left out.
Where the message advises something that the map or the command can say, the recording is read again with the advice
followed, as a reader of the message would. Verdict, leak and causes come from the diagnosis; only advice is text.
"""

from __future__ import annotations

import contextlib
import io
import re
import traceback
from collections.abc import Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import yaml

from benchmarks import command_line
from benchmarks.hostile_recordings import manglings
from benchmarks.kept_rows import kept_rows
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import load_head
from hydro_agents.learning.loading import shipped
from hydro_env import HydroError, TaskConfig
from hydro_rig.diagnosis.diagnose import Diagnosis, diagnose
from hydro_rig.diagnosis.verdict import Kind, Leak, Limits
from hydro_rig.estimation.estimator import WEAR
from hydro_rig.recordings.columns import own_map, read_map
from hydro_rig.recordings.files import read_columns
from hydro_rig.recordings.findings import Weight, lines_of
from hydro_rig.recordings.simulated import record_axis

TASK = TaskConfig(episode_duration=10.0)
LIMITS = Limits.of(TASK)
AXES = [(2, 0.01), (1, 0.3), (1, 0.01), (2, 0.3)]  # seed, leak in l/min at 100 bar
MOST_ADVICE = 3  # times that advice is followed on the way to an answer
REFUSED = "refused"  # as kind of an answer
OUTCOMES = ["traceback", "healthy called leaking", "leaking called healthy", "wrong cause", "wrong size", "cannot tell"]
WRONG = OUTCOMES[:5]


class Answer(NamedTuple):
    """What was answered."""

    kind: str  # of the verdict, or "refused", or "traceback"
    causes: frozenset[str] = frozenset()  # that the verdict names: signals, and unknowns of the estimator
    leak: Leak | None = None
    text: str = ""  # all that was said; advice stands there


def outcome(answer: Answer, truth: float, true: frozenset[str]) -> str:
    """Whether an answer is right.

    Args:
        answer: of the diagnosis.
        truth: l/min at 100 bar, the leak of the axis.
        true: causes that may be named.

    Returns one of :data:`OUTCOMES`, "refused" or "right". A leak has the wrong size if its whole interval is more than
    a fifth of the truth away; a verdict of another fault with a leak that is surely no fault calls the axis healthy.
    """
    leak, leaking = answer.leak, truth >= LIMITS.fault
    no_fault = answer.kind == Kind.HEALTHY or (
        answer.kind == Kind.OTHER and leak is not None and leak.high < LIMITS.fault
    )
    found = {
        "traceback": answer.kind == "traceback",
        "healthy called leaking": not leaking and answer.kind == Kind.LEAK,
        "leaking called healthy": leaking and no_fault,
        "wrong cause": not answer.causes <= true or (answer.kind == Kind.OTHER and not answer.causes),
        "wrong size": answer.kind == Kind.LEAK
        and (leak is None or max(leak.low - truth, truth - leak.high) > 0.2 * truth),
        "cannot tell": answer.kind == Kind.UNKNOWN,
        REFUSED: answer.kind == REFUSED,
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


@cache
def head() -> LeakageHead:
    """The head of the command, read once in each process."""
    return load_head(None, TASK)


def answer_of(file: Path, columns: Path | None, window: float) -> Answer:
    """The answer of the command with a map and a length of windows in s."""
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            given = None if columns is None else read_map(columns)
            diagnosis = diagnose(file, TASK, head(), given, window)
    except HydroError as error:
        return Answer(REFUSED, text=str(error))
    except Exception:
        return Answer("traceback", text=traceback.format_exc()[-500:])
    verdict = diagnosis.verdict
    text = "\n".join([verdict.why, *lines_of(diagnosis.checked.findings)])
    return Answer(verdict.kind.value, causes_of(diagnosis), verdict.leak, text)


def followed(answer: Answer, columns: Mapping[str, Any], window: float) -> tuple[dict[str, Any], float, str]:
    """The map and the windows that an answer advises, and the advice in short; empty: it advises nothing else."""
    changed: dict[str, Any] = {name: dict(entry) for name, entry in columns.items()}
    advice = []
    if "time" in changed and (found := re.search(r"equidistant: ([\w.]+(?: m?s)?)\b", answer.text)):
        advice.append(found[0])
        changed["time"]["equidistant"] = yaml.safe_load(found[1])
    for line in answer.text.split("\n"):
        signals = [name for name in changed if re.match(rf"{name}\b", line)]
        signals = ["pressure_a", "pressure_b"] if line.startswith("pressures read") else signals
        if found := re.search(r"in (\S+)(?: or \S+)? instead of \S+ would fit", line):
            advice += [f"{signal} in {found[1]}" for signal in signals]
            for signal in signals:
                changed[signal]["unit"] = found[1]
        elif found := re.search(r"an offset of (\S+) \S+ would fit", line):
            advice += [f"{signal} + {found[1]}" for signal in signals]
            for signal in signals:
                changed[signal]["offset"] = float(found[1])
    if found := re.search(r"--window ([\d.]+)", answer.text):
        advice.append(found[0])
        window = float(found[1])
    return changed, window, ", ".join(sorted(set(advice)))


def rows_of(case: int, folder: Path) -> Iterator[dict[str, Any]]:
    """One row for a recording as it is, and one more each time that new advice is followed."""
    (seed, leak), ways = AXES[case % len(AXES)], list(manglings().items())
    name, mangling = ways[case // len(AXES)]
    recording, place = folder / f"axis_{seed}_{leak:g}.csv", folder / f"map_{case}.yaml"
    file = folder / f"mangled_{case}.{mangling.ending}"
    file.write_bytes(mangling.write(mangling.change(pd.read_csv(recording, comment="#"))))
    columns: dict[str, Any] | None = None
    window, advice, taken = 2.0, "", []
    for _ in range(1 + MOST_ADVICE):
        answer = answer_of(file, None if columns is None else place, window)
        row = {"case": case, "axis": seed, "leak": leak, "kind": mangling.kind, "mangling": name, "advice": advice}
        row |= {"outcome": outcome(answer, leak, mangling.true), "causes": " ".join(sorted(answer.causes))}
        row["verdict"] = f"{answer.kind}: {' '.join(answer.text.split())[:400]}"
        yield row | (answer.leak._asdict() if answer.leak is not None else {})
        if columns is None and answer.kind != "traceback":
            with contextlib.suppress(HydroError):
                given = own_map(read_columns(file).headings, str(file))
                columns = {signal: {"column": column.column} for signal, column in given.columns().items()}
        columns, window, advice = followed(answer, columns or {}, window)
        taken.append(advice)
        if not advice or advice in taken[:-1]:
            break
        place.write_text(yaml.safe_dump(columns, allow_unicode=True))


def main() -> None:
    """Diagnose all mangled recordings; print tables by kind, and the cases with a wrong answer."""
    given = command_line(__doc__, "folder", jobs=1)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed, leak in AXES:
        record_axis(given.folder / f"axis_{seed}_{leak:g}.csv", TASK, shipped("pid", TASK), seed, leak)
    cases = range(len(AXES) * len(manglings()))
    table = kept_rows(given.folder / "cases.csv", "case", cases, partial(rows_of, folder=given.folder), given.jobs)
    table["advice"] = table["advice"].fillna("")
    for title, part in (("as it is", table[table.advice == ""]), ("advice followed", table[table.advice != ""])):
        if len(part):
            counts = pd.crosstab(part.kind, part.outcome, rownames=["kind"], colnames=[title], margins=True)
            names = [name for name in ["right", REFUSED, *OUTCOMES[::-1], "All"] if name in counts]
            print(counts[names].to_string(), end="\n\n")
    wrong = table[table.outcome.isin(WRONG)]
    print(f"{len(wrong)} wrong answers")
    for row in wrong.itertuples():
        print(f"{row.outcome}: axis {row.axis}, {row.leak:g} l/min, {row.mangling} ({row.advice}): {row.verdict[:160]}")


if __name__ == "__main__":
    main()
