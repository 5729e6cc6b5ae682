"""Findings that users ask for on every page: a policy against what it corrects, and the axis at standstill."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.limit_cycles import comes_to_rest
from hydro_agents.evaluation.metrics import COMPARED, METRICS
from hydro_agents.report.content import Content, interval, interval_text, verdict
from hydro_agents.report.experiments import leaks_of, stiffness_text
from hydro_agents.report.sections import Finding
from hydro_agents.running.text import listed, number


def change(ratio: float) -> str:
    """A ratio of errors as a phrase."""
    if ratio >= 2.0:
        return f"{number(ratio)} times the error"
    return f"{number(100.0 * abs(ratio - 1.0), 0)} % {'more' if ratio > 1.0 else 'less'} error"


def against_corrected(content: Content) -> list[Finding]:
    """Each policy against the controller that it corrects, with the ratio that the page uses for the baseline."""
    leading = "equal_weight" if content.has("comparison") else "ratio"
    pairs = {
        name: base
        for name, base in content.corrects.items()
        if {name, base} <= set(content.controllers) and base != content.baseline and content.has("cases")
    }
    if not pairs:
        return []
    grid, findings = Grid(content.table("cases")), []
    everywhere = np.ones(len(grid.family), dtype=np.bool_), np.ones(len(grid.leak), dtype=np.bool_)
    for name, base in pairs.items():
        row = grid.compare(name, base, *everywhere)
        whole = interval(row, leading)
        lead = {
            "better": f"{name} improves {base}: {change(whole.value)}.",
            "worse": f"{name} makes {base} worse: {change(whole.value)}.",
            "same": f"{name} against {base}: no clear difference ({number(whole.value)} times the error).",
        }[verdict(whole)]
        costs = [
            f"{metric.word.lower()} {number(row[column], 2)} ×"
            for column, metric in COMPARED.items()
            if metric.cost and math.isfinite(row[column])
        ]
        plain, equal, sensed = (
            interval_text(interval(row, each)) for each in ("ratio", "equal_weight", "ratio_sensor")
        )
        text = (
            f"Mean error over that of {base} on the same runs: {plain}; with equal weights of the kinds of reference "
            f"{equal}, in the frame of the sensor {sensed}. Better in {number(100.0 * row['share_better'], 0)} % of "
            "the runs."
        )
        findings.append(Finding(lead, text + (f" Its cost relative to {base}: {listed(costs)}." if costs else "")))
    return findings


def held(content: Content) -> list[Finding]:
    """Rest, settling and stiffness of each controller at the smallest leak, the most accurate one first."""
    errors = {name: _mean(content, name, "mean_error_mm") for name in content.controllers}
    ranked = sorted(errors, key=lambda name: errors[name])
    lines = [f"{name}: {', '.join(parts)}." for name in ranked if (parts := _held(content, name))]
    if not lines:
        return []
    rest = "mean distance of the reading, without noise, from the reference at the end of a standstill"
    if content.has("standstill"):
        rest = "root mean square distance of the reading from the reference, which sensor noise causes too"
    about = [
        "All at the smallest leak.",
        f"At standstill: {rest}.",
        f"Settles: {METRICS['settling_time_s'].meaning}; standstills on which it never settles do not count.",
        *(["Stiffness: force ÷ largest deviation after a sudden force."] if content.has("force_step") else []),
    ]
    return [Finding(lines[0], " ".join([*lines[1:], *about]))]


def _held(content: Content, name: str) -> list[str]:
    """What one controller does at standstill, as phrases."""
    parts = []
    rest = 1e3 * _mean(content, name, "steady_state_error_sensor_mm")
    if content.has("standstill"):
        own = _at_the_smallest(content, "standstill", name)
        rest = math.sqrt(float((own["unrest_um"] ** 2 + own["offset_um"] ** 2).mean()))
    if math.isfinite(rest):
        parts.append(f"at standstill ± {number(rest, digits=2)} µm")
    cycles = content.row("limit_cycle_summary", controller=name)
    if cycles and not comes_to_rest(cycles):
        parts.append("does not come to rest everywhere")
    settling = _mean(content, name, "settling_time_s")
    if math.isfinite(settling):
        parts.append(f"settles in {number(1e3 * settling, 0)} ms")
    if content.has("force_step"):
        pushed = _at_the_smallest(content, "force_step", name)
        parts += [f"stiffness {stiffness_text(pushed, 'peak_mm')} N/mm"] if len(pushed) else []
    return parts


def _at_the_smallest(content: Content, table: str, name: str) -> pd.DataFrame:
    """The rows of a controller at the smallest leak of a table."""
    return content.rows(table, controller=name, leakage_flow_lpm=leaks_of(content.table(table))[0])


def _mean(content: Content, name: str, metric: str) -> float:
    """Mean of a metric at the smallest leak; NaN without one."""
    if content.has("levels"):
        rows = _at_the_smallest(content, "levels", name)
        found = rows[rows["metric"] == metric]
    else:
        smallest = next(iter(content.in_groups("leak")), "")
        found = content.rows("summary", controller=name, metric=metric, condition=smallest)
    return float(found["mean"].iloc[0]) if len(found) else math.nan
