"""The heat map controller x condition: ratios of errors as text, on colours that diverge around 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.report.findings import interval_text
from hydro_agents.report.palette import STRONGEST
from hydro_agents.report.robustness_record import ALL, Record, interval
from hydro_agents.report.text import family_name, number

FULL_COLOUR = 2.0
"""A ratio of 2 or 1/2 has the strongest colour."""

SCALE = (0.5, 0.75, 1.0, 1.4, 2.0)
"""Ratios of the legend."""

GROUPS = {
    "leak": "Leak past the piston",
    "leak_law": "Law of the leak",
    "schedule": "Leak that changes during the run",
    "supply_and_load": "Supply and load",
    "timing": "Timing",
    "sensors": "Sensors",
    "force": "External force",
    "rig": "Other rigs",
    "parameter": "Assumed parameters, one at a time",
}
"""Titles of the groups of conditions, in the order of the map."""

FOLDED = ("parameter",)
"""Groups that the page folds because they have many conditions."""


@dataclass(frozen=True)
class Cell:
    """One controller under one condition."""

    text: str
    title: str  # the interval, or the reason for a missing number
    meaning: str = ""  # better or worse, if certain
    share: int = 0  # percentage of the meaning's colour
    best: bool = False


@dataclass(frozen=True)
class Row:
    """One condition: its label, the error of the baseline, and a cell for each other controller."""

    label: str
    baseline: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Group:
    """Conditions that belong together."""

    title: str
    rows: tuple[Row, ...]
    folded: bool = False


def heat_map(record: Record, column: str = "equal_weight") -> list[Group]:
    """Groups of rows; ``column`` of the table ``comparison`` gives the values. None with one controller."""
    conditions, others = record.table("conditions"), record.names[1:]
    if conditions.empty or not others:
        return []
    groups = [Group("", (_row(record, ALL, "all conditions", column),))]
    if column == "equal_weight" and not record.table("families").empty:
        groups.append(Group("Kind of reference (mean errors, all leaks)", _family_rows(record)))
    known = [*GROUPS, *(name for name in conditions["group"].unique() if name not in GROUPS)]
    for group in known:
        names = [str(name) for name in conditions.loc[conditions["group"] == group, "condition"]]
        rows = tuple(_row(record, name, record.label(name), column) for name in names)
        if rows:
            groups.append(Group(GROUPS.get(group, str(group)), rows, group in FOLDED))
    return groups


def _row(record: Record, condition: str, label: str, column: str) -> Row:
    rows = {name: record.against(name, condition) for name in record.names[1:]}
    missing = {name: _reason(record, name, condition) for name in rows}
    return Row(label, _baseline_error(record, condition), _cells(rows, column, missing))


def _family_rows(record: Record) -> tuple[Row, ...]:
    table = record.table("families")
    found = []
    for family in [str(name) for name in table["family"].unique() if name != ALL]:
        part = table[table["family"] == family].set_index("controller")
        rows: dict[str, dict[str, Any]] = {
            name: part.loc[name].to_dict() if name in part.index else {} for name in record.names[1:]
        }
        found.append(Row(family_name(family), "", _cells(rows, "ratio", {})))
    return tuple(found)


def _cells(rows: dict[str, dict[str, Any]], column: str, missing: dict[str, str]) -> tuple[Cell, ...]:
    values = {name: float(row.get(column, np.nan)) for name, row in rows.items()}
    finite = [value for value in values.values() if np.isfinite(value)]
    least = min(finite) if finite else np.nan
    cells = []
    for name, row in rows.items():
        value = interval(row, column)
        if not np.isfinite(value.value):
            reason = missing.get(name, "")
            cells.append(Cell("failed" if reason.startswith("failed") else "–", reason or "did not run"))
            continue
        certain = value.low > 1.0 or value.high < 1.0
        cells.append(
            Cell(
                number(value.value, 2),
                interval_text(value, decimals=2),
                "" if not certain else "better" if value.value < 1.0 else "worse",
                colour_share(value.value) if certain else 0,
                value.value == least and least < 1.0,
            )
        )
    return tuple(cells)


def _reason(record: Record, controller: str, condition: str) -> str:
    """The reason for a controller's missing number under a condition, over all its training seeds."""
    status = record.table("status")
    if status.empty or condition == ALL:
        return ""
    own = status[(status["condition"] == condition) & (status["controller"].str.partition("#")[0] == controller)]
    return "; ".join(f"{row['status']}: {row['message']}" for row in own.to_dict("records") if row["status"] != "done")


def _baseline_error(record: Record, condition: str) -> str:
    summary: pd.DataFrame = record.table("summary")
    own = summary[
        (summary["controller"] == record.baseline)
        & (summary["condition"] == condition)
        & (summary["metric"] == "mean_error_mm")
    ]
    return number(float(own["mean"].iloc[0])) if len(own) else "–"


def colour_share(ratio: float) -> int:
    """Percentage of the colour of a ratio: 0 at 1, and symmetric in the logarithm of the ratio."""
    share = abs(float(np.log(max(ratio, 1e-9)))) / float(np.log(FULL_COLOUR))
    return round(STRONGEST * min(share, 1.0))
