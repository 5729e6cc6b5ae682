"""Content of a page: tables by the names of their CSV files, what else a page shows, and names for readers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pandas as pd

from hydro_agents.report.palette import Look, looks_of
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import decimals_for, number
from hydro_env import TaskConfig

if TYPE_CHECKING:
    from hydro_agents.evaluation.detection import LeakBounds

Kind = TypeVar("Kind")

ALL = "all"
"""Name of the row over all conditions."""


@dataclass(frozen=True)
class Content:
    """What the sections of a page show.

    Example:
        >>> content = Content({"cases": pd.DataFrame({"controller": ["PID", "PPO"], "mean_error_mm": [0.5, 0.4]})})
        >>> content.controllers, content.baseline, content.has("ratios")
        (['PID', 'PPO'], 'PID', False)
    """

    tables: Mapping[str, pd.DataFrame]  # by the names of their CSV files
    task: TaskConfig = field(default_factory=TaskConfig)
    others: Mapping[str, Any] = field(default_factory=dict)  # by name: traces, errors, the text of a configuration

    def has(self, name: str) -> bool:
        """Whether there is a table or another part of this name that is not empty."""
        part = self.tables.get(name, self.others.get(name))
        return part is not None and (not hasattr(part, "__len__") or len(part) > 0)

    def table(self, name: str) -> pd.DataFrame:
        """A table, empty if there is none."""
        return self.tables.get(name, pd.DataFrame())

    def part(self, name: str, kind: type[Kind]) -> Kind:
        """A part that is no table, of a type; the page needs it."""
        part = self.others[name]
        assert isinstance(part, kind), f"{name} is a {type(part).__name__}"
        return part

    def other(self, name: str, default: Kind) -> Kind:
        """A part that is no table, of the type of ``default``, which stands for a missing one."""
        return self.part(name, type(default)) if name in self.others else default

    @cached_property
    def facts(self) -> dict[str, str]:
        """Keys and values of the run: title, baseline, file, hash, versions, date, command."""
        table = self.table("protocol")
        return {} if table.empty else dict(zip(table["key"].astype(str), table["value"].astype(str), strict=True))

    @property
    def bounds(self) -> LeakBounds:
        """Leaks that count as healthy and as faulty in the task."""
        from hydro_agents.evaluation.detection import LeakBounds  # of pages about leaks alone

        return self.other("bounds", LeakBounds.of(self.task))

    # Participants -----------------------------------------------------------------------------------------------------

    @cached_property
    def controllers(self) -> list[str]:
        """Controllers with results, the baseline first."""
        table = self.table("summary" if self.has("summary") else "cases")
        names = [] if table.empty else [str(name) for name in table["controller"].unique()]
        base = self.facts.get("baseline", names[0] if names else "")
        return [name for name in (base, *(other for other in names if other != base)) if name]

    @property
    def baseline(self) -> str:
        """The controller to which the others are compared."""
        return self.controllers[0]

    @cached_property
    def detectors(self) -> list[str]:
        """Detectors with readings."""
        return [str(name) for name in self.table("detection").get("detector", pd.Series(dtype=str)).unique()]

    @cached_property
    def looks(self) -> dict[Any, Look]:
        """Colour, marker and line of each controller, or of each detector, in all figures."""
        return looks_of(self.controllers or self.detectors)

    # Conditions -------------------------------------------------------------------------------------------------------

    @cached_property
    def conditions(self) -> pd.DataFrame:
        """One row per condition, by its name."""
        table = self.table("conditions")
        return table if table.empty else table.set_index("condition")

    @property
    def base(self) -> str:
        """The condition with all leaks: the first of the group ``levels``."""
        return str(self.other("base", "") or next(iter(self.in_groups("levels")), ""))

    def label(self, condition: str) -> str:
        """Short text of a condition."""
        labels = self.conditions.get("label", pd.Series(dtype=str)).fillna("")
        return str(labels.get(condition) or condition)

    def in_groups(self, *groups: str) -> list[str]:
        """Names of the conditions of some groups, in order of the protocol."""
        table = self.table("conditions")
        return [] if table.empty else [str(name) for name in table.loc[table["group"].isin(groups), "condition"]]

    # Rows -------------------------------------------------------------------------------------------------------------

    def rows(self, table: str, **wanted: Any) -> pd.DataFrame:
        """The rows of a table with some values in its columns."""
        rows = self.table(table)
        for column, value in wanted.items():
            rows = rows[rows[column] == value] if len(rows) else rows
        return rows

    def row(self, table: str, **wanted: Any) -> dict[str, Any]:
        """The first of :meth:`rows`; empty if there is none."""
        rows = self.rows(table, **wanted)
        return rows.iloc[0].to_dict() if len(rows) else {}

    def against(self, controller: str, condition: str = ALL) -> dict[str, Any]:
        """The row of the comparison with the baseline; empty if there is none."""
        group, value = (ALL, "") if condition == ALL else ("condition", condition)
        return self.row("comparison", controller=controller, against=self.baseline, group=group, value=value)


def interval(row: Mapping[Any, Any], column: str, factor: float = 1.0) -> Interval:
    """A column with its interval (``COLUMN_low``, ``COLUMN_high``; else ``low``, ``high``); NaN if there is none."""
    ends = (f"{column}_{end}" if f"{column}_{end}" in row else end for end in ("low", "high"))
    return Interval(*(factor * float(row.get(name, np.nan)) for name in (column, *ends)))


def intervals(table: pd.DataFrame, column: str, by: str | None = None, factor: float = 1.0) -> pd.DataFrame:
    """A column with its intervals, see :func:`interval`, as ``value``, ``low``, ``high``, over the column ``by``."""
    ends = (f"{column}_{end}" if f"{column}_{end}" in table else end for end in ("low", "high"))
    parts = (table if by is None else table.set_index(by))[[column, *ends]].astype(np.float64)
    return factor * parts.set_axis(["value", "low", "high"], axis=1)


def verdict(value: Interval) -> str:
    """'better' or 'worse' if the whole interval of a ratio is on one side of 1, else 'same'."""
    if value.high < 1.0:
        return "better"
    return "worse" if value.low > 1.0 else "same"


def interval_text(value: Interval, unit: str = "", decimals: int | None = None) -> str:
    """Value, unit, and interval in brackets if there is one."""
    places = decimals_for(value.value) if decimals is None else decimals
    middle, low, high = (number(part, places) for part in value)
    unit = f" {unit}" if unit else ""
    return f"{middle}{unit}" if np.isnan(value.low) else f"{middle}{unit} ({low} to {high})"


def shown(row: Mapping[Any, Any], column: str, decimals: int | None = None, factor: float = 1.0, unit: str = "") -> str:
    """A column with its interval as text; see :func:`interval` and :func:`interval_text`."""
    return interval_text(interval(row, column, factor), unit, decimals)
