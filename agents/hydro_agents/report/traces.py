"""Single runs: the worst cases of every controller, run again with their rivals, and figures of runs over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.report.canvas import INK, Plot
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look
from hydro_agents.report.recorded import Line, Signal, course_plot
from hydro_agents.running.cases import Rollout
from hydro_agents.running.text import capitalised, family_name, number, setting
from hydro_env.types import Floats

Replay = Callable[[Mapping[str, Any]], Rollout]
"""Runs one case again; its argument has the columns of ``cases``."""

CASE = ["condition", "family", "leakage_flow_lpm", "seed"]
"""Columns that identify a case."""

LEAK_GROUPS = ("leak", "leak_law", "schedule")
"""Groups of conditions whose label says the leak."""


@dataclass(frozen=True)
class Example:
    """One test episode under every controller. Arrays (T,)."""

    title: str
    time: Floats  # s
    reference: Floats  # m
    position: dict[str, Floats]  # controller → m
    command: dict[str, Floats]  # controller → fraction of 10 V
    leak: float = 0.0  # l/min at 100 bar


def worst_rows(cases: pd.DataFrame, baseline: str, count: int = 2) -> pd.DataFrame:
    """The cases in which every controller has its largest ratio of errors, from different conditions.

    The rival of a controller is the baseline; the rival of the baseline is the controller with the smallest error in
    the case. With several training seeds, the worst seed counts.

    Args:
        cases: table ``cases`` of the protocol.
        baseline: its baseline.
        count: number of cases per controller.

    Returns:
        Rows of ``cases`` with rank, rival, rival_seed and ratio; those of the baseline come last.
    """
    errors = cases[[*CASE, "controller", "training_seed", "mean_error_mm"]]
    errors = errors[errors["mean_error_mm"] > 0.0]
    is_base = errors["controller"] == baseline
    base, others = errors[is_base], errors[~is_base]
    best = others.loc[others.groupby(CASE)["mean_error_mm"].idxmin()]
    rivals = {"controller": "rival", "training_seed": "rival_seed", "mean_error_mm": "rival_error_mm"}
    paired = [others.merge(base.rename(columns=rivals), on=CASE), base.merge(best.rename(columns=rivals), on=CASE)]
    table = pd.concat(paired, ignore_index=True)
    table["ratio"] = table["mean_error_mm"] / table["rival_error_mm"]
    table = table[table["ratio"] > 1.0].sort_values("ratio", ascending=False, kind="stable")
    table = table.drop_duplicates(["controller", "condition"])  # a condition shows its worst case only
    table["rank"] = table.groupby("controller").cumcount() + 1
    order = [*others["controller"].unique(), baseline]
    worst = table[table["rank"] <= count]
    return worst.sort_values("controller", key=lambda names: names.map(order.index), kind="stable")


def with_traces(content: Content, replay: Replay, count: int = 2) -> Content:
    """The content with the worst cases of every controller, each run again with its rival (see :func:`worst_rows`).

    Args:
        content: with the table ``cases`` of the protocol.
        replay: runs one case.
        count: number of cases per controller.
    """
    if len(content.controllers) < 2:
        return content
    traces = []
    for case in worst_rows(content.table("cases"), content.baseline, count).to_dict("records"):
        name, rival = case["controller"], case["rival"]
        runs = {name: replay(case)}
        runs[rival] = replay({**case, "controller": rival, "training_seed": case["rival_seed"]})
        where = [content.label(case["condition"]), family_name(case["family"]), f"seed {case['seed']}"]
        if case["condition"] not in content.in_groups(*LEAK_GROUPS):
            where.insert(2, f"leak of {setting(case['leakage_flow_lpm'])} l/min")
        times = f"{number(case['ratio'])} times the error of {rival}"
        example = Example(
            title=f"Worst case {case['rank']} of {name}: {times} ({', '.join(where)})",
            time=runs[name].time,
            reference=runs[name].reference[0],
            position={who: np.asarray(run.position[0]) for who, run in runs.items()},
            command={who: np.asarray(run.command[0]) for who, run in runs.items()},
        )
        traces.append(example)
    return replace(content, others={**content.others, "traces": traces})


def example_plot(example: Example, key: str, looks: Mapping[str, Look]) -> Plot:
    """Position and reference, error in mm, command in V of one episode under every controller.

    Args:
        example: the episode.
        key: name of the figure.
        looks: of the controllers.
    """
    time, reference = example.time, example.reference
    error = {name: 1e3 * (reference - position) for name, position in example.position.items()}
    positions = {"reference": reference, **example.position}
    signals = [
        Signal("position, mm", {name: Line(time, 1e3 * values) for name, values in positions.items()}),
        Signal("error, mm", {name: Line(time, values) for name, values in error.items()}),
        Signal("command, V", {name: Line(time, 10.0 * values) for name, values in example.command.items()}),
    ]
    means = (f"{name} {number(float(np.mean(np.abs(values))))} mm" for name, values in error.items())
    note = (
        f"Mean error of this run: {', '.join(means)}. A controller that sees the reference ahead may start before a "
        "step."
    )
    alt = f"Position, error and valve command over time: {example.title}. {note}"
    with_reference = {**looks, "reference": Look(INK, "", "-")}
    return course_plot(key, capitalised(example.title), note, alt, signals, 4.6, with_reference)
