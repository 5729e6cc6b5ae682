"""What ``hydro diagnose`` answers on 236 recordings that are mangled as maintenance people export them.

Run: python benchmarks/hostile_inputs.py FOLDER [--jobs 1]

Each way to mangle says what of it is true of the axis, so that a verdict may name it: a sensor that sticks really
sticks. Only what no reading can tell apart is true as well: a position that reads 5 % too much looks like a larger
valve. ``cases.csv`` in the folder holds every case; those in it are left out.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import traceback
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmarks import command_line
from benchmarks.kept_rows import kept_rows
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import load_head
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
REFUSED = "refused"  # as kind of an answer
OUTCOMES = ["traceback", "healthy called leaking", "leaking called healthy", "wrong cause", "wrong size", "cannot tell"]
WRONG = OUTCOMES[:5]

Change = Callable[[pd.DataFrame], pd.DataFrame]
Values = Callable[[Any], Any]  # of the values of a column
Write = Callable[[pd.DataFrame], bytes]

COLUMNS = ["time [s]", "position [mm]", "pressure_a [bar]", "pressure_b [bar]", "spool_position [%]", "command [V]"]
TIME, POSITION, A, B, SPOOL, COMMAND = COLUMNS
PRESSURES = [A, B]
HALF_STROKE, DAY = 200.0, 86400.0  # mm, s
START = datetime(2026, 3, 1, 8)
GERMAN = ["Zeit [s]", "Weg [mm]", "Druck A [bar]", "Druck B [bar]", "Ventilschieber [%]", "Stellgröße [V]"]


def csv(sep: str = ",", decimal: str = ".", encoding: str = "utf-8", text: Callable[[str], str] = str) -> Write:
    """A writer of CSV; ``text`` is what is done to its text."""
    return lambda table: text(table.to_csv(index=False, sep=sep, decimal=decimal, lineterminator="\n")).encode(encoding)


class Mangling(NamedTuple):
    """One way to mangle a recording."""

    kind: str
    change: Change = pd.DataFrame.copy
    write: Write = csv()
    true: frozenset[str] = frozenset()  # causes that a verdict may name: signals, and unknowns of the estimator
    ending: str = "csv"


def on(names: str | Sequence[str], function: Values) -> Change:
    """Apply a function to the values of some columns."""
    listed = [names] if isinstance(names, str) else names
    return lambda table: table.assign(**{name: function(table[name]) for name in listed})


def renamed(names: Mapping[str, str], function: Values | None = None) -> Change:
    """Other headings; the function changes the values of the first."""
    changed = on(next(iter(names)), function or (lambda values: values))
    return lambda table: changed(table).rename(columns=names)


def dated(pattern: str, step: float = 0.001, pause: float = 0.0) -> Change:
    """Dates and times, cut to steps in s, with a pause in the middle; MS are milliseconds."""

    def texts(time: pd.Series) -> list[str]:
        seconds = np.floor(time.to_numpy() / step + 1e-6) * step
        stamps = [START + timedelta(seconds=float(second) + 1e-7) for second in seconds]
        return [one.strftime(pattern).replace("MS", f"{one.microsecond // 1000:03d}") for one in stamps]

    return lambda table: renamed({TIME: "time"}, texts)(paused(pause)(table))


def paused(pause: float) -> Change:
    """The stamps of the second half of the rows are later by a pause in s."""
    return on(TIME, lambda time: time + pause * (np.arange(len(time)) >= 0.5 * len(time)))


def moved(names: str | Sequence[str], rows: int) -> Change:
    """Columns whose values stand some rows late."""
    return on(names, lambda values: values.shift(rows).bfill().ffill())


def sometimes(share: float, function: Values) -> Values:
    """Change a share of the readings at random places."""
    return lambda values: values.mask(np.random.default_rng(2).random(len(values)) < share, function(values))


def rows(function: Callable[[pd.DataFrame], Any]) -> Change:
    """Some rows in some order, given by their numbers or as a mask."""
    return lambda table: table.iloc[np.asarray(function(table))]


def set_point(table: pd.DataFrame) -> pd.DataFrame:
    """The wanted position as command: 10 V are half a stroke."""
    wanted = table[POSITION].rolling(9, center=True, min_periods=1).mean().shift(-8).ffill()
    return table.assign(**{COMMAND: 10.0 / HALF_STROKE * wanted})


def quoted_commas(text: str) -> str:
    """Decimal commas in cells with quotes."""
    return ('"' + text.replace(",", '","').replace("\n", '"\n"').replace(".", ",")).removesuffix('"')


CHANGES: dict[str, dict[str, Change]] = {
    "stamps": {
        "whole seconds, German dates": dated("%d.%m.%Y %H:%M:%S", 1.0),
        "whole seconds, numbers": on(TIME, lambda time: np.floor(time + 1e-6)),
        "all stamps equal": on(TIME, lambda time: 0.0 * time),
        "US dates with PM": dated("%m/%d/%Y %I:%M:%S.MS %p"),
        "days of Excel": renamed({TIME: "time"}, lambda time: (46082 + time / DAY).round(10)),
        "number of the row": renamed({TIME: "time"}, lambda time: range(len(time))),
    },
    "clocks": {
        "stamps jitter by 4 ms": on(
            TIME, lambda time: np.sort(time + 4e-3 * np.random.default_rng(3).standard_normal(len(time))).round(6)
        ),
        "clock 5 % fast": on(TIME, lambda time: 1.05 * time),
        "newest row first": rows(lambda table: np.arange(len(table))[::-1]),
        "counter overflows at 4.096 s": on(TIME, lambda time: (time % 4.096).round(6)),
        "clock set back by 0.3 s": paused(-0.3),
        "pause of a minute": paused(60.0),
        "pause of a day": paused(DAY),
        "summer time ends": dated("%Y-%m-%dT%H:%M:%S.MS", pause=-3600.0),
    },
    "rows": {
        "row of means": lambda table: pd.concat([table, table.mean().to_frame().T.assign(**{TIME: 2000.0})]),
        "each row twice": rows(lambda table: np.repeat(np.arange(len(table)), 2)),
        "5 % of the rows lost": rows(lambda table: np.random.default_rng(4).random(len(table)) > 0.05),
        "a second of rows lost": rows(lambda table: np.delete(np.arange(len(table)), np.s_[900:1100])),
        "one row per reading": lambda table: table.melt(TIME, var_name="tag").sort_values(TIME, kind="stable"),
    },
    "units": {
        "position in cm, called mm": on(POSITION, lambda values: 0.1 * values),
        "pressures in MPa, called bar": on(PRESSURES, lambda values: 0.1 * values),
        "command in %, called V": on(COMMAND, lambda values: 10.0 * values),
        "spool in mA, called %": on(SPOOL, lambda values: 12.0 + 0.08 * values),
        "position from the end of the stroke": on(POSITION, lambda values: values + HALF_STROKE),
        "absolute pressures": on(PRESSURES, lambda bar: bar + 1.013),
    },
    "wiring": {
        "position reversed": on(POSITION, lambda values: -values),
        "spool reversed": on(SPOOL, lambda values: -values),
        "command reversed": on(COMMAND, lambda values: -values),
        "chambers exchanged": renamed({A: B, B: A}),
        "set point as command": set_point,
        "only the difference of pressures": lambda table: (
            table.assign(**{A: table[A] - table[B]}).drop(columns=B).rename(columns={A: "load_pressure [bar]"})
        ),
    },
    "resolution": {
        "pressures in steps of 1 bar": on(PRESSURES, lambda bar: bar.round()),
        "position in steps of 1 mm": on(POSITION, lambda mm: mm.round()),
    },
    "channels": {
        "pressures 5 rows late": moved(PRESSURES, 5),
        "position 2 rows late": moved(POSITION, 2),
        "command 3 rows early": moved(COMMAND, -3),
        "pressures in each 4th row, repeated": on(
            PRESSURES, lambda bar: bar.where(np.arange(len(bar)) % 4 == 0).ffill()
        ),
    },
    "columns": {
        "German headings": renamed(dict(zip(COLUMNS, GERMAN, strict=True))),
        "no spool position": lambda table: table.drop(columns=SPOOL),
    },
}
TEXTS: dict[str, Write] = {
    "semicolons and decimal commas": csv(";", ","),
    "UTF-16": csv("\t", encoding="utf-16"),
    "decimal commas in quotes": csv(text=quoted_commas),
    "six lines before": csv(text=lambda text: "Logger 7\nPlant: 3, hall 2\n\nRate: 200\nUnit: x\n\n" + text),
    "headings behind %": csv(text=lambda text: "% " + text.replace(" [", "[").replace(",", " ")),
    "truncated": csv(text=lambda text: text[: int(0.7 * len(text)) + 3]),
}
FAULTS: dict[str, dict[str, Values]] = {
    A: {
        "offset of 2 bar": lambda bar: bar + 2.0,
        "gain of 1.05": lambda bar: 1.05 * bar,
        "noise of 3 bar": lambda bar: bar + 3.0 * np.random.default_rng(1).standard_normal(len(bar)),
        "spikes": sometimes(0.01, lambda bar: bar + 100.0),
        "clipped": lambda bar: bar.clip(upper=bar.quantile(0.6)),
        "stuck": lambda values: values.iloc[0],
    },
    POSITION: {
        "offset of 5 mm": lambda mm: mm + 5.0,
        "gain of 1.05": lambda mm: 1.05 * mm,
        "spikes": sometimes(0.01, lambda mm: mm + 100.0),
        "stuck": lambda values: values.iloc[0],
    },
    SPOOL: {
        "offset of 2 %": lambda values: values + 2.0,
        "gain of 1.05": lambda values: 1.05 * values,
        "dead": lambda values: 0.0 * values,
    },
}
TRUE = {
    "absolute pressures": "pressure_a pressure_b supply.tank_pressure",
    "position: gain of 1.05": "position valve.rated_flow",
}
"""Causes that are true of a mangling, beside the signal of a fault."""


def manglings() -> dict[str, Mangling]:
    """All ways by name; with two healthy and two leaking axes they make 236 recordings."""
    found = {"compressed": Mangling("text", write=lambda table: gzip.compress(csv()(table)), ending="csv.gz")}
    found |= {name: Mangling("text", write=write) for name, write in TEXTS.items()}
    for kind, changes in CHANGES.items():
        for name, change in changes.items():
            found[name] = Mangling(kind, change, true=frozenset(TRUE.get(name, "").split()))
    for column, faults in FAULTS.items():
        signal = column.split(" ")[0]
        for what, fault in faults.items():
            true = TRUE.get(f"{signal}: {what}", signal)
            found[f"{signal}: {what}"] = Mangling("sensors", on(column, fault), true=frozenset(true.split()))
    return found


class Answer(NamedTuple):
    """What was answered."""

    kind: str  # of the verdict, or "refused", or "traceback"
    causes: frozenset[str] = frozenset()  # that the verdict names: signals, and unknowns of the estimator
    leak: Leak | None = None
    text: str = ""


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


def answer_of(file: Path) -> Answer:
    """The answer of the command."""
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            diagnosis = diagnose(file, TASK, head())
    except HydroError as error:
        return Answer(REFUSED, text=str(error))
    except Exception:
        return Answer("traceback", text=traceback.format_exc()[-500:])
    verdict = diagnosis.verdict
    return Answer(verdict.kind.value, causes_of(diagnosis), verdict.leak, verdict.why)


def rows_of(case: int, folder: Path) -> list[dict[str, Any]]:
    """The row of a case."""
    (seed, leak), ways = AXES[case % len(AXES)], list(manglings().items())
    name, mangling = ways[case // len(AXES)]
    file = folder / f"mangled_{case}.{mangling.ending}"
    file.write_bytes(mangling.write(mangling.change(pd.read_csv(folder / f"axis_{seed}_{leak:g}.csv", comment="#"))))
    answer = answer_of(file)
    row = {"case": case, "axis": seed, "leak": leak, "kind": mangling.kind, "mangling": name}
    row |= {"outcome": outcome(answer, leak, mangling.true), "causes": " ".join(sorted(answer.causes))}
    row["verdict"] = f"{answer.kind}: {' '.join(answer.text.split())[:400]}"
    return [row | (answer.leak._asdict() if answer.leak is not None else {})]


def main() -> None:
    """Diagnose all mangled recordings; print a table by kind, and the cases with a wrong answer."""
    given = command_line(__doc__, "folder", jobs=1)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed, leak in AXES:
        record_axis(given.folder / f"axis_{seed}_{leak:g}.csv", TASK, shipped("pid", TASK), seed, leak)
    cases = range(len(AXES) * len(manglings()))
    table = kept_rows(given.folder / "cases.csv", "case", cases, partial(rows_of, folder=given.folder), given.jobs)
    counts = pd.crosstab(table.kind, table.outcome, margins=True)
    names = [name for name in ["right", REFUSED, *OUTCOMES[::-1], "All"] if name in counts]
    print(counts[names].to_string(), end="\n\n")
    wrong = table[table.outcome.isin(WRONG)]
    print(f"{len(wrong)} wrong answers")
    for row in wrong.itertuples():
        print(f"{row.outcome}: axis {row.axis}, {row.leak:g} l/min, {row.mangling}: {row.verdict[:160]}")


if __name__ == "__main__":
    main()
