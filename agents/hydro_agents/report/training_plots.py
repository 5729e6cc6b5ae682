"""The section and the figures about training: reward, error on validation plants, measures of the policy's updates."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.canvas import GREY, INK, Plot, curve_plot
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look, looks_of
from hydro_agents.report.sections import Block, Fold, section
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.text import capitalised

LOG_NAMES = {"time/total_timesteps": "steps", "rollout/mean_reward": "mean_reward"}
"""Columns of stable-baselines3's log with other names in the training curve."""

UPDATES = {
    "train/approx_kl": "approximate KL divergence",
    "train/explained_variance": "explained variance of the value function",
    "train/entropy_loss": "entropy loss",
    "train/loss": "total loss",
}
ERROR = "validation/mean_error_mm"
BASE_ERROR = "validation/base_mean_error_mm"
"""Error of the controller that is corrected, on the same plants."""

STEPS, TRAINING = " thousand steps", "training, thousand steps"

DISCARDED = 0.05
"""First share of the training, which the figures of its measures leave out: an untrained policy sets no scale."""

NOTES = {
    "mean_reward": "On training plants; higher is better, zero would be perfect tracking without effort.",
    "train/approx_kl": "Change of the policy per update.",
    "train/explained_variance": "Quality of the value function's prediction; 1 is best.",
    "error": "On validation plants; lower is better. No policy is trained on them.",
}


@section("Training", needs=("training_curve",))
def training(content: Content) -> list[Block]:
    """Error, reward and updates of the policy while it learned."""
    curve, error = content.table("training_curve"), content.other("validation_error_mm", float("nan"))
    learning: list[Block] = [*learning_plots(curve, content.baseline, error, content.looks)]
    plots = training_plots(curve, content.looks)
    return [*learning, Fold("More of the training", plots, not learning)] if plots else learning


def _checked(curve: pd.DataFrame) -> pd.DataFrame:
    """The curve with this project's column names; empty if it has no steps."""
    curve = curve.rename(columns={old: new for old, new in LOG_NAMES.items() if new not in curve})
    if "steps" not in curve or curve.empty:
        return pd.DataFrame()
    return curve if "controller" in curve else curve.assign(controller="policy")


def learning_plots(
    curve: pd.DataFrame, baseline: str, baseline_error_mm: float, looks: Mapping[str, Look] | None = None
) -> list[Plot]:
    """Error on validation plants over training, relative to a baseline; empty without a curve or a baseline's error.

    Args:
        curve: as for :func:`training_plots`. Trainings of one controller on several seeds are named NAME#0, NAME#1, …;
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


def training_plots(curve: pd.DataFrame, looks: Mapping[str, Look] | None = None) -> list[Plot]:
    """A figure for each column of a training curve or log; none without a curve.

    Args:
        curve: column ``steps`` and any of ``mean_reward``, ``validation/…_mm`` and the columns of UPDATES, or the
            columns of stable-baselines3's log; ``controller`` if several were trained.
        looks: of the controllers in the other figures of the page; default: by their order here.
    """
    curve = _checked(curve)
    errors = {
        name: f"{name[11:-3].replace('_', ' ')}, mm" for name in curve if re.fullmatch(r"validation/\w+_mm", name)
    }
    looks = looks_of(curve["controller"].unique() if len(curve) else ()) | dict(looks or {})
    plots = []
    for column, text in {"mean_reward": "mean reward", **errors, **UPDATES}.items():
        known = curve.dropna(subset=[column]) if column in curve else curve.iloc[:0]
        known = known[known["steps"] >= DISCARDED * curve["steps"].max()] if len(known) else known
        if known.empty:
            continue
        parts = known.set_index(known["steps"] / 1e3).groupby("controller", sort=False)[column]
        note = NOTES.get("error" if column in errors else column, "")
        key = "training-" + column.replace("/", "-")
        named = (key, capitalised(text.removesuffix(", mm")), note)
        labels: dict[str, Any] = {"xlabel": TRAINING, "ylabel": text}
        plots.append(curve_plot(*named, dict(list(parts)), looks, "", per=STEPS, drawn="plain", **labels))
    return plots
