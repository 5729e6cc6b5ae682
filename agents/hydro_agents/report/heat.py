"""The heat map of controllers and conditions: ratios of errors as text, on colours that diverge around 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hydro_agents.report.content import ALL, Content, interval, interval_text
from hydro_agents.report.palette import STRONGEST
from hydro_agents.report.sections import Block, Fold
from hydro_agents.running.text import Cell, Table, family_name, number, setting

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

Row = tuple[str | Cell, ...]


def heat_map(content: Content, caption: str, column: str) -> list[Block]:
    """The map of a column of the table ``comparison``: label, error of the baseline, and a cell per controller."""
    conditions = content.table("conditions")
    groups: dict[str, list[Row]] = {"": [_row(content, ALL, "all conditions", column)]}
    if column == "equal_weight" and content.has("families"):
        groups["Kind of reference (mean errors, all leaks)"] = _family_rows(content)
    folded: dict[str, list[Row]] = {}
    for group in [*GROUPS, *(name for name in conditions["group"].unique() if name not in GROUPS)]:
        rows = [_row(content, name, content.label(name), column) for name in content.in_groups(group)]
        if rows:
            (folded if group in FOLDED else groups)[GROUPS.get(group, str(group))] = rows
    header = ("Condition", f"{content.baseline}, mm", *content.controllers[1:])
    breaks: dict[int, str] = {}
    shown: list[Row] = []
    for title, rows in groups.items():
        if title:
            breaks[len(shown)] = title
        shown += rows
    blocks: list[Block] = [Table(caption, header, shown, style="heat", folded=False, breaks=breaks)]
    for title, rows in folded.items():
        count = "1 condition" if len(rows) == 1 else f"{len(rows)} conditions"
        blocks.append(Fold(f"{title} ({count})", [Table("", header, rows, style="heat")]))
    return blocks


def legend() -> list[Cell]:
    """Colours of some ratios."""
    return [Cell(setting(ratio), "better" if ratio < 1.0 else "worse", colour_share(ratio)) for ratio in SCALE]


def _row(content: Content, condition: str, label: str, column: str) -> Row:
    rows = {name: content.against(name, condition) for name in content.controllers[1:]}
    missing = {name: _reason(content, name, condition) for name in rows}
    error = content.row("summary", controller=content.baseline, condition=condition, metric="mean_error_mm")
    return label, number(float(error.get("mean", np.nan))), *_cells(rows, column, missing)


def _family_rows(content: Content) -> list[Row]:
    found: list[Row] = []
    for family in [str(name) for name in content.table("families")["family"].unique() if name != ALL]:
        rows = {name: content.row("families", family=family, controller=name) for name in content.controllers[1:]}
        found.append((family_name(family), "", *_cells(rows, "ratio", {})))
    return found


def _cells(rows: Mapping[str, Mapping[str, Any]], column: str, missing: Mapping[str, str]) -> list[Cell]:
    """A cell for each controller; it has a colour only if its whole interval is on one side of 1."""
    values = {name: interval(row, column) for name, row in rows.items()}
    least = min((value.value for value in values.values() if np.isfinite(value.value)), default=np.nan)
    cells = []
    for name, value in values.items():
        if not np.isfinite(value.value):
            reason = missing.get(name, "")
            text = "failed" if reason.startswith("failed") else "–"
            cells.append(Cell(text, title=reason or "did not run"))
            continue
        certain = value.low > 1.0 or value.high < 1.0
        meaning = "" if not certain else "better" if value.value < 1.0 else "worse"
        share = colour_share(value.value) if certain else 0
        best = value.value == least < 1.0
        cells.append(Cell(number(value.value, 2), meaning, share, interval_text(value, decimals=2), best))
    return cells


def _reason(content: Content, controller: str, condition: str) -> str:
    """The reason for a controller's missing number under a condition, over all its training seeds."""
    status = content.table("status")
    if status.empty or condition == ALL:
        return ""
    own = status[(status["condition"] == condition) & (status["controller"].str.partition("#")[0] == controller)]
    return "; ".join(f"{row['status']}: {row['message']}" for row in own.to_dict("records") if row["status"] != "done")


def colour_share(ratio: float) -> int:
    """Percentage of the colour of a ratio: 0 at 1, and symmetric in the logarithm of the ratio."""
    share = abs(float(np.log(max(ratio, 1e-9)))) / float(np.log(FULL_COLOUR))
    return round(STRONGEST * min(share, 1.0))
