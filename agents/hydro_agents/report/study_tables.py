"""The tables of the report: metrics by leak and reference, ratios, detection, definitions."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.report.content import Content, interval_text, percent
from hydro_agents.report.study_findings import plants_of, row_interval, verdict
from hydro_agents.running.statistics import Interval, conditional_value_at_risk
from hydro_agents.running.text import Table, decimals_for, family_name, number, setting

OVERVIEW = tuple(m for m in METRICS.values() if m.cost or m.name in ("mean_error_mm", "peak_error_mm"))
"""Metrics side by side: an error is no result without its cost."""


def overview(content: Content) -> Table:
    """One row per controller over all runs: error, ratio to the first one, worst cases, and costs."""
    names = content.controllers
    cells = {name: _overview_cells(content.table("cases"), name) for name in names}
    return Table(
        "Errors and costs, mean over all runs",
        ("Controller", _overview_header()[0], f"÷ {names[0]}'s", "worst 5 %, mm", *_overview_header()[1:]),
        [(name, mean, *_overall(content, name), *rest) for name, (mean, *rest) in cells.items()],
        style="dense",
    )


def level_tables(content: Content) -> dict[float, Table]:
    """The same for each leak level, without the ratio."""
    names = content.controllers
    return {
        float(level): Table(
            f"Leak of {setting(float(level))} l/min",
            ("Controller", *_overview_header()),
            [(name, *_overview_cells(cases, name)) for name in names],
            style="dense",
        )
        for level, cases in content.table("cases").groupby("leakage_flow_lpm")
    }


def _overview_header() -> tuple[str, ...]:
    return tuple(metric.label[0].lower() + metric.label[1:] for metric in OVERVIEW)


def _overall(content: Content, name: str) -> tuple[str, str]:
    """Ratio of the mean error with its interval, and the mean of the worst 5 % of the runs."""
    rows = content.table("ratios")
    rows = rows[(rows["controller"] == name) & (rows["group"] == "all")] if len(rows) else rows
    ratio = interval_text(row_interval(rows.iloc[0], "ratio"), decimals=3) if len(rows) else "–"
    errors = content.table("cases").loc[content.table("cases")["controller"] == name, "mean_error_mm"]
    return ratio, number(conditional_value_at_risk(errors.to_numpy()))


def _overview_cells(cases: pd.DataFrame, name: str) -> tuple[str, ...]:
    own = cases[cases["controller"] == name]
    return tuple(number(metric.factor * float(own[metric.name].mean())) for metric in OVERVIEW)


def metric_table(content: Content, by: str, metric: str) -> Table:
    """Mean with interval, worst 5 % and worst run of every controller."""
    column, first = ("leakage_flow_lpm", "Leak, l/min") if by == "level" else ("family", "Reference")
    table = content.table("levels") if by == "level" else content.table("families")
    table = table[table["metric"] == metric]
    shown = METRICS[metric]
    names = content.controllers
    means = shown.factor * table["mean"].abs()
    decimals = decimals_for(float(means[means > 0.0].median()))
    rows = []
    for value in table[table["mean"].notna()][column].unique():
        cells = [setting(value) if by == "level" else family_name(str(value))]
        for name in names:
            row = table[(table["controller"] == name) & (table[column] == value)].iloc[0]
            mean = Interval(*(shown.factor * float(row[key]) for key in ("mean", "low", "high")))
            tail = (shown.factor * float(row[key]) for key in ("cvar_5_percent", "worst"))
            cells += [interval_text(mean, decimals=decimals), *(number(part, decimals) for part in tail)]
        rows.append(tuple(cells))
    caption = f"{shown.label}, by {'leak size' if by == 'level' else 'kind of reference'}"
    header = (first, *("mean (95 % interval)", "worst 5 %", "worst run") * len(names))
    return Table(caption, header, rows, tuple((name, 3) for name in names))


def metric_tables(content: Content, by: str) -> list[Table]:
    """All other metrics that have a value, and the failures if there are any."""
    frame = content.table("levels") if by == "level" else content.table("families")
    shown = frame["mean"].notna() & ((frame["metric"] != "failed") | (frame["mean"] > 0.0))
    valued = {str(name) for name in frame[shown]["metric"]} - {"mean_error_mm"}
    return [metric_table(content, by, metric) for metric in METRICS if metric in valued]


def ratio_tables(content: Content) -> list[Table]:
    """Ratios of errors to the first controller, with verdicts; none with one controller."""
    if not content.has("ratios"):
        return []
    plants, tables = plants_of(content), []
    for name, frame in content.table("ratios").groupby("controller", sort=False):
        rows = []
        for row in frame.to_dict("records"):
            interval, value = row_interval(row, "ratio"), str(row["value"])
            label = {"": "all runs"}.get(value, family_name(value))
            label = f"leak of {setting(float(value))} l/min" if row["group"] == "level" else label
            share = float(row["share_of_cases_better"])
            better = "–" if np.isnan(share) else f"{number(100.0 * share, 0)} %"
            rows.append((label, interval_text(interval, decimals=3), verdict(interval, plants), better))
        header = ("Runs", "ratio (95 % interval)", f"{name} …", "better in")
        tables.append(Table(f"Mean error of {name} over mean error of {frame['against'].iloc[0]}", header, rows))
    return tables


def detection_tables(content: Content) -> list[Table]:
    """Shares of flagged episodes and the summary; none without a leakage head."""
    if not content.has("detection"):
        return []
    return [
        _detection_rates(content, "class", "Share of episodes flagged, by class of leak", "Class"),
        _detection_rates(content, "range", "Share of leaks flagged, by size", "Leak, l/min"),
        _detection_summary(content),
    ]


def _detection_rates(content: Content, group: str, caption: str, first: str) -> Table:
    rates, names = content.table("detection_rates"), content.controllers
    part = rates[rates["group"] == group]
    rows = []
    for value in part["value"].unique():
        each = [part[(part["controller"] == name) & (part["value"] == value)].iloc[0] for name in names]
        cells = [percent(row_interval(row, "flagged_share")) for row in each]
        rows.append((str(value), *cells, str(int(each[0]["episodes"]))))
    return Table(caption, (first, *names, "episodes"), rows)


SUMMARY: dict[str, tuple[str, float, int, str]] = {
    "auroc": ("Area under the ROC curve, leaks above {above:g} l/min", 1.0, 3, ""),
    "average_precision": ("Average precision, leaks above {above:g} l/min", 1.0, 3, ""),
    "threshold": ("Threshold of the leak probability", 1.0, 3, ""),
    "false_alarm_rate": ("False alarms at this threshold", 100.0, 1, " %"),
    "detection_rate_moderate": ("Leaks from {moderate:g} l/min flagged at this threshold", 100.0, 1, " %"),
    "detection_rate_moderate_at_1_percent": (
        "Leaks from {moderate:g} l/min flagged at a threshold with 1 % false alarms on these episodes",
        100.0,
        1,
        " %",
    ),
    "median_size_error_factor": ("Size: factor of error, half of the leaks within", 1.0, 2, ""),
    "p90_size_error_factor": ("Size: factor of error, nine in ten within", 1.0, 2, ""),
    "healthy_episodes": ("Healthy episodes", 1.0, 0, ""),
    "leaking_episodes": ("Leaking episodes", 1.0, 0, ""),
}
"""Name, factor, decimals and unit of the rows of the summary."""


def _detection_summary(content: Content) -> Table:
    summary = content.table("detection_summary")
    bounds = content.bounds
    names = {"above": bounds.leaking_above, "moderate": bounds.moderate_from}
    rows = [
        (label.format(**names), *(number(factor * float(value), decimals) + unit for value in summary[key]))
        for key, (label, factor, decimals, unit) in SUMMARY.items()
        if key in summary
    ]
    return Table("Detection, summary", ("Quantity", *map(str, summary["controller"])), rows)


def definitions() -> Table:
    """Definitions of the metrics."""
    rows = []
    for metric in METRICS.values():
        meaning = metric.meaning if metric.unit == "1" else f"{metric.meaning}; {metric.unit}"
        rows.append((metric.word, meaning, metric.name))
    return Table("Metrics of a run", ("Name", "meaning", "in the CSV files"), rows, style="words")


def terms(content: Content) -> Table:
    """What the words of the page mean."""
    rows = [
        (
            "Ratio",
            "mean error of one controller divided by that of another, on the same runs; below 1 is better",
        ),
        ("Worst 5 %", "conditional value at risk (CVaR): mean over the worst 5 % of the runs"),
    ]
    if content.has("detection_summary"):
        healthy = setting(content.bounds.healthy_up_to)
        rows += [
            ("False alarm", f"an episode with a healthy seal (up to {healthy} l/min) that is flagged"),
            ("Detection rate", "share of leaking episodes that are flagged; also called recall"),
            ("Precision", "share of flagged episodes that leak; depends on how common leaks are"),
            (
                "ROC, area under it",
                "detection rate over false-alarm rate for all thresholds; the area (AUROC) is the probability that a "
                "leaking episode gets a higher score than a healthy one: 1 is perfect, 0.5 is chance",
            ),
            ("Average precision", "precision averaged over recall; chance gives the share of leaking episodes"),
        ]
    return Table("Terms", ("Term", "Meaning"), rows, style="words")
