"""The tables of a study's evaluation: means with intervals, worst cases, ratios to the first controller, detection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.detection import detection_curves, detection_rates, detection_summary
from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.evaluation.runner import Results, table
from hydro_agents.running.statistics import conditional_value_at_risk

KIND = "study"
RATIO_COLUMNS = ["controller", "against", "group", "value", "ratio", "low", "high", "share_of_cases_better"]


@table("cases", KIND)
def cases(results: Results) -> pd.DataFrame:
    """One row per controller, level, family and plant."""
    rows = results.part("tracking")
    return rows[["leakage_flow_lpm", "family", "plant", "controller", "seed", *METRICS]]


@table("levels", KIND)
def levels(results: Results) -> pd.DataFrame:
    """Every metric per controller and leak level."""
    return summary_table(results.part("tracking"), "leakage_flow_lpm")


@table("families", KIND)
def families(results: Results) -> pd.DataFrame:
    """Every metric per controller and family of references."""
    return summary_table(results.part("tracking"), "family")


@table("ratios", KIND)
def ratios(results: Results) -> pd.DataFrame:
    """Mean error of every controller over that of the first."""
    return ratio_table(results.part("tracking"), results.grid.controllers)


@table("detection_rates", KIND)
def rates(results: Results) -> pd.DataFrame:
    """Share of episodes flagged, by class and size of the leak."""
    episodes = results.part("episodes")
    return episodes if episodes.empty else detection_rates(episodes, results.protocol.task)


@table("detection_summary", KIND)
def detection(results: Results) -> pd.DataFrame:
    """Areas under the curves, rates, and errors of the size, per controller."""
    episodes, head = results.part("episodes"), results.participants.head
    return episodes if episodes.empty else detection_summary(episodes, head.settings.threshold, results.protocol.task)


@table("curves", KIND)
def curves(results: Results) -> pd.DataFrame:
    """ROC, and precision over recall, per controller."""
    episodes = results.part("episodes")
    return episodes if episodes.empty else detection_curves(episodes, results.protocol.task)


def summary_table(cases: pd.DataFrame, by: str) -> pd.DataFrame:
    """Every metric per controller and value of the column ``by``: mean with interval, worst case, mean of the worst."""
    grid, rows = Grid(cases), []
    for (controller, group), frame in cases.groupby(["controller", by], sort=False):
        plants = grid.family == group if by == "family" else np.ones(len(grid.family), dtype=np.bool_)
        situations = grid.leak == group if by != "family" else np.ones(len(grid.leak), dtype=np.bool_)
        for metric, about in METRICS.items():
            rows.append(
                {
                    "controller": controller,
                    by: group,
                    "metric": metric,
                    "unit": about.unit,
                    **grid.mean(controller, metric, plants, situations).columns("mean"),
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
    grid, rows = Grid(cases), []
    plants, leaks = np.ones(len(grid.family), dtype=np.bool_), np.ones(len(grid.leak), dtype=np.bool_)
    parts = [("all", "", plants, leaks)]
    parts += [("level", str(leak), plants, grid.leak == leak) for leak in cases["leakage_flow_lpm"].unique()]
    parts += [("family", str(family), grid.family == family, leaks) for family in cases["family"].unique()]
    for name in names[1:]:
        found = [grid.compare(name, names[0], *part) for _, _, *part in parts]
        for (group, value, *_), row in zip(parts, found, strict=True):
            figures = [row[column] for column in ("ratio", "ratio_low", "ratio_high", "share_better")]
            rows.append((name, names[0], group, value, *figures))
        equal = [found[0][column] for column in ("equal_weight", "equal_weight_low", "equal_weight_high")]
        rows.append((name, names[0], "equal_weight", "geometric mean of the families' ratios", *equal, np.nan))
    return pd.DataFrame(rows, columns=RATIO_COLUMNS)
