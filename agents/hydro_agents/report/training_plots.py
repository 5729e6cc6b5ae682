"""The section and the figures about training: reward, error on validation plants, measures of the policy's updates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

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

CLOSE = 1.3
"""Curves below this multiple of the corrected controller's error are drawn on a scale that does not begin at zero."""

DISCARDED = 0.05
"""First share of the training, which does not set the scale: values of the untrained policy would flatten the rest."""


@section("Training", needs=("training_curve",))
def training(content: Content) -> list[Block]:
    """Error, reward and updates of the policy while it learned."""
    curve, error = content.table("training_curve"), content.other("validation_error_mm", float("nan"))
    learning = learning_plots(curve, content.baseline, error, content.looks)
    plots = training_plots(curve, content.looks)
    more = [Fold("Reward, errors and updates of the policy", plots, not learning)] if plots else []
    return [*learning, *more]


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
    curve = curve.assign(ratio=curve[ERROR] / baseline_error_mm, name=curve["controller"].str.partition(SEED_MARK)[0])
    seeds = curve.groupby("name", sort=False)["controller"].nunique()
    bands = {
        name: curve[curve["name"] == name].groupby("steps")["ratio"].agg(["median", "min", "max"])
        for name in seeds.index
    }
    looks = looks_of([baseline, *seeds.index]) | dict(looks or {})
    factor, unit = _unit(curve)
    corrected = (curve[BASE_ERROR].dropna() / baseline_error_mm).unique() if BASE_ERROR in curve else np.array([])
    late = [band.iloc[min(1, len(band) - 1) :] for band in bands.values()]
    lowest, highest = (float(pd.concat([band[end] for band in late]).agg(end)) for end in ("min", "max"))
    near = len(corrected) > 0 and highest < CLOSE * corrected.max()

    def paint(axes: Axes) -> None:
        for name, band in bands.items():
            steps, look = band.index / factor, looks[name]
            axes.fill_between(steps, band["min"], band["max"], color=look.colour, alpha=0.2, linewidth=0)
            axes.plot(steps, band["median"], label=name, marker=look.marker, **look.stroke)
        if len(corrected):
            last = curve["steps"].max() / factor
            axes.hlines(corrected, 0.0, last, color=GREY, linestyle=":", label="corrected controller")
        if near:
            low, high = min(lowest, *corrected), max(highest, *corrected)
            room = 0.15 * (high - low) or 0.01
            axes.set_ylim(low - room, high + room)
        else:
            axes.axhline(1.0, color=INK, linewidth=1.0, label=baseline)
            axes.set_ylim(0.0, 1.1 * max(1.0, highest))
        axes.set(xlabel=f"training, {unit}", ylabel=f"error ÷ error of {baseline}")
        axes.set_xlim(left=0.0)

    title = f"Error while learning, against {baseline}"
    note = f"Mean error on validation plants over that of {baseline} on the same plants; no policy is trained on them."
    if seeds.max() > 1:
        note += f" Line: median of {seeds.max()} training seeds; band: from the lowest to the highest."
    if len(corrected):
        note += " Dotted: the controller that is corrected."
    if near:
        note += " The scale does not begin at zero."
    rows = {
        name: [
            (f"after {number(steps / factor)} {unit}", float(band["median"].loc[steps]))
            for steps in band.index[[0, -1]]
        ]
        for name, band in bands.items()
    }
    return [one_panel("learning", title, note, description(title, rows, ""), paint)]


def training_plots(curve: pd.DataFrame, looks: Mapping[str, Look] | None = None) -> list[Plot]:
    """Figures of a training curve or log; none without a curve.

    Args:
        curve: column ``steps`` and any of ``mean_reward``, ``validation/…_mm`` and the columns of UPDATES, or the
            columns of stable-baselines3's log; ``controller`` if several were trained.
        looks: of the controllers in the other figures of the page; default: by their order here.
    """
    curve = _checked(curve)
    if curve.empty:
        return []
    known = looks_of(curve["controller"].unique())
    looks = {name: (looks or known).get(name, look) for name, look in known.items()}
    errors = {name: _words(name) for name in curve if name.startswith("validation/") and name.endswith("_mm")}
    reward = "Higher is better; zero would be perfect tracking without effort. Measured on training plants."
    kl = "Change of the policy per update (KL divergence), and quality of the value function's prediction (1 is best)."
    updates = {name: words for name, words in UPDATES.items() if name in curve}
    validation = "Lower is better; no policy is trained on these plants."
    return [
        *_plot(curve, looks, "training", "Reward while learning", {"mean_reward": "mean reward"}, reward),
        *_plot(curve, looks, "validation", "Error on validation plants", errors, validation),
        *_plot(curve, looks, "updates", "Updates of the policy", updates, kl),
    ]


def _unit(curve: pd.DataFrame) -> tuple[float, str]:
    return (1e6, "million steps") if curve["steps"].max() >= 1e6 else (1e3, "thousand steps")


def _words(column: str) -> str:
    return column.removeprefix("validation/").removesuffix("_mm").replace("_", " ") + ", mm"


def _plot(
    curve: pd.DataFrame, looks: Mapping[str, Look], key: str, title: str, columns: Mapping[str, str], note: str
) -> list[Plot]:
    """A panel per column that has values; no figure without such columns."""
    known = {name: words for name, words in columns.items() if name in curve and curve[name].notna().any()}
    if not known:
        return []
    factor, unit = _unit(curve)
    cut = False

    def paint(figure: Figure) -> None:
        nonlocal cut
        panels: list[Axes] = list(figure.subplots(len(known), 1, sharex=True, squeeze=False)[:, 0])
        for axes, (column, words) in zip(panels, known.items(), strict=True):
            for name, look in looks.items():
                part = curve[curve["controller"] == name].dropna(subset=[column])
                axes.plot(part["steps"] / factor, part[column], label=name, linewidth=1.2, **look.stroke)
            cut = _scale(axes, curve, column) or cut
            axes.set_ylabel(words if len(known) == 1 else words.replace(" of ", "\nof "), fontsize=8.0)
        panels[-1].set_xlabel(f"training, {unit}")
        panels[-1].set_xlim(left=0.0)
        if len(looks) > 1:
            add_legend(panels[0])

    parts = [
        f"{words}{'' if len(looks) == 1 else f' of {name}'} from {number(values.iloc[0])} to {number(values.iloc[-1])}"
        for column, words in known.items()
        for name in looks
        if len(values := curve[curve["controller"] == name][column].dropna())
    ]
    alt = f"{title}: {'; '.join(parts)} after {number(curve['steps'].max() / factor)} {unit}."
    plot = make_plot(key, title, note, alt, paint, max(3.0, 1.0 + 1.4 * len(known)))
    return [replace(plot, note=note + " An arrow marks early values beyond the scale.") if cut else plot]


def _scale(axes: Axes, curve: pd.DataFrame, column: str) -> bool:
    """Scale by the values after the first part, and mark earlier ones beyond it; returns whether there are any."""
    late = curve[curve["steps"] > DISCARDED * curve["steps"].max()][column].dropna().to_numpy(dtype=np.float64)
    if len(late) < 2:
        return False
    room = 0.08 * float(np.ptp(late)) or 0.05 * abs(float(late[0])) or 1.0
    low, high = float(late.min()) - room, float(late.max()) + room
    early = curve[column].dropna()
    axes.set_ylim(low, high)
    for beyond, place, arrow in ((early.min() < low, 0.0, "↓"), (early.max() > high, 1.0, "↑")):
        if beyond:
            axes.annotate(
                f"{arrow} {number(early.min() if place == 0.0 else early.max())}",
                (0.015, 0.04 if place == 0.0 else 0.96),
                xycoords="axes fraction",
                va="bottom" if place == 0.0 else "top",
                color=GREY,
                fontsize=8.0,
            )
    return bool(early.min() < low or early.max() > high)
