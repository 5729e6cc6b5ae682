"""Findings on the pages that compare controllers: one sentence each, above the tables with their numbers."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.limit_cycles import comes_to_rest, rest_warning
from hydro_agents.evaluation.metrics import COMPARED, METRICS
from hydro_agents.report.content import Content, interval, shown, verdict
from hydro_agents.report.experiments import leaks_of, stiffness_text
from hydro_agents.report.sections import Block, Cards, Fold, Points, Text
from hydro_agents.running.text import Table, number

COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of a comparison with what a small error may cost."""

PHRASES = ("at standstill ± {} µm", "{} everywhere", "settles in {} ms", "stiffness {} N/mm")
"""What a sentence says of each column of the table of standstills."""

AT_REST = (
    "± distance of the reading from the reference at the end of a standstill: root mean square under sensor noise "
    "where the run has experiments at standstill, else the mean without noise.",
    f"Settling: {METRICS['settling_time_s'].meaning}; standstills on which it never settles do not count.",
    "Stiffness: force ÷ largest deviation after a sudden force.",
)


def findings_of(content: Content) -> list[Block]:
    """Who is best, policies against what they correct, and the axis at standstill."""
    sentences, numbers = _against_corrected(content)
    standing = at_rest(content)
    if standing:
        name, *cells = standing[0]
        phrases = (phrase.format(cell) for phrase, cell in zip(PHRASES, cells, strict=True) if cell)
        sentences.append(f"{name}: {', '.join(phrases)}.")
        header = ("Controller", "at standstill ±, µm", "rest", "settles in, ms", "stiffness, N/mm")
        numbers += [Table("At standstill, at the smallest leak", header, standing), Points(AT_REST)]
    sentences = [*_best(content), *sentences]
    base = content.row("limit_cycle_summary", controller=content.baseline)
    warning = rest_warning(content.baseline, base, baseline=True) if base else ""
    return [
        *([Text(warning, "caution")] if warning else []),
        *([Cards(sentences)] if sentences else []),
        *([Fold("The numbers of these sentences", numbers)] if numbers else []),
    ]


def change(ratio: float) -> str:
    """A ratio of errors as a phrase."""
    if ratio >= 2.0:
        return f"{number(ratio)} times the error"
    return f"{number(100.0 * abs(ratio - 1.0), 0)} % {'more' if ratio > 1.0 else 'less'} error"


def _leading(content: Content) -> str:
    """The ratio by which the page judges: with equal weights of references, or of the mean errors."""
    return "equal_weight" if content.has("comparison") else "ratio"


def _best(content: Content) -> list[str]:
    rows = {name: content.against(name) or content.row("ratios", controller=name) for name in content.controllers[1:]}
    ratios = {name: interval(row, _leading(content)) for name, row in rows.items() if row}
    if not ratios:
        return []
    best = min(ratios, key=lambda name: ratios[name].value)
    if verdict(ratios[best]) == "better":
        return [f"{best} positions best: {change(ratios[best].value)} than {content.baseline}."]
    return [f"No controller is clearly better than {content.baseline}."]


def _against_corrected(content: Content) -> tuple[list[str], list[Block]]:
    """A sentence for each policy that corrects another controller than the baseline, and the table of their ratios."""
    pairs = {
        name: base
        for name, base in content.corrects.items()
        if {name, base} <= set(content.controllers) and base != content.baseline
    }
    if not pairs or not content.has("cases"):
        return [], []
    grid, sentences, rows = Grid(content.table("cases")), [], []
    everywhere = np.ones(len(grid.family), dtype=np.bool_), np.ones(len(grid.leak), dtype=np.bool_)
    for name, base in pairs.items():
        row = grid.compare(name, base, *everywhere)
        ratio = interval(row, _leading(content))
        unclear = ", no clear difference" if verdict(ratio) == "same" else ""
        sentences.append(f"{name} against {base}: {change(ratio.value)}{unclear}.")
        ratios = (shown(row, column) for column in ("ratio", "equal_weight", "ratio_sensor"))
        better, costs = number(100.0 * row["share_better"], 0), (number(row[column], 2) for column in COSTS)
        rows.append((name, base, *ratios, better, *costs))
    errors, costs = ("mean error", "equal weights", "repeatability"), (each.word.lower() for each in COSTS.values())
    header = ("Policy", "corrects", *errors, "better in, %", *costs)
    return sentences, [Table("A policy ÷ what it corrects, on the same runs", header, rows, style="dense")]


def at_rest(content: Content) -> list[tuple[str, ...]]:
    """Distance (µm), rest, settling (ms) and stiffness (N/mm) of controllers at standstill, the most accurate first."""
    errors = {name: _mean(content, name, "mean_error_mm") for name in content.controllers}
    rows: list[tuple[str, ...]] = []
    for name in sorted(errors, key=lambda name: errors[name]):
        distance = 1e3 * _mean(content, name, "steady_state_error_sensor_mm")
        if content.has("standstill"):
            noisy = _at_the_smallest(content, "standstill", name)
            distance = math.sqrt((noisy["unrest_um"] ** 2 + noisy["offset_um"] ** 2).mean())
        cycles = content.row("limit_cycle_summary", controller=name)
        settling = 1e3 * _mean(content, name, "settling_time_s")
        pushed = _at_the_smallest(content, "force_step", name)
        cells = (
            number(distance, digits=2) if math.isfinite(distance) else "",
            "does not come to rest" if cycles and not comes_to_rest(cycles) else "",
            number(settling, 0) if math.isfinite(settling) else "",
            stiffness_text(pushed, "peak_mm") if len(pushed) else "",
        )
        rows += [(name, *cells)] if any(cells) else []
    return rows


def _at_the_smallest(content: Content, table: str, name: str) -> pd.DataFrame:
    """The rows of a controller at the smallest leak of a table; empty without the table."""
    rows = content.rows(table, controller=name)
    return rows[rows["leakage_flow_lpm"] == leaks_of(content.table(table))[0]] if len(rows) else rows


def _mean(content: Content, name: str, metric: str) -> float:
    """Mean of a metric at the smallest leak; NaN without one."""
    smallest = next(iter(content.in_groups("leak")), "")
    rows = content.rows("summary", controller=name, condition=smallest)
    if content.has("levels"):
        rows = _at_the_smallest(content, "levels", name)
    means = rows.set_index("metric")["mean"] if len(rows) else pd.Series(dtype=np.float64)
    return float(means.get(metric, math.nan))
