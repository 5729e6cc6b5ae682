"""The tables of the tracking part: means with intervals, worst cases, and ratios to the first controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.running.statistics import (
    conditional_value_at_risk,
    geometric_ratio_interval,
    mean_interval,
    ratio_interval,
)

ERROR = "mean_error_mm"
"""The metric by which controllers are compared."""


def per_plant(frame: pd.DataFrame, metric: str = ERROR) -> NDArray[np.float64]:
    """Mean of a metric for each plant, (plants,)."""
    means: NDArray[np.float64] = frame.groupby("plant")[metric].mean().to_numpy(dtype=np.float64)
    return means


RATIO_COLUMNS = ["controller", "against", "group", "value", "ratio", "low", "high", "share_of_cases_better"]


def summary_table(cases: pd.DataFrame, by: str) -> pd.DataFrame:
    """Every metric per controller and value of the column ``by``."""
    rows = []
    for (controller, group), frame in cases.groupby(["controller", by], sort=False):
        for metric, about in METRICS.items():
            rows.append(
                {
                    "controller": controller,
                    by: group,
                    "metric": metric,
                    "unit": about.unit,
                    **mean_interval(per_plant(frame, metric)).columns("mean"),
                    "worst": float(frame[metric].max()),
                    "cvar_5_percent": conditional_value_at_risk(frame[metric].to_numpy()),
                    "cases": len(frame),
                }
            )
    return pd.DataFrame(rows)


def ratio_table(cases: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Mean error of each controller over that of the first, paired by plant.

    The ratios are over all cases, per level, per family, and over all with equal weight for each family (otherwise
    large steps outweigh the rest).
    """
    rows: list[dict[str, Any]] = []
    base = cases[cases["controller"] == names[0]]
    families = cases["family"].unique()
    for name in names[1:]:
        own, who = cases[cases["controller"] == name], {"controller": name, "against": names[0]}
        parts = [("all", "", own, base)]
        for group, column in (("level", "leakage_flow_lpm"), ("family", "family")):
            for value in cases[column].unique():
                parts.append((group, str(value), own[own[column] == value], base[base[column] == value]))
        for group, label, mine, theirs in parts:
            better = float(np.mean(mine[ERROR].to_numpy() < theirs[ERROR].to_numpy()))
            ratio = ratio_interval(per_plant(mine), per_plant(theirs)).columns("ratio")
            rows.append({**who, "group": group, "value": label, **ratio, "share_of_cases_better": better})
        mine_by_family, theirs_by_family = (
            np.array([per_plant(frame[frame["family"] == family]) for family in families]) for frame in (own, base)
        )
        ratio = geometric_ratio_interval(mine_by_family, theirs_by_family).columns("ratio")
        label = "geometric mean of the families' ratios"
        rows.append({**who, "group": "equal_weight", "value": label, **ratio, "share_of_cases_better": np.nan})
    return pd.DataFrame(rows, columns=RATIO_COLUMNS)
