"""The section and the figures about training: reward, error on validation plants, measures of the policy's updates."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydro_agents.report.canvas import GREY, INK, Plot, add_legend, description, make_plot, one_panel
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look, looks_of
from hydro_agents.report.sections import Block, Fold, section
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.text import number

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

DISCARDED = 0.05
"""First share of the training, which does not set the scale: values of the untrained policy would flatten the rest."""

NOTE = (
    "Reward, on training plants: higher is better, zero would be perfect tracking without effort. Errors, on "
    "validation plants: lower is better; no policy is trained on them. KL divergence: change of the policy per update. "
    "Explained variance: quality of the value function's prediction, 1 is best. The scale is that of the values after "
    f"the first {100.0 * DISCARDED:.0f} % of the training."
)


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
    factor, unit = _unit(curve)
    names = curve["controller"].str.partition(SEED_MARK)[0]
    steps, ratio = curve["steps"] / factor, curve[ERROR] / baseline_error_mm
    bands = {name: ratio[names == name].groupby(steps).agg(["median", "min", "max"]) for name in names.unique()}
    seeds = curve["controller"].groupby(names).nunique().max()
    looks = looks_of([baseline, *bands]) | dict(looks or {})
    corrected = (curve[BASE_ERROR].dropna() / baseline_error_mm).unique() if BASE_ERROR in curve else np.array([])

    def paint(axes: Axes) -> None:
        for name, band in bands.items():
            look = looks[name]
            axes.fill_between(band.index, band["min"], band["max"], color=look.colour, alpha=0.2, linewidth=0)
            axes.plot(band.index, band["median"], label=name, marker=look.marker, **look.stroke)
        if len(corrected):  # a correction is small: the scale does not begin at zero
            axes.hlines(corrected, 0.0, steps.max(), color=GREY, linestyle=":", label="corrected controller")
        else:
            axes.axhline(1.0, color=INK, linewidth=1.0, label=baseline)
            later = [band["max"].iloc[min(1, len(band) - 1) :].max() for band in bands.values()]
            axes.set_ylim(0.0, 1.1 * max(1.0, *later))
        axes.set(xlabel=f"training, {unit}", ylabel=f"error ÷ error of {baseline}")
        axes.set_xlim(left=0.0)

    note = f"Mean error on validation plants over that of {baseline} on the same plants; no policy is trained on them."
    if seeds > 1:
        note += f" Line: median of {seeds} training seeds; band: from the lowest to the highest."
    if len(corrected):
        note += " Dotted: the controller that is corrected. The scale does not begin at zero."
    ends = {name: band["median"].iloc[[0, -1]].items() for name, band in bands.items()}
    rows = {name: [(f"after {number(x)} {unit}", y) for x, y in both] for name, both in ends.items()}
    title = f"Error while learning, against {baseline}"
    return [one_panel("learning", title, note, description(title, rows, ""), paint)]


def training_plots(curve: pd.DataFrame, looks: Mapping[str, Look] | None = None) -> list[Plot]:
    """The figure of a training curve or log, a panel for each of its columns; none without a curve.

    Args:
        curve: column ``steps`` and any of ``mean_reward``, ``validation/…_mm`` and the columns of UPDATES, or the
            columns of stable-baselines3's log; ``controller`` if several were trained.
        looks: of the controllers in the other figures of the page; default: by their order here.
    """
    curve = _checked(curve)
    errors = [name for name in curve if re.fullmatch(r"validation/\w+_mm", name)]
    words = {name: f"{name[11:-3].replace('_', ' ')}, mm" for name in errors}
    panels = {"mean_reward": "mean reward", **words, **UPDATES}
    panels = {name: text for name, text in panels.items() if name in curve and curve[name].notna().any()}
    if not panels:
        return []
    factor, unit = _unit(curve)
    names = curve["controller"].unique()
    looks = looks_of(names) | dict(looks or {})
    by_name = curve.set_index(["controller", "steps"])
    lines = {(column, name): by_name.loc[name, column].dropna() for column in panels for name in names}

    def paint(figure: Figure) -> None:
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (column, words) in zip(rows, panels.items(), strict=True):
            for name in names:
                line = lines[column, name]
                axes.plot(line.index / factor, line, label=name, linewidth=1.2, **looks[name].stroke)
            late = curve[curve["steps"] > DISCARDED * curve["steps"].max()][column].dropna()
            if len(late) > 1:
                room = 0.08 * np.ptp(late) or 0.05 * abs(late.iloc[0]) or 1.0
                axes.set_ylim(late.min() - room, late.max() + room)
            axes.set_ylabel(words.replace(" of ", "\nof "), fontsize=8.0)
        rows[-1].set_xlabel(f"training, {unit}")
        rows[-1].set_xlim(left=0.0)
        if len(names) > 1:
            add_legend(rows[0])

    ends = {
        f"{panels[column]} of {name}": [("from", line.iloc[0]), ("to", line.iloc[-1])]
        for (column, name), line in lines.items()
        if len(line)
    }
    title = "Reward, errors and updates of the policy"
    return [make_plot("training", title, NOTE, description(title, ends, ""), paint, max(3.0, 1.0 + 1.4 * len(panels)))]


def _unit(curve: pd.DataFrame) -> tuple[float, str]:
    return (1e6, "million steps") if curve["steps"].max() >= 1e6 else (1e3, "thousand steps")
