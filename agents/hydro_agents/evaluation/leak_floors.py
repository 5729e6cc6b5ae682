"""The project's required figures beside the measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.leak_protocol import HEALTHY, LeakProtocol
from hydro_agents.running.statistics import Interval

if TYPE_CHECKING:
    from hydro_agents.evaluation.leak_tables import LeakTables

FAULT_GROUPS = ("fault", "plant")
"""Groups of conditions whose healthy axes must raise no false alarms."""

COVERAGE = (0.87, 0.93)
"""Required coverage of 90 % intervals."""

FEWEST = 20
"""Smallest number of windows for judging the coverage of a cell."""


class Floor(NamedTuple):
    """One figure with its limits: the floor must be reached, the aim should be."""

    figure: str
    detector: str
    unit: str
    before: float  # when the floor was set
    floor: float
    aim: float
    value: Interval
    note: str = ""
    high_is_good: bool = False


MISSING = Interval(np.nan, np.nan, np.nan)


def floors_table(tables: LeakTables, protocol: LeakProtocol) -> pd.DataFrame:
    """One row per measured figure: value with interval, floor, aim, and which of the two it reaches."""
    floors: list[Floor] = []
    for name, choice in protocol.detectors.items():
        measured = set(tables.detection["detector"]) if len(tables.detection) else set()
        if name not in measured:
            continue
        find = _Finder(tables, protocol, name)
        if ":" in choice.kind:
            continue  # floors and aims are those of the project's own detectors
        floors += find.estimator(bool(choice.task)) if choice.kind == "estimator" else find.head()
        floors += find.shared()
    floors += _alarm_floors(tables.alarms)
    rows = []
    for each in floors:
        if np.isnan(each.value.value):
            continue
        reached = [
            each.value.value >= limit if each.high_is_good else each.value.value <= limit
            for limit in (each.floor, each.aim)
        ]
        verdict = "aim" if reached[1] else "floor" if reached[0] else "below the floor"
        if np.isnan(each.aim):
            verdict = "floor" if reached[0] else "below the floor"
        rows.append(
            {"figure": each.figure, "detector": each.detector, "unit": each.unit, "before": each.before}
            | {"floor": each.floor, "aim": each.aim, "measured": each.value.value, "low": each.value.low}
            | {"high": each.value.high, "reaches": verdict, "note": each.note}
        )
    columns = ["figure", "detector", "unit", "before", "floor", "aim", "measured", "low", "high", "reaches", "note"]
    return pd.DataFrame(rows, columns=columns)


def _alarm_floors(alarms: pd.DataFrame) -> list[Floor]:
    """Delays and misses at one false alarm per 100 h."""
    limits = {1.0: (4.0, 2.0), 0.3: (8.0, 4.0), 0.1: (30.0, 10.0)}
    rows = []
    for entry in alarms.to_dict("records"):
        detector, level = str(entry["detector"]), float(entry["leak_lpm"])
        if level == HEALTHY:
            found = Interval(entry["per_100_h"], entry["per_100_h_low"], entry["per_100_h_high"])
            note = f"alarms: {entry['alarms']:g} in {entry['hours']:.0f} h"
            rows.append(Floor("false alarms of the alarm stage", detector, "per 100 h", 1500.0, 1.0, 1.0, found, note))
        elif level in limits and entry["then"] == "all":
            floor, aim = limits[level]
            what = f"alarm: {level:g} l/min"
            median = Interval(entry["median_s"], np.nan, np.nan)
            missed = Interval(*(100.0 * entry[name] for name in ("missed", "missed_low", "missed_high")))
            rows.append(Floor(f"{what}, median delay", detector, "s", np.nan, floor, aim, median))
            rows.append(Floor(f"{what}, missed after a minute", detector, "%", np.nan, 5.0, 1.0, missed))
    return rows


class _Finder:
    """Takes the figures of one detector from the tables."""

    def __init__(self, tables: LeakTables, protocol: LeakProtocol, detector: str) -> None:
        self.tables, self.protocol, self.detector = tables, protocol, detector

    def _rows(self, table: pd.DataFrame, condition: str | None = None, level: float | None = None) -> pd.DataFrame:
        rows = table[table["detector"] == self.detector]
        if condition is not None:
            rows = rows[rows["condition"] == condition]
        return rows if level is None else rows[rows["level"] == level]

    def _percent(self, condition: str, level: float, column: str = "at_1_percent") -> Interval:
        rows = self._rows(self.tables.detection, condition, level)
        if rows.empty:
            return MISSING
        return Interval(*(100.0 * float(rows.iloc[0][column + end]) for end in ("", "_low", "_high")))

    def _worst(self, conditions: Sequence[str]) -> tuple[Interval, str]:
        """The highest share of false alarms on healthy axes, and its condition."""
        found = {name: self._percent(name, HEALTHY, "flagged") for name in conditions}
        found = {name: value for name, value in found.items() if not np.isnan(value.value)}
        if not found:
            return MISSING, ""
        worst = max(found, key=lambda name: found[name].value)
        return found[worst], self.protocol.conditions[worst].label or worst

    def _large(self, column: str) -> float:
        """Mean of a column of the sizes over levels from 0.3 l/min, base condition; of squares for errors."""
        rows = self._rows(self.tables.sizes, self.protocol.base)
        values = rows.loc[rows["level"] >= 0.3, column].to_numpy(dtype=np.float64)
        return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else np.nan

    def _seconds(self, what: str) -> Interval:
        timings = self.tables.timings
        rows = timings[(timings["detector"] == self.detector) & (timings["what"] == what)] if len(timings) else timings
        return Interval(float(rows.iloc[0]["seconds"]), np.nan, np.nan) if len(rows) else MISSING

    def _detection(self, limits: dict[float, tuple[float, float, float]]) -> list[Floor]:
        base = self.protocol.base
        return [
            Floor(
                f"{level:g} l/min found at 1 % false alarms",
                self.detector,
                "%",
                *marks,
                self._percent(base, level),
                high_is_good=True,
            )
            for level, marks in limits.items()
        ]

    def estimator(self, more_unknowns: bool) -> list[Floor]:
        """Figures of an estimator; ``more_unknowns``: also faults of the valve are unknown."""
        name, nan = self.detector, np.nan
        limit, factor = (0.04, 2.0) if more_unknowns else (0.02, 1.5)
        size, bound = self._large("rms_log10"), self._large("bound_rms_log10")
        note = f"{size / bound:.1f} times the bound" if np.isfinite(bound) else ""
        error = Interval(size, nan, nan)
        floors = [] if more_unknowns else self._detection({0.05: (nan, 80.0, 97.0), 0.1: (nan, 95.0, 99.0)})
        floors.append(Floor("size error from 0.3 l/min", name, "RMS log10", nan, limit, factor * bound, error, note))
        if more_unknowns:
            return floors
        rows = self._rows(self.tables.sizes, self.protocol.base)
        told = rows["told"].to_numpy(dtype=np.float64)
        if told.sum() > 0.0:
            unnoticed = Interval(100.0 * float(np.nansum(rows["unnoticed_minimum"] * told) / told.sum()), nan, nan)
            floors.append(Floor("local minima that χ² does not tell", name, "%", nan, 2.0, 0.2, unnoticed))
        floors.append(Floor("one window on one core", name, "s", 0.34, 0.5, 0.1, self._seconds("window")))
        return floors

    def head(self) -> list[Floor]:
        """Figures of the leakage head."""
        name = self.detector
        floors = self._detection({0.1: (45.0, 60.0, 85.0), 0.2: (94.0, 97.0, 99.0), 0.3: (99.0, 99.5, 99.9)})
        for condition, marks in {
            "running": (94.0, 98.0, 99.5),
            "standing": (1.0, 85.0, 95.0),
            "by_hand": (82.0, 93.0, 98.0),
        }.items():
            found, false = (self._percent(condition, level, "flagged") for level in (0.3, HEALTHY))
            label = self.protocol.conditions[condition].label if condition in self.protocol.conditions else condition
            note = f"false alarms {false.value:.1f} %, at most 2 % allowed"
            floors.append(Floor(f"0.3 l/min found: {label}", name, "%", *marks, found, note, True))
        update = self._seconds("update")
        floors.append(Floor("one update", name, "ms", 0.34, 0.2, 0.05, Interval(*(1e3 * part for part in update))))
        return floors

    def shared(self) -> list[Floor]:
        """Figures of any detector: false alarms where it was not trained, confusions, coverage."""
        conditions = self.protocol.conditions
        unseen = [name for name, each in conditions.items() if not ACTING[each.acting].trained]
        value, where = self._worst(unseen)
        floors = [Floor("false alarms, worst unseen controller", self.detector, "%", 48.0, 5.0, 2.0, value, where)]
        wrong = [name for name, each in conditions.items() if each.group in FAULT_GROUPS]
        value, where = self._worst(wrong)
        floors.append(Floor("worst fault taken for a seal leak", self.detector, "%", 83.0, 10.0, 2.0, value, where))
        rows = self._rows(self.tables.sizes)
        rows = rows[(rows["level"] != HEALTHY) & (rows["coverage"].notna()) & (rows["told"] >= FEWEST)]
        if len(rows):
            # A value within the interval counts as reached: the number of windows is finite.
            good = (rows["coverage_low"] <= COVERAGE[1]) & (rows["coverage_high"] >= COVERAGE[0])
            worst: dict[Any, Any] = rows.loc[rows["coverage"].idxmin()].to_dict()
            label = conditions[worst["condition"]].label or worst["condition"]
            note = f"worst: {100.0 * worst['coverage']:.0f} % at {worst['level']:g} l/min, {label}"
            share = Interval(100.0 * float(good.mean()), np.nan, np.nan)
            floors.append(
                Floor(
                    "90 % intervals: cells that hold 87–93 %",
                    self.detector,
                    "%",
                    np.nan,
                    100.0,
                    100.0,
                    share,
                    note,
                    True,
                )
            )
        return floors
