"""The section and the figure about training: error on validation plants; ``progress.csv`` holds everything else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.canvas import GREY, INK, Plot, curve_plot
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look, looks_of
from hydro_agents.report.sections import Block, section
from hydro_agents.running.seeds import SEED_MARK

LOG_STEPS = "time/total_timesteps"  # column of stable-baselines3's log that is ``steps`` in a curve

ERROR = "validation/mean_error_mm"
BASE_ERROR = "validation/base_mean_error_mm"
"""Error of the controller that is corrected, on the same plants."""

STEPS, TRAINING = " thousand steps", "training, thousand steps"


@section("Training", needs=("training_curve",))
def training(content: Content) -> list[Block]:
    """Error of the policy while it learned."""
    curve, error = content.table("training_curve"), content.other("validation_error_mm", float("nan"))
    return [*learning_plots(curve, content.baseline, error, content.looks)]


def _checked(curve: pd.DataFrame) -> pd.DataFrame:
    """The curve with this project's column names; empty if it has no steps."""
    curve = curve if "steps" in curve else curve.rename(columns={LOG_STEPS: "steps"})
    if "steps" not in curve or curve.empty:
        return pd.DataFrame()
    return curve if "controller" in curve else curve.assign(controller="policy")


def learning_plots(
    curve: pd.DataFrame, baseline: str, baseline_error_mm: float, looks: Mapping[str, Look] | None = None
) -> list[Plot]:
    """Error on validation plants over training, relative to a baseline; empty without a curve or a baseline's error.

    Args:
        curve: column ``steps`` and ERROR, or the columns of stable-baselines3's log; ``controller`` if several were
            trained. Trainings of one controller on several seeds are named NAME#0, NAME#1, …;
            the line is their median, the band their range. A correction is compared with the controller that it
            corrects as well, if BASE_ERROR is known.
        baseline: name of the controller to which errors are relative.
        baseline_error_mm: its mean error on the same plants.
        looks: of the controllers in the other figures of the page; default: by their order here.
    """
    curve = _checked(curve)
    if ERROR not in curve or not np.isfinite(baseline_error_mm):
        return []
    curve = curve.dropna(subset=[ERROR])
    names = curve["controller"].str.partition(SEED_MARK)[0]
    steps, ratio = curve["steps"] / 1e3, curve[ERROR] / baseline_error_mm
    curves = {
        name: ratio[names == name].groupby(steps).agg(value="median", low="min", high="max") for name in names.unique()
    }
    looks = looks_of([baseline, *curves]) | dict(looks or {})
    corrected = (curve[BASE_ERROR].dropna() / baseline_error_mm).unique() if BASE_ERROR in curve else np.array([])

    def finish(axes: Axes) -> None:
        if len(corrected):  # a correction is small: the scale does not begin at zero
            axes.hlines(corrected, 0.0, steps.max(), color=GREY, linestyle=":", label="corrected controller")
        else:
            axes.axhline(1.0, color=INK, linewidth=1.0, label=baseline)
            late = (own["high"].iloc[min(1, len(own) - 1) :].max() for own in curves.values())
            axes.set_ylim(0.0, 1.1 * max(1.0, *late))
        axes.set_xlim(left=0.0)

    note = (
        f"Mean error on validation plants over that of {baseline} on the same plants; no policy is trained on them. "
        "Line: median of the training seeds; band: from the lowest to the highest. Dotted: the controller that is "
        "corrected; then the scale does not begin at zero."
    )
    named = ("learning", f"Error while learning, against {baseline}", note)
    labels: dict[str, Any] = {"xlabel": TRAINING, "ylabel": f"error ÷ error of {baseline}"}
    return [curve_plot(*named, curves, looks, "", finish, STEPS, drawn="band", **labels)]
