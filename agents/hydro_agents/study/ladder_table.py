"""The table of a ladder: one row per rung, ratios to the first controller, mean and spread over training seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from hydro_agents.evaluation.metrics import ERROR, METRICS
from hydro_agents.running.text import markdown


def rung_scores(
    name: str, seed: int, corrects: str | None, cases: pd.DataFrame, classical: Mapping[str, pd.DataFrame]
) -> pd.DataFrame:
    """One row: a training's figures as ratios to the first controller's on the same cases.

    Args:
        name: name of the rung.
        seed: seed of the training; −1 for a controller that is not trained.
        corrects: name of the controller that it corrects.
        cases: its metrics, one row per case.
        classical: the metrics of the classical controllers, by name.
    """
    reference = next(iter(classical.values()))
    row: dict[str, float | str] = {"rung": name, "seed": seed}
    row["mean"], row["geo"] = ratios(cases, reference)
    corrected = ratios(cases, classical[corrects]) if corrects is not None else (math.nan, math.nan)
    row["mean to corrected"], row["geo to corrected"] = corrected
    for group in ("family", "leakage_flow_lpm"):
        for value, errors in cases.groupby(group, sort=False)[ERROR]:
            label = f"{value:g} l/min" if group != "family" else str(value)
            row[label] = errors.mean() / reference.loc[reference[group] == value, ERROR].mean()
    row["worst case"] = float(np.max(cases[ERROR].to_numpy() / reference[ERROR].to_numpy()))
    for metric in METRICS.values():
        if metric.ratio and metric.name in cases and metric.name in reference:
            there = float(reference[metric.name].mean())
            row[metric.ratio] = float(cases[metric.name].mean()) / there if there > 0.0 else math.nan
    row["failed"] = cases["failed"].sum()
    row["seconds"] = float(cases["seconds"].iloc[0]) if "seconds" in cases else float("nan")
    return pd.DataFrame([row])


def ratios(cases: pd.DataFrame, reference: pd.DataFrame) -> tuple[float, float]:
    """Ratio of the mean errors over all cases, and the geometric mean of the families' ratios."""
    families = cases.groupby("family")[ERROR].mean() / reference.groupby("family")[ERROR].mean()
    return float(cases[ERROR].mean() / reference[ERROR].mean()), float(np.exp(np.log(families).mean()))


def ladder_table(scores: pd.DataFrame, order: Sequence[str], reference: str) -> tuple[str, pd.DataFrame]:
    """The ladder as Markdown, and as a table of means and standard deviations over seeds.

    Args:
        scores: rows of :func:`rung_scores`.
        order: names of the rungs from top to bottom; those without scores are left out.
        reference: name of the controller for all comparisons.
    """
    figures = [name for name in scores.columns if name not in ("rung", "seed")]
    rows, lines = [], []
    for name in order:
        own = scores[scores["rung"] == name]
        if own.empty:
            continue
        means, spread = own[figures].mean(), own[figures].std(ddof=1)
        seeds = int((own["seed"] >= 0).sum())
        rows.append(
            {"rung": name, "seeds": seeds, **means.to_dict(), **{f"{k} sd": v for k, v in spread.to_dict().items()}}
        )
        cells = [name, str(seeds or "–"), *(_cell(means[figure], spread[figure], figure) for figure in figures)]
        lines.append(cells)
    costs = ", ".join(metric.word.lower() for metric in METRICS.values() if metric.cost and metric.ratio)
    note = (
        f"Ratios to {reference} on the same cases: mean error over all cases; geo, the geometric mean of the families' "
        "ratios; then each family and each leak. Worst case: largest ratio of a single case. Offset at standstill, "
        f"{costs}: ratios of means. ±: standard deviation over training seeds.\n\n"
    )
    return f"{note}{markdown(['rung', 'seeds', *figures], lines)}\n", pd.DataFrame(rows)


def _cell(mean: float, spread: float, figure: str) -> str:
    if np.isnan(mean):
        return "–"
    if figure in ("seconds", "failed"):
        return f"{mean:.0f}" if mean == round(mean) or figure == "seconds" else f"{mean:.1f}"
    return f"{mean:.2f}" if np.isnan(spread) or figure not in ("mean", "geo") else f"{mean:.3f} ± {spread:.3f}"
