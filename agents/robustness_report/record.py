"""What the page shows: the tables of the protocol and of the experiments, and traces of the worst cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from agents.evaluation.statistics import Interval
from agents.report.report import Example
from agents.report.text import family_name, number, setting
from agents.running.cases import Rollout

ALL = "all"
"""Name of the row over all conditions."""


@dataclass(frozen=True)
class Trace:
    """One of the worst cases of a controller, with the baseline on the same case."""

    controller: str
    seed: int
    ratio: float  # error over that of the baseline
    example: Example


@dataclass(frozen=True)
class Record:
    """Tables by the name of their CSV file; a table that is missing or empty leaves its section out."""

    tables: Mapping[str, pd.DataFrame]
    traces: Sequence[Trace] = ()
    errors: Mapping[str, str] = field(default_factory=dict)  # controller to the reason why experiments have no rows

    def table(self, name: str) -> pd.DataFrame:
        """A table, empty if there is none."""
        return self.tables.get(name, pd.DataFrame())

    @property
    def names(self) -> list[str]:
        """Controllers, the baseline first."""
        names = [str(name) for name in self.table("summary")["controller"].unique()]
        base = self.facts().get("baseline", names[0])
        return [base, *(name for name in names if name != base)]

    @property
    def baseline(self) -> str:
        """The controller against which the others are compared."""
        return self.names[0]

    def facts(self) -> dict[str, str]:
        """Keys and values of the protocol: file, hash, versions, date, command."""
        table = self.table("protocol")
        return {} if table.empty else dict(zip(table["key"].astype(str), table["value"].astype(str), strict=True))

    def label(self, condition: str) -> str:
        """Short text of a condition."""
        table = self.table("conditions")
        labels = {} if table.empty else dict(zip(table["condition"], table["label"].fillna(""), strict=True))
        return str(labels.get(condition) or condition)

    def against(self, controller: str, condition: str = ALL) -> dict[str, Any]:
        """The row of the comparison with the baseline; empty if there is none."""
        table = self.table("comparison")
        if table.empty:
            return {}
        rows = table[(table["controller"] == controller) & (table["condition"] == condition)].to_dict("records")
        return {str(key): value for key, value in rows[0].items()} if rows else {}


def interval(row: Mapping[str, Any], column: str) -> Interval:
    """A column with its interval (``_low``, ``_high``); NaN where there is none."""
    missing = float("nan")
    value, low, high = (float(row.get(column + end, missing)) for end in ("", "_low", "_high"))
    return Interval(value, low, high)


def worst_traces(
    replay: Callable[[Mapping[str, Any]], Rollout],
    worst_cases: pd.DataFrame,
    baseline: str,
    label: Callable[[str], str] = str,
    preview: float = 0.0,
    count: int = 2,
) -> list[Trace]:
    """Run the worst cases of every controller again, with the baseline beside it.

    Args:
        replay: runs one case; its argument is a row of ``worst_cases``.
        worst_cases: cases with the worst ratio of errors, by controller and rank.
        baseline: controller that runs on the same case, with training seed 0.
        label: text of a condition.
        preview: s; the observation shows the reference this far ahead, which matters at steps.
        count: number of cases per controller.
    """
    traces = []
    for name, frame in worst_cases.groupby("controller", sort=False):
        for row in frame.sort_values("rank").head(count).to_dict("records"):
            runs = {str(name): replay(row)}
            if name != baseline:
                runs[baseline] = replay({**row, "controller": baseline, "training_seed": 0})
            one = runs[str(name)]
            where = label(str(row["condition"]))
            leak = "" if "l/min" in where else f", leak of {setting(row['leakage_flow_lpm'])} l/min"
            title = (
                f"Worst case {row['rank']} of {name}: {number(float(row['ratio']))} times the error of {baseline} "
                f"({where}, {family_name(str(row['family']))}{leak}, seed {row['seed']})"
            )
            traces.append(
                Trace(
                    str(name),
                    int(row["seed"]),
                    float(row["ratio"]),
                    Example(
                        title=title,
                        time=one.time,
                        reference=one.reference[0],
                        position={who: run.position[0] for who, run in runs.items()},
                        command={who: run.command[0] for who, run in runs.items()},
                        preview=preview if row["family"] == "step" else 0.0,
                    ),
                )
            )
    return traces
