"""The tables of the page: errors and costs, bandwidth, stiffness, standstill, cost of a leak, inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.evaluation.frequency import bandwidths
from hydro_agents.evaluation.metrics import COMPARED, METRICS
from hydro_agents.report.findings import interval_text
from hydro_agents.report.robustness_record import ALL, Record, interval
from hydro_agents.report.text import Table, number, setting

COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of the ranking: what a small error may cost."""


def ranking_table(record: Record) -> list[Table]:
    """Every controller relative to the baseline: errors, certainty, costs."""
    ranking = record.table("ranking")
    if ranking.empty or len(record.names) < 2:
        return []
    rows = []
    for row in ranking.to_dict("records"):
        name = str(row["controller"])
        own = record.against(name)
        ratios = [interval_text(interval(own, key), decimals=2) for key in ("equal_weight", "ratio", "iqm_ratio")]
        rows.append(
            (
                name,
                *(ratios if own else ["1.00"] * 3),
                _two(own.get("worst_ratio", 1.0)),
                _share(own, "share_better") if own else "–",
                _share(own, "gap") if own else "0 %",
                *(_two(own.get(column, 1.0)) for column in COSTS),
                *(str(int(row[key])) if key in row else "–" for key in ("best_in", "failures", "limit_cycles")),
            )
        )
    errors = ("equal weights", "mean", "interquartile mean", "worst case", "better in", "gap closed")
    costs = (metric.ratio for metric in COSTS.values())
    header = ("Controller", *errors, *costs, "best in", "failed", "limit cycles")
    groups = [(f"error ÷ error of {record.baseline}", 4), ("shares", 2)]
    groups += [("cost ÷ baseline’s", len(COSTS)), ("count", 3)]
    return [Table("All conditions", header, rows, tuple(groups))]


def absolute_table(record: Record) -> list[Table]:
    """Mean, interquartile mean and worst error in mm with costs, over all conditions."""
    summary = record.table("summary")
    summary = summary[summary["condition"] == ALL]
    beside = [metric for metric in METRICS.values() if metric.cost or metric.ratio]
    rows = []
    for name in record.names:
        own = {str(row["metric"]): row for row in summary[summary["controller"] == name].to_dict("records")}
        error: Mapping[Any, Any] = own.get("mean_error_mm", {})
        cells = [interval_text(interval({**error}, key)) for key in ("mean", "iqm")]
        cells.append(number(float(error.get("worst", np.nan))))
        for metric in beside:
            cells.append(number(metric.factor * float(own.get(metric.name, {}).get("mean", np.nan))))
        rows.append((name, *cells))
    header = (
        "Controller",
        "mean error, mm",
        "interquartile mean, mm",
        "worst run, mm",
        *(metric.label for metric in beside),
    )
    return [Table("Errors and costs, mean over all runs", header, rows)]


def _share(row: Mapping[str, Any], column: str) -> str:
    value = float(row.get(column, np.nan))
    return "–" if np.isnan(value) else f"{number(100.0 * value, 0)} %"


def _two(value: Any) -> str:
    return number(float(value), 2)


def bandwidth_table(record: Record) -> list[Table]:
    """Frequencies at −3 dB and −90°, by leak, with and without preview."""
    table = record.table("frequency")
    if table.empty:
        return []
    found = bandwidths(table)
    highest = float(table["frequency_hz"].max())
    tables = []
    for preview, text in ((True, "with the preview that the controller sees"), (False, "with the preview hidden")):
        part = found[found["preview"] == preview]
        leaks = sorted(float(leak) for leak in part["leakage_flow_lpm"].unique())
        rows = []
        for name, own in part.groupby("controller", sort=False):
            by_leak = own.set_index("leakage_flow_lpm")
            cells = [
                _frequency(float(by_leak.loc[leak, key]), highest)
                for leak in leaks
                for key in ("minus_3_db_hz", "minus_90_deg_hz")
            ]
            cells += [number(float(by_leak.loc[leak, "peak_gain"]), 2) for leak in (leaks[0],)]
            rows.append((str(name), *cells))
        header = ("Controller", *("−3 dB, Hz", "−90°, Hz") * len(leaks), "at the tight seal")
        groups = (*((f"{setting(leak)} l/min", 2) for leak in leaks), ("largest gain", 1))
        if rows:
            tables.append(Table(f"Bandwidth {text}; median of the plants", header, rows, groups))
    return tables


def _frequency(value: float, highest: float) -> str:
    return f"> {setting(highest)}" if np.isinf(value) else number(value, 1)


def stiffness_table(record: Record) -> list[Table]:
    """Static and dynamic stiffness by leak, medians of the plants."""
    table = record.table("force_step")
    if table.empty:
        return []
    leaks = sorted(float(leak) for leak in table["leakage_flow_lpm"].unique())
    columns: tuple[tuple[str, Callable[[pd.DataFrame], str]], ...] = (
        ("static, N/mm", lambda part: _stiffness(part, "remaining_mm")),
        ("dynamic, N/mm", lambda part: _stiffness(part, "peak_mm")),
        ("recovered after, ms", _recovery),
    )
    rows = []
    for name, own in table.groupby("controller", sort=False):
        parts = [own[own["leakage_flow_lpm"] == leak] for leak in leaks]
        rows.append((str(name), *(text(part) for part in parts for _, text in columns)))
    header = ("Controller", *[title for title, _ in columns] * len(leaks))
    groups = tuple((f"{setting(leak)} l/min", len(columns)) for leak in leaks)
    force = number(float(table["force_n"].iloc[0]), 0)
    return [Table(f"Stiffness against a force step of {force} N; median of the plants", header, rows, groups)]


def _recovery(part: pd.DataFrame) -> str:
    """Median time of the plants that recovered, and their number if not all did."""
    times = part["recovery_s"].dropna()
    text = number(1e3 * float(times.median()), 0)
    return text if len(times) == len(part) else f"{text} ({len(times)} of {len(part)})" if len(times) else "never"


LEAST_DEVIATION = 1e-3
"""mm; a smaller deviation gives only a lower limit of the stiffness."""


def _stiffness(part: pd.DataFrame, column: str) -> str:
    """Force over deviation, rounded to two digits, with ≥ if the deviation is too small."""
    force, deviation = float(part["force_n"].iloc[0]), float(part[column].median())
    value = force / max(deviation, LEAST_DEVIATION)
    size = 10.0 ** (int(np.floor(np.log10(value))) - 1)
    text = f"{size * round(value / size):,.0f}".replace(",", "\u2009")
    return f"≥ {text}" if deviation <= LEAST_DEVIATION else text


def standstill_tables(record: Record) -> list[Table]:
    """Limit cycles by leak, and residual motion, offset and valve travel with noise."""
    table = record.table("standstill")
    if table.empty:
        return []
    leaks = sorted(float(leak) for leak in table["leakage_flow_lpm"].unique())
    header = ("Controller", *(f"{setting(leak)} l/min" for leak in leaks))
    cycles, rest = [], []
    for name, own in table.groupby("controller", sort=False):
        parts = [own[own["leakage_flow_lpm"] == leak] for leak in leaks]
        cycles.append((str(name), *(_cycles(part) for part in parts)))
        cells = [number(float(own[key].mean()), 1) for key in ("unrest_um", "offset_um")]
        rest.append((str(name), *cells, number(float(own["valve_travel_per_s"].mean()), 2)))
    words = ("Controller", "residual motion, µm RMS", "offset, µm", "valve travel, strokes per s")
    return [
        Table("Held positions with a limit cycle (largest amplitude, its frequency)", header, cycles),
        Table("At rest under sensor noise, mean over all leaks", words, rest),
    ]


def cycles_by_condition(record: Record) -> list[Table]:
    """Limit cycles at mid-stroke under every condition in which any controller has one."""
    table = record.table("limit_cycles")
    if table.empty:
        return []
    counts = table.groupby(["condition", "controller"], sort=False)["limit_cycle"].agg(["sum", "count"]).astype(int)
    rows = []
    for condition in table["condition"].unique():
        own = {name: counts.loc[(condition, name)] for name in record.names if (condition, name) in counts.index}
        if any(part["sum"] for part in own.values()):
            cells = [f"{own[name]['sum']} of {own[name]['count']}" if name in own else "–" for name in record.names]
            rows.append((record.label(str(condition)), *cells))
    quiet = table["condition"].nunique() - len(rows)
    caption = f"Limit cycles by condition; none under the other {quiet}" if quiet else "Limit cycles by condition"
    return [Table(caption, ("Condition", *record.names), rows)] if rows else []


def energy_table(record: Record) -> list[Table]:
    """Energy that a run takes from the supply at each leak, under every controller."""
    conditions, summary = record.table("conditions"), record.table("summary")
    if conditions.empty:
        return []
    leaks = [str(name) for name in conditions.loc[conditions["group"] == "leak", "condition"]]
    energy = summary[summary["metric"] == "supply_energy_j"].set_index(["controller", "condition"])["mean"]
    rows = [
        (name, *(number(float(energy.get((name, leak), np.nan)), 0) for leak in leaks))
        for name in record.names
        if any((name, leak) in energy.index for leak in leaks)
    ]
    header = ("Controller", *(record.label(leak) for leak in leaks))
    return [Table("Energy from the supply, J per run, by leak", header, rows)] if rows else []


def _cycles(part: pd.DataFrame) -> str:
    found = part[part["limit_cycle"].astype(bool)].sort_values("amplitude_um")
    if found.empty:
        return f"0 of {len(part)}"
    largest = found.iloc[-1]
    size, frequency = number(float(largest["amplitude_um"]), 0), number(float(largest["frequency_hz"]), 1)
    return f"{len(found)} of {len(part)} ({size} µm, {frequency} Hz)"


PRICES = {
    "holding_power_w": ("Power to hold, W", 1),
    "holding_command": ("Command to hold, % of full", 1),
    "speed_out_mm_s": ("Speed out, mm/s", 0),
    "speed_back_mm_s": ("Speed back, mm/s", 0),
    "force_out_n": ("Force out, N", 0),
    "force_back_n": ("Force back, N", 0),
}
"""Columns of the cost of a leak: name and decimals."""


def price_table(record: Record) -> list[Table]:
    """Holding power, and reserve of speed and force, at each leak."""
    table = record.table("leak_price")
    if table.empty:
        return []
    rows = []
    for row in table.to_dict("records"):
        values = {key: 100.0 * row[key] if key == "holding_command" else row[key] for key in PRICES}
        rows.append((setting(row["leakage_flow_lpm"]), *(number(values[key], PRICES[key][1]) for key in PRICES)))
    return [Table("Cost of a leak at steady state", ("Leak, l/min", *(name for name, _ in PRICES.values())), rows)]


def sees_table(record: Record) -> list[Table]:
    """Inputs of each controller."""
    table = record.table("sees")
    if table.empty:
        return []
    header = ("Controller", "the leak", "the state", "preview", "memory", "signals", "note")
    columns = ("controller", "leak", "state", "preview", "memory", "signals", "note")
    rows = [tuple(str(row.get(key, "")) for key in columns) for row in table.fillna("").to_dict("records")]
    return [Table("", header, rows)]


def worst_table(record: Record) -> list[Table]:
    """The worst cases of every controller, with the seed that replays each of them."""
    table = record.table("worst_cases")
    if table.empty:
        return []
    rows = []
    for row in table.to_dict("records"):
        rows.append(
            (
                str(row["controller"]),
                record.label(str(row["condition"])),
                str(row["family"]),
                setting(row["leakage_flow_lpm"]),
                str(int(row["seed"])),
                *(number(float(row[key])) for key in ("mean_error_mm", "baseline_error_mm", "ratio", "peak_error_mm")),
            )
        )
    header = ("Controller", "condition", "reference", "leak, l/min", "seed", "error, mm", "baseline, mm", "ratio")
    return [Table("Worst ratios of errors", (*header, "peak, mm"), rows)]
