"""``hydro bound``: controllers and the best found on the same cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.best_found import BestFound
from hydro_agents.evaluation.metrics import ERROR, ERROR_SENSOR
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.runner import run
from hydro_agents.running.jobs import Report
from hydro_env import TaskConfig
from hydro_env.files import validate

TRUTH, MEASURED = "told the truth", "measured state"
SHOWN = [
    "leakage_flow_lpm",
    "family",
    "plant",
    "controller",
    "error_mm",
    "true_error_mm",
    "valve_travel_per_s",
    "failed",
]
"""Columns of a comparison."""


def bound_protocol(config: TaskConfig, leaks: Sequence[float], plants: int) -> RobustnessProtocol:
    """The protocol of a comparison.

    Args:
        config: the task.
        leaks: l/min at 100 bar.
        plants: per leak and family.

    Raises:
        ConfigurationError: a leak is impossible.
    """
    values = {"leak_levels": leaks, "plants": plants, "bound_plants": plants, "seeds": "EVALUATION", "task": config}
    values |= {"parts": ("tracking", "best_found"), "conditions": {"task": {}}, "bound_conditions": ("task",)}
    return validate(RobustnessProtocol, values, "bound")


def compare(protocol: RobustnessProtocol, controllers: Mapping[str, Controller], progress: Report) -> pd.DataFrame:
    """Errors of controllers and of the best found on the same cases, one row per case.

    Columns: ``controller``, ``leakage_flow_lpm``, ``family``, ``plant``, ``error_mm`` (mean of |error|, of the position
    that the sensor would read without noise), ``true_error_mm`` (of the true position), ``valve_travel_per_s``,
    ``failed``.
    """
    searches = {name: partial(BestFound, measured=name == MEASURED) for name in (MEASURED, TRUTH)}
    rows = run(protocol, Participants(controllers, searches=searches), jobs=1, progress=progress).rows
    frame = pd.concat([rows["tracking"], rows["best_found"]], ignore_index=True)
    return frame.rename(columns={ERROR_SENSOR: "error_mm", ERROR: "true_error_mm"})[SHOWN]


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
