"""Results of the paper's figures as single numbers, and their change with each assumed parameter of a rig."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import pandas as pd

from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_env import ConfigurationError, HydroError, PlantParameters, resistance_from_flow, simulate
from hydro_env.plant.analysis import force_limits
from hydro_env.plant.parts.leakage import LEAK_LAWS
from paper.force_rate import force_rate_table, shares
from paper.leaks import MODERATE, TIGHT
from paper.loop import bandwidth, sensible_gain
from paper.moves import FIRST_STOP, HELD
from paper.rig import Law, Rig, quick_stop, with_friction_share, with_leak
from paper.settling import healthy_frequency, settling_of

LEAK = 0.3
"""l/min at 100 bar; leak of all results without another leak."""

FRICTION_SHARE = 0.02
"""Friction of the settling times relative to the assumed friction; small enough for the axis to oscillate."""

CHANGE = 0.2
"""Variation of a parameter relative to its value."""

FORCE_SHARE = 0.02
"""Variation of the external force (assumed to be zero), relative to the force limit."""

ROD_SEAL_LEAKS = (1.0, 0.1)
"""l/min at 100 bar past the rod seal; assumed tight, varied over these values."""

LEAK_NAME = "leakage.internal_resistance"
LEAST = 1e-9
"""A smaller result counts as zero and has no relative change."""


class Setting(NamedTuple):
    """Settings that do not change while a plant is varied."""

    rig: Rig
    frequency: float  # rad/s, of the oscillation that settles
    gain: float  # of the closed loop, command per metre


class Result(NamedTuple):
    """One number of a figure."""

    name: str
    words: str
    unit: str
    compute: Callable[[PlantParameters, Setting, float], float]  # plant, setting, factor on the leak


def _leaking(plant: PlantParameters, flow: float, law: Law = "laminar") -> PlantParameters:
    """The plant with the leak of a result, in addition to its own orifice."""
    leaking = with_leak(plant, flow, law)
    extra = plant.leakage.orifice_gain
    return leaking.replace(leakage={"orifice_gain": leaking.leakage.orifice_gain + extra}) if extra else leaking


def _settling(plant: PlantParameters, at: Setting, factor: float, leak: float = LEAK) -> float:
    run = quick_stop(_leaking(with_friction_share(plant, FRICTION_SHARE), factor * leak), at.rig)
    return settling_of(run, at.frequency, at.rig.stretch).clean_s


def _settling_ratio(plant: PlantParameters, at: Setting, factor: float) -> float:
    return _settling(plant, at, factor, TIGHT) / _settling(plant, at, factor, MODERATE)


def _move(plant: PlantParameters, at: Setting, factor: float) -> float:
    rig, leaking = at.rig, _leaking(plant, factor * LEAK, "throttle")
    driven, stopped = rig.count(rig.stretch * (FIRST_STOP - HELD)), rig.count(rig.stretch * 0.03)
    run = simulate(leaking, [rig.voltage] * driven + [0.0] * stopped, rig.sample_time, {"position": rig.start})
    return 1e3 * float(run.position[-1] - run.position[0])


def _share(plant: PlantParameters, at: Setting, factor: float) -> float:
    varied = replace(at.rig, parameters=plant)
    table = force_rate_table(varied, "laminar", (factor * LEAK,), plant.leakage.orifice_gain)
    return 100.0 * float(shares(table, at.rig.stretch).set_index("window").loc["stop", "leakage_share"])


def _bandwidth(plant: PlantParameters, at: Setting, factor: float) -> float:
    return bandwidth(sampled_loop(_leaking(plant, factor * LEAK), at.rig.place), at.gain)


RESULTS = (
    Result("move_mm", "Fig. 12: first move", "mm", _move),
    Result("settling_s", "Fig. 13: settling time", "s", _settling),
    Result("settling_ratio", "Fig. 13: settling, tight / 1 l/min", "1", _settling_ratio),
    Result("leakage_share_percent", "Section 4: leakage's share", "%", _share),
    Result("bandwidth_hz", "closed-loop bandwidth", "Hz", _bandwidth),
)


def assumed_parameters(base: PlantParameters) -> dict[str, Any]:
    """``group.field`` and value of every parameter whose origin is ``assumed`` (hydro_env/plant/parameters.py)."""
    return {
        f"{group}.{field}": getattr(getattr(base, group), field)
        for group in PlantParameters.model_fields
        for field, details in type(getattr(base, group)).model_fields.items()
        if (details.description or "").startswith("assumed")
    }


def other_values(base: PlantParameters, name: str, value: Any) -> tuple[Any, Any]:
    """The lower and the higher value of an assumed parameter: ±20 %; ``None`` twice if no other value is known.

    A parameter that is zero, infinite or a choice takes the values below.
    """
    if name == "load.external_force":
        step = FORCE_SHARE * sum(force_limits(base)) if value == 0.0 else CHANGE * abs(value)
        return value - step, value + step
    if isinstance(value, float) and 0.0 < value < math.inf:
        return (1 - CHANGE) * value, (1 + CHANGE) * value
    low, high = map(resistance_from_flow, ROD_SEAL_LEAKS)
    others: dict[str, tuple[Any, Any]] = {
        "leakage.external_resistance": (low, high),
        "leakage.orifice_gain": (0.0, LEAK_LAWS["orifice"].value(CHANGE * LEAK)),
        "friction.model": ("none", "stribeck" if value == "lugre" else "lugre"),
        "fluid.air_fraction": (0.0, 0.001),
    }
    return others.get(name, (None, None))


def sensitivity_table(rig: Rig, results: tuple[Result, ...] = RESULTS) -> pd.DataFrame:
    """One row per result and parameter, the largest effect first within each result.

    ``normal``, ``at_low`` and ``at_high`` in the result's unit; ``change_low_percent`` and ``change_high_percent`` of
    the normal value; ``effect_percent`` the larger of their sizes; ``rank`` from 1. NaN if a value is impossible. The
    internal leak itself varies by ±20 % as well, for comparison.

    Raises:
        HydroError: no result can be computed for this rig.
    """
    base, at = rig.parameters, Setting(rig, healthy_frequency(rig), sensible_gain(rig))
    ranges = {name: (value, *other_values(base, name, value)) for name, value in assumed_parameters(base).items()}
    normal_leak, low, high = (resistance_from_flow(factor * LEAK) for factor in (1.0, 1 + CHANGE, 1 - CHANGE))
    ranges[LEAK_NAME] = (normal_leak, low, high)
    parts = []
    for result in results:
        normal = _computed(result, base, at)
        if not math.isfinite(normal) or abs(normal) < LEAST:
            continue
        rows = []
        for name, values in ranges.items():
            if name == LEAK_NAME:  # a smaller resistance is a larger leak
                ends = [_computed(result, base, at, factor) for factor in (1 + CHANGE, 1 - CHANGE)]
            else:
                ends = [_computed(result, _changed(base, name, value), at) for value in values[1:]]
            changes = [100.0 * (end / normal - 1.0) for end in ends]
            row: dict[str, float | str] = {"result": result.name, "unit": result.unit, "parameter": name}
            row |= dict(zip(("value", "low_value", "high_value"), map(_shown, values), strict=True))
            row |= {"normal": normal, "at_low": ends[0], "at_high": ends[1]}
            row |= {"change_low_percent": changes[0], "change_high_percent": changes[1]}
            known = [abs(change) for change in changes if math.isfinite(change)]
            rows.append(row | {"effect_percent": max(known, default=math.nan)})
        part = pd.DataFrame(rows)
        part["rank"] = part["effect_percent"].rank(ascending=False, method="first")
        parts.append(part.sort_values("rank", kind="stable"))
    if not parts:
        raise HydroError("none of the results can be computed for this rig")
    return pd.concat(parts, ignore_index=True)


def _computed(result: Result, plant: PlantParameters | None, at: Setting, factor: float = 1.0) -> float:
    try:
        return result.compute(plant, at, factor) if plant is not None else math.nan
    except (HydroError, ArithmeticError, ValueError):  # cannot be held, does not oscillate, no root
        return math.nan


def _changed(base: PlantParameters, name: str, value: Any) -> PlantParameters | None:
    group, field = name.split(".")
    try:
        return None if value is None else base.replace(**{group: {field: value}})
    except ConfigurationError:  # outside what the parameter may be
        return None


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return "∞" if math.isinf(value) else f"{value:.4g}"
    return "–" if value is None else str(value)


def effects(table: pd.DataFrame) -> pd.DataFrame:
    """Effects in %, parameters (largest effect first) by results."""
    grid = table.pivot(index="parameter", columns="result", values="effect_percent")
    grid = grid[list(table["result"].unique())]
    return grid.loc[grid.max(axis=1).sort_values(ascending=False).index]
