"""The page of the robustness protocol: controllers under every condition, relative to the baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.metrics import COMPARED, FRAMES_TEXT, METRICS
from hydro_agents.report.canvas import INK, Plot, description, one_panel, ticks
from hydro_agents.report.content import ALL, Content, interval, interval_text, verdict
from hydro_agents.report.palette import STRONGEST
from hydro_agents.report.robustness_findings import findings_of
from hydro_agents.report.sections import Block, Fold, Key, Points, Text, cards, section
from hydro_agents.report.shared import problems, score_plot, score_text
from hydro_agents.report.traces import Trace, example_plot
from hydro_agents.running.text import Cell, Table, family_name, number, setting

PAGE_FILE = "robustness.html"

ROBUSTNESS = (
    "introduction",
    "findings",
    "comparison",
    "costs",
    "failures",
    "frequency",
    "stiffness",
    "standstill",
    "transitions",
    "leak_price",
    "inputs",
    "method",
    "run",
)
"""Sections of the page, in order."""

PROFILE_TICKS = (0.25, 0.5, 0.71, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of the ranking: what a small error may cost."""


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
    "day": "Through a day: moves after a pause, slow runs, small steps",
    "rig": "Other rigs",
    "parameter": "Assumed parameters, one at a time",
}
"""Titles of the groups of conditions, in the order of the map."""

FOLDED = ("parameter",)
"""Groups that the page folds because they have many conditions."""

Row = tuple[str | Cell, ...]


@section("Findings", heading=False)
def findings(content: Content) -> list[Block]:
    """The findings as cards, and what did not run."""
    return [
        cards(findings_of(content)),
        Text(
            f"In brackets: 95 % intervals. Ratios are error ÷ error of {content.baseline} on the same cases; below 1 "
            "is better.",
            "soft",
        ),
        *problems(content),
    ]


@section("Comparison by condition", needs=("comparison", "conditions"))
def comparison(content: Content) -> list[Block]:
    """The heat map of all conditions."""
    return [
        Text(
            f"Error ÷ error of {content.baseline} under the same condition; every kind of reference has the same "
            "weight. A cell has a colour only if its whole 95 % interval is on one side of 1. Bold: the best of its "
            f"row. The first column is the mean error of {content.baseline}."
        ),
        Key([Cell(setting(r), "better" if r < 1.0 else "worse", colour_share(r)) for r in SCALE]),
        *heat_map(content, "Ratio of errors, equal weights", "equal_weight"),
        Fold(
            "The same in the frame of the sensor (repeatability)",
            heat_map(content, "Ratio of errors in the frame of the sensor, equal weights", "equal_weight_sensor"),
        ),
        Fold("The same with mean errors, which steps dominate", heat_map(content, "Ratio of mean errors", "ratio")),
    ]


@section("Errors and costs", needs=("summary",))
def costs(content: Content) -> list[Block]:
    """Ranking, errors and costs of every controller, and performance profiles."""
    scores = {name: interval(content.against(name), "score") for name in content.controllers[1:]}
    return [*ranking_table(content), absolute_table(content), *profile_plots(content), *score_plot(content, scores)]


@section("Where each controller fails")
def failures(content: Content) -> list[Block]:
    """Traces of the worst cases, with the baseline beside each; the same colours as elsewhere."""
    traces: list[Trace] = content.other("traces", [])
    worst = worst_table(content)
    if not traces and not worst:
        return []
    return [
        Text(
            f"The cases in which a controller is worst against {content.baseline}, and those in which "
            f"{content.baseline} is worst against the best of the others. Both ran on the same plant, reference and "
            "noise."
        ),
        *(example_plot(trace.example, f"worst-{count}", content.looks) for count, trace in enumerate(traces, 1)),
        *([Fold("More of the worst cases", worst)] if worst else []),
    ]


@section("Inputs of each controller", needs=("sees",))
def inputs(content: Content) -> list[Block]:
    """What each controller observes and remembers."""
    header = ("Controller", "the leak", "the state", "preview", "memory", "signals", "note")
    columns = ("controller", "leak", "state", "preview", "memory", "signals", "note")
    table = content.table("sees").fillna("").to_dict("records")
    return [Table("", header, [tuple(str(row.get(key, "")) for key in columns) for row in table], style="words")]


@section("How it was measured", needs=("summary",))
def method(content: Content) -> list[Block]:
    """Pairing, intervals and measures."""
    base = content.baseline
    return [
        Points(
            [
                "Paired cases: a seed fixes plant, reference and noise, and every controller runs on the same seeds. "
                "They are test seeds; no controller was tuned or trained on them.",
                "Intervals: 95 %, bootstrap over plants and training seeds.",
                "Equal weights: geometric mean of the ratios of all kinds of reference. Interquartile mean: mean of "
                "the middle half of the cases.",
                FRAMES_TEXT,
                score_text(base),
            ]
        )
    ]


# Heat map -----------------------------------------------------------------------------------------------------------


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
        breaks |= {len(shown): title} if title else {}
        shown += rows
    return [
        Table(caption, header, shown, style="heat", folded=False, breaks=breaks),
        *(
            Fold(f"{title} ({len(rows)} condition{'s' * (len(rows) != 1)})", [Table("", header, rows, style="heat")])
            for title, rows in folded.items()
        ),
    ]


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
        meaning = verdict(value).replace("same", "")
        share = colour_share(value.value) if meaning else 0
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


# Tables -------------------------------------------------------------------------------------------------------------


def ranking_table(content: Content) -> list[Table]:
    """Every controller relative to the baseline: errors, certainty, costs."""
    if not content.has("ranking") or len(content.controllers) < 2:
        return []
    titles = {"equal_weight": "equal weights", "equal_weight_sensor": "the same, repeatability", "ratio": "mean"}
    titles |= {"iqm_ratio": "interquartile mean"}
    rows = []
    for row in content.table("ranking").to_dict("records"):
        own = content.against(str(row["controller"]))
        ratios = [interval_text(interval(own, key), decimals=2) for key in titles]
        shares = [_share(own, "share_better") if own else "–", interval_text(interval(row, "score"), decimals=0)]
        costs = [number(float(own.get(column, 1.0)), 2) for column in ("worst_ratio", *COSTS)]
        counts = [str(int(row[key])) if key in row else "–" for key in ("best_in", "failures", "limit_cycles")]
        rows.append(
            (str(row["controller"]), *(ratios if own else ["1.00"] * 4), costs[0], *shares, *costs[1:], *counts)
        )
    prices = (metric.ratio for metric in COSTS.values())
    header = (
        "Controller",
        *titles.values(),
        "worst case",
        "better in",
        "score",
        *prices,
        "best in",
        "failed",
        "limit cycles",
    )
    groups = [(f"error ÷ error of {content.baseline}", 5), ("", 2)]
    groups += [("cost ÷ baseline’s", len(COSTS)), ("count", 3)]
    return [Table("All conditions", header, rows, tuple(groups), "dense")]


def absolute_table(content: Content) -> Table:
    """Mean, interquartile mean and worst error in mm with costs, over all conditions."""
    beside = [metric for metric in METRICS.values() if metric.cost or metric.ratio]
    rows = []
    for name in content.controllers:
        own = content.rows("summary", controller=name, condition=ALL).set_index("metric").to_dict("index")
        error = own.get("mean_error_mm", {})
        means = (number(metric.factor * float(own.get(metric.name, {}).get("mean", np.nan))) for metric in beside)
        cells = (interval_text(interval(error, key)) for key in ("mean", "iqm"))
        rows.append((name, *cells, number(float(error.get("worst", np.nan))), *means))
    errors = ("mean error, mm", "interquartile mean, mm", "worst run, mm")
    header = ("Controller", *errors, *(metric.label for metric in beside))
    return Table("Errors and costs, mean over all runs", header, rows, style="dense")


def _share(row: Mapping[str, Any], column: str) -> str:
    value = float(row.get(column, np.nan))
    return "–" if np.isnan(value) else f"{number(100.0 * value, 0)} %"


def worst_table(content: Content) -> list[Table]:
    """The worst cases of every controller, with the seed that replays each of them."""
    figures = ("mean_error_mm", "baseline_error_mm", "ratio", "peak_error_mm")
    rows = []
    for row in content.table("worst_cases").to_dict("records"):
        where = (content.label(str(row["condition"])), str(row["family"]), setting(row["leakage_flow_lpm"]))
        rows.append(
            (str(row["controller"]), *where, str(int(row["seed"])), *(number(float(row[key])) for key in figures))
        )
    if not rows:
        return []
    header = ("Controller", "condition", "reference", "leak, l/min", "seed", "error, mm", "baseline, mm", "ratio")
    return [Table("Worst ratios of errors", (*header, "peak, mm"), rows)]


# Figures ------------------------------------------------------------------------------------------------------------


def profile_plots(content: Content) -> list[Plot]:
    """Share of cases whose error is at most tau times that of the best controller, and of the baseline."""
    base = content.baseline
    notes = {
        "best": "Share of cases in which the error is at most τ times the smallest error of any controller in that "
        "case (Dolan and Moré). Higher is better; at τ = 1: share of cases won.",
        "baseline": f"The same against {base}: the curve at τ = 1 is the share of cases with a smaller error, and its "
        "right end shows the worst cases.",
    }
    titles = {"best": "the best", "baseline": base}
    return [
        _profile(content, table, against, f"Performance profile against {titles[against]}", note)
        for against, note in notes.items()
        if len(table := content.rows("profiles", against=against))
    ]


def _profile(content: Content, table: pd.DataFrame, key: str, title: str, note: str) -> Plot:
    parts = {
        name: own for name in content.controllers if len(own := table[table["controller"] == name].sort_values("tau"))
    }
    ends = (float(table["tau"].min()), float(table["tau"].max()))

    def paint(axes: Axes) -> None:
        for name, part in parts.items():
            axes.step(part["tau"], 100.0 * part["share"], where="post", label=name, **content.looks[name].stroke)
        axes.set(xscale="log", xlabel="τ", ylabel="share of cases, %", ylim=(0.0, 102.0), xlim=ends)
        ticks(axes.xaxis, [tick for tick in PROFILE_TICKS if ends[0] <= tick <= ends[1]])
        axes.axvline(1.0, color=INK, linewidth=0.8)

    places = (1.0, 1.5, 2.0)
    rows = {
        name: [(f"τ = {setting(tau)}", 100.0 * float(np.interp(tau, part["tau"], part["share"]))) for tau in places]
        for name, part in parts.items()
    }
    return one_panel(f"profile-{key}", title, note, description(title, rows, " %"), paint)
