"""Repeats the worst cases of every controller with their traces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.report.report import Example
from hydro_agents.report.robustness_record import Trace
from hydro_agents.report.text import family_name, number, setting
from hydro_agents.running.cases import Rollout

Replay = Callable[[Mapping[str, Any]], Rollout]
"""Runs one case again; its argument has the columns of ``cases``."""

CASE = ["condition", "family", "leakage_flow_lpm", "seed"]
"""Columns that identify a case."""


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
    columns = [*CASE, "controller", "training_seed", "mean_error_mm"]
    errors = cases[columns]
    errors = errors[errors["mean_error_mm"] > 0.0]
    base = errors[errors["controller"] == baseline]
    others = errors[errors["controller"] != baseline]
    best = others.loc[others.groupby(CASE)["mean_error_mm"].idxmin()]
    rivals = {"controller": "rival", "training_seed": "rival_seed", "mean_error_mm": "rival_error_mm"}
    paired = [others.merge(base.rename(columns=rivals), on=CASE), base.merge(best.rename(columns=rivals), on=CASE)]
    table = pd.concat(paired, ignore_index=True)
    table["ratio"] = table["mean_error_mm"] / table["rival_error_mm"]
    table = table[table["ratio"] > 1.0].sort_values("ratio", ascending=False, kind="stable")
    table = table.drop_duplicates(["controller", "condition"])  # a condition shows its worst case only
    table["rank"] = table.groupby("controller").cumcount() + 1
    table = table[table["rank"] <= count]
    order = [*others["controller"].unique(), baseline]
    return table.sort_values("controller", key=lambda names: names.map(order.index), kind="stable")


def worst_traces(
    replay: Replay,
    cases: pd.DataFrame,
    baseline: str,
    label: Callable[[str], str] = str,
    preview: float = 0.0,
    count: int = 2,
) -> list[Trace]:
    """Run the worst cases of every controller again, each with its rival (see :func:`worst_rows`).

    Args:
        replay: runs one case.
        cases: table ``cases`` of the protocol.
        baseline: its baseline.
        label: text of a condition.
        preview: s; the observation shows the reference this far ahead, which matters at steps.
        count: number of cases per controller.
    """
    traces = []
    for row in worst_rows(cases, baseline, count).to_dict("records"):
        case = {str(key): value for key, value in row.items()}
        name, rival = str(case["controller"]), str(case["rival"])
        runs = {name: replay(case)}
        runs[rival] = replay({**case, "controller": rival, "training_seed": case["rival_seed"]})
        where, one = label(str(case["condition"])), runs[name]
        leak = "" if "l/min" in where else f", leak of {setting(case['leakage_flow_lpm'])} l/min"
        title = (
            f"Worst case {case['rank']} of {name}: {number(float(case['ratio']))} times the error of {rival} "
            f"({where}, {family_name(str(case['family']))}{leak}, seed {case['seed']})"
        )
        example = Example(
            title=title,
            time=one.time,
            reference=one.reference[0],
            position={who: np.asarray(run.position[0]) for who, run in runs.items()},
            command={who: np.asarray(run.command[0]) for who, run in runs.items()},
            preview=preview if case["family"] == "step" else 0.0,
        )
        traces.append(Trace(name, rival, float(case["ratio"]), example))
    return traces
