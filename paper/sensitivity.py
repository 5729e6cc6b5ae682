"""Sensitivity of each result of the page to each assumed parameter, ranked."""

from __future__ import annotations

import math

import pandas as pd

from hydro_env import HydroError, PlantParameters
from paper.results import LEAK, RESULTS, Result, Setting, setting_of
from paper.rig import Rig
from paper.variations import CHANGE, LEAK_NAME, Variation, leak_variation, variations

LEAST = 1e-9
"""A smaller result counts as zero and has no relative change."""

COLUMNS = ("value", "low_value", "high_value")


def sensitivity_table(rig: Rig, results: tuple[Result, ...] = RESULTS) -> pd.DataFrame:
    """One row per result and parameter, the largest effect first within each result.

    ``normal``, ``at_low`` and ``at_high`` in the result's unit; ``change_low_percent`` and ``change_high_percent`` of
    the normal value; ``effect_percent`` the larger of their sizes; ``rank`` from 1. NaN if a value is impossible.

    Raises:
        HydroError: no result can be computed for this rig.
    """
    at, varied, parts = setting_of(rig), [*variations(rig), leak_variation(LEAK)], []
    for result in results:
        normal = _computed(result, rig.parameters, at)
        if not math.isfinite(normal) or abs(normal) < LEAST:
            continue
        rows = []
        for variation in varied:
            ends = _ends(result, variation, rig, at)
            changes = [100.0 * (value / normal - 1.0) for value in ends]
            known = [abs(change) for change in changes if math.isfinite(change)]
            row: dict[str, float | str] = {"result": result.name, "unit": result.unit, "parameter": variation.name}
            row |= {name: getattr(variation, name) for name in COLUMNS}
            row |= {"normal": normal, "at_low": ends[0], "at_high": ends[1]}
            row |= {"change_low_percent": changes[0], "change_high_percent": changes[1]}
            rows.append(row | {"effect_percent": max(known) if known else math.nan})
        part = pd.DataFrame(rows)
        part["rank"] = part["effect_percent"].rank(ascending=False, method="first")
        parts.append(part.sort_values("rank", kind="stable"))
    if not parts:
        raise HydroError("none of the results can be computed for this rig")
    return pd.concat(parts, ignore_index=True)


def _ends(result: Result, variation: Variation, rig: Rig, at: Setting) -> tuple[float, float]:
    """The result with the lower and with the higher value of a parameter."""
    if variation.name == LEAK_NAME:  # a smaller resistance is a larger leak
        return _computed(result, rig.parameters, at, 1 + CHANGE), _computed(result, rig.parameters, at, 1 - CHANGE)
    return _computed(result, variation.low, at), _computed(result, variation.high, at)


def _computed(result: Result, plant: PlantParameters | None, at: Setting, factor: float = 1.0) -> float:
    try:
        return result.compute(plant, at, factor) if plant is not None else math.nan
    except (HydroError, ArithmeticError, ValueError):  # cannot be held, does not oscillate, no root
        return math.nan


def effects(table: pd.DataFrame) -> pd.DataFrame:
    """Effects in %, parameters (largest effect first) by results."""
    grid = table.pivot(index="parameter", columns="result", values="effect_percent")
    grid = grid[list(table["result"].unique())]
    return grid.loc[grid.max(axis=1).sort_values(ascending=False).index]


def is_scaled(value: str, low: str) -> bool:
    """Whether a variation has the usual relative size."""
    try:
        return abs(float(low) / float(value) - (1 - CHANGE)) < 1e-3
    except (ValueError, ZeroDivisionError):
        return False
