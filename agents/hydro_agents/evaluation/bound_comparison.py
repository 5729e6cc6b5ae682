"""Tables that compare the best found with controllers: by family, by leak, and over the size of the search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.best_found import BoundSettings, Told, best_found
from hydro_agents.evaluation.paired_cases import PairedCondition
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.protocol import ProtocolSettings
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.runner import run
from hydro_env import TaskConfig

Progress = Callable[[str, int, int], None]

TRUTH, NOMINAL = "told the truth", "told the nominal plant"


class ComparisonSettings(ProtocolSettings):
    """Cases of a comparison, and the size of the search."""

    leak_levels: tuple[float, ...] = Field((0.01, 0.3, 1.0, 4.0), min_length=1, description="l/min at 100 bar")
    plants: int = Field(3, ge=3, le=1000, description="per level and family")
    validation: bool = Field(False, description="use validation seeds instead of test seeds")
    search: BoundSettings = BoundSettings()


def compare(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    settings: ComparisonSettings,
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Errors of controllers and of the best found on the same cases, one row per case.

    Columns: ``controller``, ``leakage_flow_lpm``, ``family``, ``plant``, ``error_mm`` (mean of |error|, of the position
    that the sensor would read without noise), ``true_error_mm`` (of the true position), ``valve_travel_per_s``,
    ``failed``.
    """
    told: tuple[tuple[str, Told], ...] = ((NOMINAL, "nominal"), (TRUTH, "truth"))
    searches = {name: partial(best_found, told=which, settings=settings.search) for name, which in told}
    results = run(
        _protocol(config, settings, ("tracking", "best_found")),
        Participants(controllers, searches=searches),
        jobs=1,
        progress=progress,
    )
    return _errors(pd.concat([results.part("tracking"), results.part("best_found")], ignore_index=True))


def summary(frame: pd.DataFrame, by: str) -> pd.DataFrame:
    """Mean errors in mm by ``family`` or ``leakage_flow_lpm``, one column per controller; last row: over all.

    The column ``floor`` holds the true error of the best found that knows the true plant, but not the sensor's bias.
    """
    table = frame.pivot_table("error_mm", by, "controller", sort=False)
    base = str(frame["controller"].iloc[0])
    true = frame.pivot_table("true_error_mm", by, "controller", sort=False)
    table[f"{base}, true position"], table["floor, true position"] = true[base], true[TRUTH]
    table.loc["mean"] = table.mean()
    return table


def travel(frame: pd.DataFrame) -> pd.DataFrame:
    """Mean valve travel in full strokes per second by ``family``, one column per controller; last row: over all."""
    table = frame.pivot_table("valve_travel_per_s", "family", "controller", sort=False)
    table.loc["mean"] = table.mean()
    return table


def convergence(
    config: TaskConfig,
    settings: ComparisonSettings,
    variations: Mapping[str, Sequence[Any]],
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Mean error of the best found with the true plant, as one setting of the search varies.

    Returns:
        One row per setting and value: ``setting``, ``value``, the mean error of each family and of all (``mean``), mm.
    """
    varied = [(name, value) for name, values in variations.items() for value in values]
    chosen = {f"{name} {value}": settings.search.model_copy(update={name: value}) for name, value in varied}
    searches = {name: partial(best_found, settings=search) for name, search in chosen.items()}
    protocol = _protocol(config, settings, ("best_found",))
    results = run(protocol, Participants({}, searches=searches), jobs=1, progress=progress)
    errors = (
        _errors(results.part("best_found")).groupby(["controller", "family"], sort=False)["error_mm"].mean().unstack()
    )
    rows = []
    for name, value in varied:
        found = errors.loc[f"{name} {value}", list(settings.families)]
        rows.append({"setting": name, "value": value, **found, "mean": found.mean()})
    return pd.DataFrame(rows)


def _protocol(config: TaskConfig, settings: ComparisonSettings, parts: tuple[str, ...]) -> RobustnessProtocol:
    """Some parts on the cases of the settings."""
    return RobustnessProtocol(
        task=config,
        parts=parts,
        conditions={"task": PairedCondition()},
        seeds="THRESHOLDS" if settings.validation else "EVALUATION",
        bound_conditions=("task",),
        bound_plants=settings.plants,
        **settings.model_dump(include={"leak_levels", "families", "plants"}),
    )


def _errors(cases: pd.DataFrame) -> pd.DataFrame:
    """Errors in the frame of the sensor and of the true position, with what they cost."""
    shown = cases[["leakage_flow_lpm", "family", "plant", "controller"]]
    errors = {"error_mm": cases["mean_error_sensor_mm"], "true_error_mm": cases["mean_error_mm"]}
    return shown.assign(**errors, valve_travel_per_s=cases["valve_travel_per_s"], failed=cases["failed"])
