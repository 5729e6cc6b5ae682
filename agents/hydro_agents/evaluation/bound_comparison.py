"""``hydro bound``: controllers and the best found on the same cases."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.best_found import BoundSettings, Told, best_found
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.robustness_protocol import PairedCases, PairedCondition, RobustnessProtocol
from hydro_agents.evaluation.runner import run
from hydro_agents.running.jobs import Report
from hydro_env import TaskConfig

TRUTH, MEASURED = "told the truth", "measured state"
COLUMNS = {
    "leakage_flow_lpm": "leakage_flow_lpm",
    "family": "family",
    "plant": "plant",
    "controller": "controller",
    "mean_error_sensor_mm": "error_mm",
    "mean_error_mm": "true_error_mm",
    "valve_travel_per_s": "valve_travel_per_s",
    "failed": "failed",
}
"""Columns of a comparison, by their names in the parts of a protocol."""


class ComparisonSettings(PairedCases):
    """Cases of a comparison, and the size of the search."""

    leak_levels: tuple[float, ...] = Field((0.01, 0.3, 1.0, 4.0), min_length=1, description="l/min at 100 bar")
    plants: int = Field(3, ge=3, le=1000, description="per level and family")
    search: BoundSettings = BoundSettings()


def compare(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    settings: ComparisonSettings,
    progress: Report | None = None,
) -> pd.DataFrame:
    """Errors of controllers and of the best found on the same cases, one row per case.

    Columns: ``controller``, ``leakage_flow_lpm``, ``family``, ``plant``, ``error_mm`` (mean of |error|, of the position
    that the sensor would read without noise), ``true_error_mm`` (of the true position), ``valve_travel_per_s``,
    ``failed``.
    """
    protocol = RobustnessProtocol(
        task=config,
        parts=("tracking", "best_found"),
        conditions={"task": PairedCondition()},
        seeds="EVALUATION",
        bound_conditions=("task",),
        bound_plants=settings.plants,
        **settings.model_dump(exclude={"search"}),
    )
    told: dict[str, Told] = {MEASURED: "measured", TRUTH: "truth"}
    searches = {name: partial(best_found, told=which, settings=settings.search) for name, which in told.items()}
    rows = run(protocol, Participants(controllers, searches=searches), jobs=1, progress=progress).rows
    return pd.concat([rows["tracking"], rows["best_found"]], ignore_index=True)[list(COLUMNS)].rename(columns=COLUMNS)


def summary(frame: pd.DataFrame, by: str) -> pd.DataFrame:
    """Mean errors in mm by ``family`` or ``leakage_flow_lpm``, one column per controller; last row: over all.

    The column ``floor`` holds the true error of the best found that knows the true plant, but not the sensor's bias.
    """
    table = means_by(frame, "error_mm", by)
    true = means_by(frame, "true_error_mm", by)
    base = str(frame["controller"].iloc[0])
    return table.assign(**{f"{base}, true position": true[base], "floor, true position": true[TRUTH]})


def means_by(frame: pd.DataFrame, column: str, by: str = "family") -> pd.DataFrame:
    """Means of a column by another one, one column per controller; last row: over all."""
    table = frame.pivot_table(column, by, "controller", sort=False)
    table.loc["mean"] = table.mean()
    return table
