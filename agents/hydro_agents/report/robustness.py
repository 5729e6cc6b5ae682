"""The page of the robustness protocol: controllers under every condition, relative to the baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.metrics import COMPARED, METRICS
from hydro_agents.report.canvas import HEIGHT, INK, Plot, description, one_panel, row_axis, ticks
from hydro_agents.report.content import ALL, Content, interval, interval_text
from hydro_agents.report.heat import heat_map, legend
from hydro_agents.report.robustness_findings import findings_of
from hydro_agents.report.sections import Block, Cards, Fold, Key, Points, Text, section
from hydro_agents.report.shared import problems
from hydro_agents.report.traces import Trace, example_plot
from hydro_agents.running.text import Table, number, setting

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
    "leak_price",
    "inputs",
    "method",
    "run",
)
"""Sections of the page, in order."""

COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of the ranking: what a small error may cost."""


@section("Findings", heading=False)
def findings(content: Content) -> list[Block]:
    """The findings as cards, and what did not run."""
    return [
        Cards(findings_of(content)),
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
        Key(legend()),
        *heat_map(content, "Ratio of errors, equal weights", "equal_weight"),
        Fold("The same with mean errors, which steps dominate", heat_map(content, "Ratio of mean errors", "ratio")),
    ]


@section("Errors and costs", needs=("summary",))
def costs(content: Content) -> list[Block]:
    """Ranking, errors and costs of every controller, and performance profiles."""
    return [*ranking_table(content), absolute_table(content), *profile_plots(content), *gap_plot(content)]


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
                f"Gap closed: (error of {base} − error) ÷ (error of {base} − best found), if a bound was computed.",
            ]
        )
    ]


# Tables -------------------------------------------------------------------------------------------------------------


def ranking_table(content: Content) -> list[Table]:
    """Every controller relative to the baseline: errors, certainty, costs."""
    if not content.has("ranking") or len(content.controllers) < 2:
        return []
    rows = []
    for row in content.table("ranking").to_dict("records"):
        name = str(row["controller"])
        own = content.against(name)
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
    prices = (metric.ratio for metric in COSTS.values())
    header = ("Controller", *errors, *prices, "best in", "failed", "limit cycles")
    groups = [(f"error ÷ error of {content.baseline}", 4), ("shares", 2)]
    groups += [("cost ÷ baseline’s", len(COSTS)), ("count", 3)]
    return [Table("All conditions", header, rows, tuple(groups), "dense")]


def absolute_table(content: Content) -> Table:
    """Mean, interquartile mean and worst error in mm with costs, over all conditions."""
    beside = [metric for metric in METRICS.values() if metric.cost or metric.ratio]
    rows = []
    for name in content.controllers:
        error = content.row("summary", controller=name, condition=ALL, metric="mean_error_mm")
        cells = [interval_text(interval(error, key)) for key in ("mean", "iqm")]
        cells.append(number(float(error.get("worst", np.nan))))
        for metric in beside:
            own = content.row("summary", controller=name, condition=ALL, metric=metric.name)
            cells.append(number(metric.factor * float(own.get("mean", np.nan))))
        rows.append((name, *cells))
    errors = ("mean error, mm", "interquartile mean, mm", "worst run, mm")
    header = ("Controller", *errors, *(metric.label for metric in beside))
    return Table("Errors and costs, mean over all runs", header, rows, style="dense")


def _share(row: Mapping[str, Any], column: str) -> str:
    value = float(row.get(column, np.nan))
    return "–" if np.isnan(value) else f"{number(100.0 * value, 0)} %"


def _two(value: Any) -> str:
    return number(float(value), 2)


def worst_table(content: Content) -> list[Table]:
    """The worst cases of every controller, with the seed that replays each of them."""
    table = content.table("worst_cases")
    if table.empty:
        return []
    rows = []
    for row in table.to_dict("records"):
        rows.append(
            (
                str(row["controller"]),
                content.label(str(row["condition"])),
                str(row["family"]),
                setting(row["leakage_flow_lpm"]),
                str(int(row["seed"])),
                *(number(float(row[key])) for key in ("mean_error_mm", "baseline_error_mm", "ratio", "peak_error_mm")),
            )
        )
    header = ("Controller", "condition", "reference", "leak, l/min", "seed", "error, mm", "baseline, mm", "ratio")
    return [Table("Worst ratios of errors", (*header, "peak, mm"), rows)]


# Figures ------------------------------------------------------------------------------------------------------------


def profile_plots(content: Content) -> list[Plot]:
    """Share of cases whose error is at most tau times that of the best controller, and of the baseline."""
    table = content.table("profiles")
    notes = {
        "best": "Share of cases in which the error is at most τ times the smallest error of any controller in that "
        "case (Dolan and Moré). Higher is better; at τ = 1: share of cases won.",
        "baseline": f"The same against {content.baseline}: the curve at τ = 1 is the share of cases with a smaller "
        "error, and its right end shows the worst cases.",
    }
    titles = {
        "best": "Performance profile against the best",
        "baseline": f"Performance profile against {content.baseline}",
    }
    if table.empty:
        return []
    return [
        _profile(content, table[table["against"] == against], against, titles[against], notes[against])
        for against in ("best", "baseline")
        if (table["against"] == against).any()
    ]


def _profile(content: Content, table: pd.DataFrame, key: str, title: str, note: str) -> Plot:
    looks = content.looks
    parts = {name: table[table["controller"] == name].sort_values("tau") for name in content.controllers}
    parts = {name: part for name, part in parts.items() if len(part)}

    def paint(axes: Axes) -> None:
        axes.set_xscale("log")
        for name, part in parts.items():
            axes.step(part["tau"], 100.0 * part["share"], where="post", label=name, **looks[name].stroke)
        ends = (float(table["tau"].min()), float(table["tau"].max()))
        ticks(
            axes.xaxis,
            [tick for tick in (0.25, 0.5, 0.71, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0) if ends[0] <= tick <= ends[1]],
        )
        axes.set(xlabel="τ", ylabel="share of cases, %", ylim=(0.0, 102.0), xlim=ends)
        axes.axvline(1.0, color=INK, linewidth=0.8)

    places = (1.0, 1.5, 2.0)
    rows = {
        name: [(f"τ = {setting(tau)}", 100.0 * float(np.interp(tau, part["tau"], part["share"]))) for tau in places]
        for name, part in parts.items()
    }
    return one_panel(f"profile-{key}", title, note, description(title, rows, " %"), paint)


def gap_plot(content: Content) -> list[Plot]:
    """Share of the gap between the baseline and the best found that each controller closes."""
    rows = {name: interval(content.against(name), "gap") for name in content.controllers[1:]}
    rows = {name: value for name, value in rows.items() if np.isfinite(value.value)}
    if not rows:
        return []
    looks = content.looks

    def paint(axes: Axes) -> None:
        for place, (name, value) in enumerate(rows.items()):
            axes.barh(place, 100.0 * value.value, height=0.55, color=looks[name].colour)
            lengths = np.nan_to_num(100.0 * np.array([[value.value - value.low], [value.high - value.value]]))
            axes.errorbar(100.0 * value.value, place, xerr=np.maximum(lengths, 0.0), color=INK)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.axvline(100.0, color=INK, linewidth=0.8, linestyle="--")
        row_axis(axes, list(rows))
        axes.set_xlabel(f"closed share of the gap, %: 0 = {content.baseline}, 100 = best found")

    title = "Share of the gap to the best found"
    note = f"(error of {content.baseline} − error) ÷ (error of {content.baseline} − best found); bars: 95 % interval."
    alt = description(title, {name: [("gap", 100.0 * value.value)] for name, value in rows.items()}, " %")
    return [one_panel("gap", title, note, alt, paint, max(HEIGHT - 0.8, 0.9 + 0.35 * len(rows)))]
