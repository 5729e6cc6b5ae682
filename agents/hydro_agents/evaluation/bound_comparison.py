"""Tables that compare the best found with controllers: by family, by leak, and over the size of the search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.best_found import BoundSettings, best_found
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.evaluation.protocol import ProtocolSettings
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.seeds import EVALUATION, THRESHOLDS
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
    cases, table = settings.cases(THRESHOLDS if settings.validation else EVALUATION)
    table = table.drop(columns="seed")
    frames = []
    for name, controller in controllers.items():
        rollout = run_cases(config, controller, cases)
        frames.append(table.assign(controller=name, **_errors(rollout, cases, config)))
    for name, told in ((NOMINAL, "nominal"), (TRUTH, "truth")):
        report = None if progress is None else _reporter(progress, name, len(cases))
        rollout = best_found(config, cases, told, settings.search, report)  # type: ignore[arg-type]
        frames.append(table.assign(controller=name, **_errors(rollout, cases, config)))
    return pd.concat(frames, ignore_index=True)


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
    cases, table = settings.cases(THRESHOLDS if settings.validation else EVALUATION)
    table = table.drop(columns="seed")
    rows: list[dict[str, Any]] = []
    known: dict[BoundSettings, pd.Series] = {}
    for setting, values in variations.items():
        for value in values:
            search = settings.search.model_copy(update={setting: value})
            if search not in known:
                report = None if progress is None else _reporter(progress, f"{setting} {value}", len(cases))
                errors = table.assign(**_errors(best_found(config, cases, "truth", search, report), cases, config))
                known[search] = errors.groupby("family", sort=False)["error_mm"].mean()
            rows.append({"setting": setting, "value": value, **known[search], "mean": known[search].mean()})
    return pd.DataFrame(rows)


def _errors(rollout: Rollout, cases: Cases, config: TaskConfig) -> dict[str, Any]:
    assert cases.families is not None
    found = rollout_metrics(rollout, cases.families, config.control_period)
    renamed = {"error_mm": found["mean_error_sensor_mm"], "true_error_mm": found["mean_error_mm"]}
    return renamed | {name: found[name] for name in ("valve_travel_per_s", "failed")}


def _reporter(progress: Progress, phase: str, total: int) -> Callable[[int], None]:
    progress(phase, 0, total)
    return lambda done: progress(phase, done, total)
