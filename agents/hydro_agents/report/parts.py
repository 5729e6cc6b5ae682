"""Parts of several pages: who is best, what did not run, how policies learned, facts of the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.metrics import COMPARED
from hydro_agents.report.kit import GREY, INK, Page, draw, panel, with_interval
from hydro_agents.running.limit_cycles import comes_to_rest
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.text import duration, number

COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of a comparison with what a small error may cost."""

LOG_STEPS = "time/total_timesteps"  # column of stable-baselines3's log that is ``steps`` in a curve

ERROR = "validation/mean_error_mm"
BASE_ERROR = "validation/base_mean_error_mm"
"""Error of the controller that is corrected, on the same plants."""


def best(page: Page, baseline: str, ratios: pd.DataFrame, column: str, at_rest: pd.DataFrame) -> None:
    """The controller that is clearly better than the baseline, if there is one; a baseline that does not come to rest.

    Args:
        page: to which this is added.
        baseline: the controller of the comparison.
        ratios: one row per other controller, with the interval of ``column``.
        column: ratio of errors.
        at_rest: the counts of limit cycles (:func:`~hydro_agents.running.limit_cycles.counted`), if there are any.
    """
    for row in at_rest[at_rest.get("controller") == baseline].to_dict("records") if len(at_rest) else ():
        if not comes_to_rest(row):
            page.text(
                f"{baseline} does not come to rest: ratios to it compare with a controller in this state.", "caution"
            )
    if ratios.empty:
        return
    first = ratios.sort_values(column).iloc[0]
    if first.get(f"{column}_high", first.get("high", np.nan)) < 1.0:
        share = number(100.0 * first[column], 0)
        page.verdict(f"{first['controller']} positions best: {share} % of the error of {baseline}.", "good")
    else:
        page.verdict(f"No controller is clearly better than {baseline}.", "doubtful")


def corrections(page: Page, table: pd.DataFrame) -> None:
    """Each policy that corrects another controller than the baseline, against this controller."""
    if table.empty:
        return
    names = {"ratio": "mean error", "equal_weight": "equal weights", "ratio_sensor": "repeatability"}
    frame = pd.DataFrame({"policy": table["controller"], "corrects": table["against"]})
    for column, name in names.items():
        frame[name] = with_interval(table, column)
    frame["better in, %"] = 100.0 * table["share_better"]
    for column, metric in COSTS.items():
        frame[metric.word.lower()] = table[column]
    page.table(frame.set_index("policy"), "A policy ÷ what it corrects, on the same runs", {"better in, %": 0})


def problems(page: Page, status: pd.DataFrame, who: str, labels: Mapping[str, str]) -> None:
    """What failed or did not apply."""
    left_out = status[status["status"].isin(["failed", "not applicable"])] if len(status) else status
    if left_out.empty:
        return
    table = pd.DataFrame({who: left_out[who], "under": left_out["condition"].map(lambda name: labels.get(name, name))})
    table["reason"] = left_out["message"]
    with page.fold("Some parts did not run", opened=(left_out["status"] == "failed").any()):
        page.table(table.set_index(who), words=True)


def learning(page: Page, curve: pd.DataFrame, baseline: str, error_mm: float, names: Sequence[str]) -> None:
    """Error on validation plants over training; nothing without a curve or the error of the baseline (mm)."""
    if ERROR in curve and np.isfinite(error_mm):
        page.heading("Training")
        note = (
            "On validation plants; no policy is trained on them. Line: median of the training seeds; bars: their range."
        )
        page.figure(
            learning_axes(curve, baseline, error_mm, names), f"Error while learning, over that of {baseline}", note
        )


def learning_axes(curve: pd.DataFrame, baseline: str, error_mm: float, names: Sequence[str] = ()) -> Axes:
    """Error on validation plants over training, relative to a baseline.

    Args:
        curve: ERROR, ``steps`` or LOG_STEPS, and ``controller`` if several were trained. Trainings of one controller on
            several seeds are named NAME#0, NAME#1, …; the line is their median, the bars their range. A correction is
            compared with the controller that it corrects as well, if BASE_ERROR is known.
        baseline: name of the controller to which errors are relative.
        error_mm: its mean error on the same plants.
        names: of the controllers in the other figures of the page.
    """
    curve = (curve if "steps" in curve else curve.rename(columns={LOG_STEPS: "steps"})).dropna(subset=[ERROR])
    trained = curve["controller"].str.partition(SEED_MARK)[0] if "controller" in curve else "policy"
    curve = curve.assign(controller=trained, steps=curve["steps"] / 1e3, ratio=curve[ERROR] / error_mm)
    spread = curve.groupby(["controller", "steps"], sort=False)["ratio"].agg(ratio="median", low="min", high="max")
    axes = panel(xlabel="training, thousand steps", ylabel=f"error ÷ error of {baseline}")
    participants = list(dict.fromkeys([baseline, *names, *curve["controller"]]))
    draw(axes, spread.reset_index(), "steps", "ratio", participants)
    axes.axhline(1.0, color=INK, linewidth=1.0, label=baseline)
    if BASE_ERROR in curve:
        for corrected in (curve[BASE_ERROR].dropna() / error_mm).unique():
            axes.axhline(corrected, color=GREY, linestyle=":", label="corrected controller")
    else:
        later = spread["high"].groupby(level=0).nth[1:]
        axes.set_ylim(0.0, 1.1 * max([1.0, *later]))
    return axes


def run_facts(page: Page, facts: Mapping[str, Any], timings: Mapping[str, float], configuration: str = "") -> None:
    """Facts, durations and settings of the run."""
    page.heading("This run")
    rows = {**facts, **{f"time to {phase}": duration(seconds) for phase, seconds in timings.items()}}
    page.table(pd.DataFrame({"value": pd.Series(rows, dtype=object)}), words=True)
    if configuration:
        with page.fold("Configuration"):
            page.code(configuration)
