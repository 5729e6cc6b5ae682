"""The tables of the page as texts."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_agents.detection.detector import CAUSE_OF_FAULT, VERDICTS, Cause
from hydro_agents.evaluation.leak_protocol import DRAWN, HEALTHY
from hydro_agents.report.findings import interval_text
from hydro_agents.report.leak_record import Record, level_text, percent_of
from hydro_agents.report.palette import STRONGEST
from hydro_agents.report.text import Table, number, setting, unbroken


@dataclass(frozen=True)
class Cell:
    """One share of a confusion table."""

    text: str
    meaning: str  # better (correct), worse (wrong), or silent (cannot tell)
    share: int  # percentage of the meaning's colour


@dataclass(frozen=True)
class Confusion:
    """The confusion table of one detector at one leak level."""

    caption: str
    verdicts: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


def confusions(record: Record) -> list[Confusion]:
    """Verdicts of each detector for each fault, with a healthy and with a leaking seal."""
    table = record.table("verdicts")
    conditions = [record.base, *record.in_groups("fault", "plant", "rig")]
    found = []
    for detector in record.detectors:
        for level in sorted(level for level in table["level"].unique() if level in (HEALTHY, 0.3)):
            cells = {name: record.cell("verdicts", detector, name, level) for name in conditions}
            rows = tuple(
                (record.label(name), tuple(_cell(record, name, level, verdict, row[verdict]) for verdict in VERDICTS))
                for name, row in cells.items()
                if row
            )
            beside = "healthy seal" if level == HEALTHY else f"with a leak of {setting(level)} l/min"
            if len(rows) > 1:
                found.append(Confusion(f"{detector}: {beside}; share of windows, %", VERDICTS, rows))
    return found


def _cell(record: Record, condition: str, level: float, verdict: str, value: float) -> Cell:
    right = verdict in right_verdicts(record, condition, level)
    meaning = "better" if right else "silent" if verdict == Cause.UNKNOWN.word else "worse"
    return Cell(number(100.0 * value, 0) if value > 0.0 else "", meaning, round(STRONGEST * value))


def right_verdicts(record: Record, condition: str, level: float) -> tuple[str, ...]:
    """Correct verdicts: the leak if there is one, else the fault, else none."""
    if level > HEALTHY:
        return (Cause.INTERNAL_LEAK.word,)
    changes = record.conditions["changes"].get(condition)
    faults = json.loads(changes).get("faults", {}) if isinstance(changes, str) and changes else {}
    return tuple(CAUSE_OF_FAULT[name].word for name in faults) or (Cause.NONE.word,)


def floors_table(record: Record) -> list[Table]:
    """The project's required figures beside the measured ones."""
    table = record.table("floors")
    if table.empty:
        return []
    tables = []
    for detector, frame in table.groupby("detector", sort=False):
        rows = [_floor_row(row) for row in frame.to_dict("records")]
        header = ("Figure", "Measured", "Reaches", "Floor", "Aim", "Before", "Note")
        tables.append(Table(str(detector), header, rows))
    return tables


def _floor_row(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    decimals = 1 if row["unit"] == "%" else None
    value, low, high = (number(row[name], decimals) for name in ("measured", "low", "high"))
    return (
        unbroken(f"{row['figure']}, {row['unit']}"),
        value if np.isnan(row["low"]) else f"{value} ({low} to {high})",
        str(row["reaches"]),
        *(_mark(row[name]) for name in ("floor", "aim", "before")),
        unbroken(row["note"]) if isinstance(row["note"], str) else "",
    )


def _mark(value: float) -> str:
    return "–" if np.isnan(value) else setting(float(f"{value:.3g}"))


def detection_tables(record: Record) -> list[Table]:
    """Share of windows reported as a leak, by condition and level; one table per detector."""
    tables = []
    detection = record.table("detection")
    for detector in record.detectors:
        mine = detection[detection["detector"] == detector]
        levels = sorted(level for level in mine["level"].unique() if level != DRAWN)
        rows = []
        for condition in mine["condition"].unique():
            cells = [record.cell("detection", detector, condition, level) for level in levels]
            if not any(cells):
                continue
            healthy = record.cell("detection", detector, condition, HEALTHY)
            shares = [number(percent_of(cell, "flagged").value, 1) for cell in cells]
            rows.append(
                (
                    record.label(str(condition)),
                    *shares,
                    number(float(healthy.get("per_hour", np.nan)), 0),
                    number(100.0 * float(healthy.get("cannot_tell", np.nan)), 1),
                )
            )
        header = (
            "Condition",
            *(level_text(level) for level in levels),
            "false alarms per hour",
            "cannot tell, healthy",
        )
        caption = f"{detector}: share of windows reported as a leak past the piston, %"
        tables.append(Table(caption, header, rows))
    return tables


def size_tables(record: Record) -> list[Table]:
    """Size error, its ratio to the bound, and coverage of the intervals; one table per detector."""
    tables = []
    sizes = record.table("sizes")
    for detector in record.detectors:
        mine = sizes[(sizes["detector"] == detector) & (sizes["level"] != HEALTHY)]
        rows = [
            (
                f"{record.label(str(row['condition']))}, {level_text(row['level'])}",
                number(row["rms_log10"], 3),
                number(row["median_error_lpm"], 4),
                number(row["bound_lpm"], 4),
                number(row["ratio_to_bound"], 1),
                interval_text(percent_of(row, "coverage"), decimals=0),
                number(100.0 * row["told"] / row["windows"], 0),
            )
            for row in mine.to_dict("records")
        ]
        header = (
            "Condition, leak", "error, RMS log10", "median error, l/min", "bound, l/min", "error ÷ bound",
            "interval contains the true size, %", "answered, %",
        )  # fmt: skip
        tables.append(Table(f"{detector}: size of the leak", header, rows))
    return tables


def alarm_tables(record: Record) -> list[Table]:
    """False alarms per 100 h, delays and misses of the alarm stage."""
    table = record.table("alarms")
    tables = []
    for detector, frame in table.groupby("detector", sort=False) if not table.empty else ():
        healthy = frame[frame["leak_lpm"] == HEALTHY].to_dict("records")
        said = "".join(
            f": {number(row['per_100_h'], 1)} false alarms per 100 h ({number(row['per_100_h_low'], 1)} to "
            f"{number(row['per_100_h_high'], 1)}; {row['alarms']:.0f} in {row['hours']:.0f} h)"
            for row in healthy
        )
        rows = [
            (
                f"{setting(row['leak_lpm'])} l/min, {row['then'].replace('all', 'all activities')}",
                number(row["median_s"], 1),
                number(row["p90_s"], 1),
                interval_text(percent_of(row, "missed"), decimals=1),
                f"{row['axes']:.0f}",
            )
            for row in frame[frame["leak_lpm"] > HEALTHY].to_dict("records")
        ]
        header = ("Leak that begins, activity", "median delay, s", "90 % within, s", "missed after a minute, %", "axes")
        tables.append(Table(f"{detector}{said}", header, rows))
    return tables


def masking_tables(record: Record) -> list[Table]:
    """Detection of small leaks, position error and bound, one row per controller."""
    table = record.masking()
    if table.empty:
        return []
    shares = table[table["level"] <= 0.3].pivot_table(
        index="condition", columns=["detector", "level"], values="at_1_percent", sort=False
    )
    # A single controller allows no comparison.
    shares = shares.loc[:, shares.notna().sum() >= min(2, len(shares))]
    columns = [(name, level) for name in record.detectors for level in sorted(table["level"].unique())]
    columns = [column for column in columns if column in shares.columns]
    rows = []
    for condition, frame in table.groupby("condition", sort=False):
        bounds = {row["level"]: row["bound_lpm"] for row in frame.to_dict("records")}
        rows.append(
            (
                str(frame["acting"].iloc[0]),
                number(float(frame["error_mm"].mean()), 3),
                number(bounds.get(0.3, np.nan), 4),
                *(number(100.0 * float(shares.loc[condition, column]), 0) for column in columns),
            )
        )
    sizes = (f"{name}: {setting(level)}" for name, level in columns)
    header = ("Controller", "error, mm", "bound at 0.3, l/min", *sizes)
    return [Table("Found at 1 % false alarms, %, by size of the leak in l/min", header, rows)]


def conditions_tables(record: Record) -> list[Table]:
    """Changes of each condition."""
    table = record.table("conditions")
    columns = {"label": "Condition", "acting": "Operated by", "motion": "Motion", "begins": "Window begins",
               "duration_s": "s", "trained": "Head trained on it", "changes": "Changes"}  # fmt: skip
    rows = [tuple(_text(row[name]) for name in columns) for row in table.fillna("").to_dict("records")]
    return [Table("", tuple(columns.values()), rows)]


def _text(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return setting(float(value)) if isinstance(value, float) else str(value)
