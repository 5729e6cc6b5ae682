"""Content of the page: the tables of the protocol, and short texts for their conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.report.canvas import Look, looks_of
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import setting


@dataclass(frozen=True)
class Record:
    """Tables by the name of their CSV file; the page omits the section of a missing or empty table."""

    tables: Mapping[str, pd.DataFrame]
    base: str  # the condition with all leak sizes

    def table(self, name: str) -> pd.DataFrame:
        """A table, empty if there is none."""
        return self.tables.get(name, pd.DataFrame())

    @property
    def detectors(self) -> list[str]:
        """Detectors with readings."""
        return [str(name) for name in self.table("detection")["detector"].unique()]

    @property
    def looks(self) -> dict[str, Look]:
        """Colour and marker of each detector in all pictures."""
        return looks_of(self.detectors)

    def facts(self) -> dict[str, str]:
        """Keys and values of the protocol: file, hash, versions, date, command."""
        table = self.table("protocol")
        return {} if table.empty else dict(zip(table["key"].astype(str), table["value"].astype(str), strict=True))

    @property
    def conditions(self) -> pd.DataFrame:
        """One row per condition, by its name."""
        return self.table("conditions").set_index("condition")

    def label(self, condition: str) -> str:
        """Short text of a condition."""
        return str(self.conditions["label"].get(condition, condition))

    def in_groups(self, *groups: str) -> list[str]:
        """Names of the conditions of some groups, in order of the protocol."""
        table = self.table("conditions")
        return [str(name) for name in table.loc[table["group"].isin(groups), "condition"]]

    def masking(self) -> pd.DataFrame:
        """Rows of the table ``masking`` for windows of the same length as in the base condition."""
        table, durations = self.table("masking"), self.conditions["duration_s"]
        return table if table.empty else table[table["condition"].map(durations) == durations[self.base]]

    def cell(self, table: str, detector: str, condition: str, level: float) -> dict[str, float]:
        """One row of a table by detector, condition and level; empty if there is none."""
        rows = self.table(table)
        if rows.empty:
            return {}
        found = rows[(rows["detector"] == detector) & (rows["condition"] == condition) & (rows["level"] == level)]
        return {} if found.empty else {str(key): value for key, value in found.iloc[0].to_dict().items()}

    def share(self, detector: str, condition: str, level: float, column: str = "flagged") -> Interval:
        """A share of the table ``detection`` in percent, with its interval; NaN if there is none."""
        return percent_of(self.cell("detection", detector, condition, level), column)


def percent_of(row: Mapping[str, float], column: str) -> Interval:
    """A share and its interval in percent from a row of a table; NaN if there is none."""
    return Interval(*(100.0 * float(row.get(column + end, np.nan)) for end in ("", "_low", "_high")))


def level_text(level: float) -> str:
    """A leak level as text."""
    return "healthy" if level == HEALTHY else f"{setting(level)} l/min" if level > 0.0 else "drawn"
