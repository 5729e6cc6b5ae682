"""Parts of several pages: who is best, what did not run, how policies learned, facts of the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.kit import GREY, INK, Page, draw, panel
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.text import duration

LOG_STEPS = "time/total_timesteps"  # column of stable-baselines3's log that is ``steps`` in a curve

ERROR = "validation/mean_error_mm"
BASE_ERROR = "validation/base_mean_error_mm"
"""Error of the controller that is corrected, on the same plants."""


def problems(page: Page, status: pd.DataFrame, who: str, conditions: pd.DataFrame) -> None:
    """What failed or did not apply, from the tables ``status`` and ``conditions``."""
    table = status[status["status"].isin(["failed", "not applicable"])] if len(status) else status
    if len(table):
        labels = conditions.set_index("condition")["label"]
        table = table.replace({"condition": labels.to_dict()}).set_index(who)
        with page.fold("Some parts did not run", opened=(table["status"] == "failed").any()):
            page.table(table[["condition", "status", "message"]], words=True)


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


def facts_of(tables: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """Keys and values of a run, from its table ``protocol``."""
    table = tables.get("protocol", pd.DataFrame(columns=["key", "value"]))
    return dict(zip(table["key"].astype(str), table["value"].astype(str), strict=True))


def run_facts(
    page: Page,
    facts: Mapping[str, str],
    timings: Mapping[str, float] | None = None,
    configuration: str = "",
    conditions: pd.DataFrame | None = None,
) -> None:
    """Facts, durations (s), settings (YAML text) and conditions of the run."""
    page.heading("This run")
    rows = {**facts, **{f"time to {phase}": duration(seconds) for phase, seconds in (timings or {}).items()}}
    page.table(pd.DataFrame({"value": pd.Series(rows, dtype=object)}), words=True)
    if configuration:
        with page.fold("Configuration"):
            page.code(configuration)
    if conditions is not None:
        with page.fold("All conditions"):
            page.table(
                conditions.set_index("condition").dropna(axis=1, how="all").astype(object).fillna(""), words=True
            )
