"""Content of the page: the tables of the protocol and of the experiments, and traces of the worst cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pandas as pd

from hydro_agents.report.report import Example
from hydro_agents.report.text import correction_name
from hydro_agents.running.statistics import Interval

ALL = "all"
"""Name of the row over all conditions."""

NAME_COLUMNS = ("controller", "against", "value")
"""Columns that hold names of controllers; ``value`` is that of the facts, one of which is the baseline."""


@dataclass(frozen=True)
class Trace:
    """One of the worst cases of a controller, with its rival on the same case."""

    controller: str
    rival: str
    ratio: float  # error over that of the rival
    example: Example

    def renamed(self, names: Mapping[str, str]) -> Trace:
        """The case with new names of controllers."""
        controller, rival = (names.get(name, name) for name in (self.controller, self.rival))
        title = self.example.title.replace(f" of {self.controller}:", f" of {controller}:")
        title = title.replace(f"error of {self.rival} ", f"error of {rival} ")
        return replace(
            self, controller=controller, rival=rival, example=replace(self.example.renamed(names), title=title)
        )


@dataclass(frozen=True)
class Record:
    """Tables by the name of their CSV file; the page omits the section of a missing or empty table."""

    tables: Mapping[str, pd.DataFrame]
    traces: Sequence[Trace] = ()
    errors: Mapping[str, str] = field(default_factory=dict)  # controller → reason for missing experiments

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
        """The controller to which the others are compared."""
        return self.names[0]

    def facts(self) -> dict[str, str]:
        """Keys and values of the protocol: file, hash, versions, date, command."""
        table = self.table("protocol")
        return {} if table.empty else dict(zip(table["key"].astype(str), table["value"].astype(str), strict=True))

    def corrects(self) -> dict[str, str]:
        """Controllers that correct another one, and its name."""
        table = self.table("sees")
        notes = {} if table.empty else dict(zip(table["controller"], table["note"].fillna(""), strict=True))
        start = "corrects "
        return {str(name): str(note).removeprefix(start) for name, note in notes.items() if str(note).startswith(start)}

    def with_full_names(self) -> Record:
        """The same with names that tell what a policy corrects: "PPO on flow linearisation" instead of "PPO"."""
        names = {name: correction_name(name, base) for name, base in self.corrects().items()}
        tables = {
            key: table.assign(**{c: table[c].replace(names) for c in NAME_COLUMNS if c in table})
            for key, table in self.tables.items()
        }
        traces = [trace.renamed(names) for trace in self.traces]
        return replace(self, tables=tables, traces=traces)

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
    """A column with its interval (``_low``, ``_high``); NaN if there is none."""
    missing = float("nan")
    value, low, high = (float(row.get(column + end, missing)) for end in ("", "_low", "_high"))
    return Interval(value, low, high)
