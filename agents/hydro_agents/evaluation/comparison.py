"""Compares controllers on the same cases: ratios, shares, probabilities and gaps, each with its interval."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.evaluation.metrics import COMPARED, ERROR
from hydro_agents.running.statistics import (
    RESAMPLES,
    Interval,
    Weights,
    improvements,
    interquartile_means,
    interval,
    means,
    plant_weights,
    seed_weights,
)

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]


class Grid:
    """Cases as arrays (S, U, K): training seeds, plants (of all families), situations (condition and leak).

    Args:
        cases: rows of the part ``tracking`` of :class:`~hydro_agents.evaluation.runner.Results`.
        bound: cases of the best found, with ``condition``, ``family``, ``leakage_flow_lpm``, ``plant`` and the error;
            ``None`` without one.
    """

    def __init__(self, cases: pd.DataFrame, bound: pd.DataFrame | None = None) -> None:
        missing = {name: 0 for name in ("condition", "training_seed") if name not in cases}
        cases = cases.assign(**missing) if missing else cases
        self.controllers = [str(name) for name in cases["controller"].unique()]
        plants = cases[["family", "plant"]].drop_duplicates()
        situations = cases[["condition", "leakage_flow_lpm"]].drop_duplicates()
        self.family: NDArray[np.str_] = plants["family"].to_numpy().astype(str)
        self.condition: NDArray[np.str_] = situations["condition"].to_numpy().astype(str)
        self.leak = situations["leakage_flow_lpm"].to_numpy(dtype=np.float64)
        self._plants = pd.MultiIndex.from_frame(plants)
        self._situations = pd.MultiIndex.from_frame(situations)
        self._rows = {name: cases[cases["controller"] == name] for name in self.controllers}
        self._plant_weights = plant_weights(self.family)
        self._known: dict[tuple[str, str], Array] = {}
        self._best = None if bound is None else self._array(bound.assign(training_seed=0), ERROR)

    def _array(self, rows: pd.DataFrame, metric: str) -> Array:
        seeds = {seed: index for index, seed in enumerate(sorted(rows["training_seed"].unique()))}
        filled = np.full((len(seeds), len(self._plants), len(self._situations)), np.nan)
        plant = self._plants.get_indexer(pd.MultiIndex.from_frame(rows[["family", "plant"]]))
        situation = self._situations.get_indexer(pd.MultiIndex.from_frame(rows[["condition", "leakage_flow_lpm"]]))
        kept = (plant >= 0) & (situation >= 0)
        seed = rows["training_seed"].map(seeds).to_numpy()
        filled[seed[kept], plant[kept], situation[kept]] = rows[metric].to_numpy(dtype=np.float64)[kept]
        return filled

    def values(self, controller: str, metric: str) -> Array:
        """A metric of a controller, (S, U, K)."""
        if (controller, metric) not in self._known:
            self._known[controller, metric] = self._array(self._rows[controller], metric)
        return self._known[controller, metric]

    def weights(self, controller: str, seeds: int, plants: Mask | NDArray[np.intp] | slice = slice(None)) -> Weights:
        """Weights of a controller's training seeds, and of some plants; the latter are the same for all controllers."""
        number = self.controllers.index(controller)
        return Weights(seed_weights(seeds, RESAMPLES, number), self._plant_weights[:, plants])

    def mean(self, controller: str, metric: str, plants: Mask, situations: Mask) -> Interval:
        """Mean of a metric over some plants and situations of a controller."""
        chosen = self.values(controller, metric)[:, plants][:, :, situations]
        used = np.flatnonzero(~np.isnan(chosen).all(axis=(0, 2)))
        weights = self.weights(controller, len(chosen), np.flatnonzero(plants)[used])
        return interval(means(chosen[:, used], weights), len(used))

    def ratio(self, controller: str, against: str, metric: str) -> Interval:
        """Ratio of the means of a metric over the plants that both controllers have."""
        mine, theirs = self.values(controller, metric), self.values(against, metric)
        absent = np.isnan(mine).all(axis=0) | np.isnan(theirs).all(axis=0)
        one, other = (
            means(np.where(absent, np.nan, values), self.weights(name, len(values)))
            for name, values in ((controller, mine), (against, theirs))
        )
        return interval(one / other, int(np.any(~absent, axis=1).sum()))

    def compare(self, controller: str, against: str, plants: Mask, situations: Mask) -> dict[str, float]:
        """Columns of one row of a comparison over some plants and situations of both controllers."""
        part = np.ix_(plants, situations)
        mine, theirs = (self.values(name, ERROR)[:, part[0], part[1]] for name in (controller, against))
        absent = np.isnan(mine).all(axis=0) | np.isnan(theirs).all(axis=0)
        mine, theirs = (np.where(absent, np.nan, values) for values in (mine, theirs))
        weights, their_weights = (
            self.weights(name, len(values), plants) for name, values in ((controller, mine), (against, theirs))
        )
        count = int(np.any(~absent, axis=1).sum())
        expected = _mean_over_seeds(theirs)
        ratios = mine / expected
        better = np.where(np.isnan(ratios), np.nan, mine < expected)
        found = {
            "ratio": means(mine, weights) / means(theirs, their_weights),
            "equal_weight": self._equal_weight(mine, theirs, weights, their_weights, plants, situations),
            "iqm_ratio": interquartile_means(ratios, weights),
            "share_better": means(better, weights),
            "probability_of_improvement": improvements(mine, theirs, weights, their_weights.seeds),
            "gap": self._gap(mine, theirs, weights, their_weights, part),
        }
        row: dict[str, float] = {}
        for name, resampled in found.items():
            row |= interval(resampled, count).named(name)
        row["worst_ratio"] = float(np.nanmax(ratios, initial=-np.inf)) if not absent.all() else np.nan
        for name, metric in COMPARED.items():
            row[name] = _ratio(*(self.values(who, metric.name)[:, part[0], part[1]] for who in (controller, against)))
        row["cases"] = int((~np.isnan(mine)).sum())
        return row

    def _equal_weight(
        self, mine: Array, theirs: Array, weights: Weights, their_weights: Weights, plants: Mask, situations: Mask
    ) -> Array:
        """Geometric mean over conditions and families of the ratio of means, all with the same weight."""
        families, conditions = self.family[plants], self.condition[situations]
        logs = []
        for condition in dict.fromkeys(conditions.tolist()):
            columns = conditions == condition
            for family in dict.fromkeys(families.tolist()):
                rows = families == family
                one, other = (values[:, rows][:, :, columns] for values in (mine, theirs))
                if np.isnan(one).all() or np.isnan(other).all():
                    continue
                numerator = means(one, Weights(weights.seeds, weights.plants[:, rows]))
                logs.append(
                    np.log(numerator / means(other, Weights(their_weights.seeds, their_weights.plants[:, rows])))
                )
        return np.exp(np.mean(logs, axis=0)) if logs else np.full(len(weights.plants), np.nan)

    def _gap(self, mine: Array, theirs: Array, weights: Weights, their_weights: Weights, part: Any) -> Array:
        """(baseline − x) / (baseline − best found) on the cases of the bound."""
        if self._best is None:
            return np.full(len(weights.plants), np.nan)
        best = self._best[:, part[0], part[1]]
        one, other = (np.where(np.isnan(best), np.nan, values) for values in (mine, theirs))
        best = np.where(np.isnan(_mean_over_seeds(other)), np.nan, best)
        base = means(other, their_weights)
        lowest = means(best, Weights(np.ones((len(weights.plants), 1)), weights.plants))
        return np.asarray((base - means(one, weights)) / (base - lowest))


def _mean_over_seeds(values: Array) -> Array:
    there = ~np.isnan(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(values, axis=0) / there.sum(axis=0))


def _ratio(one: Array, other: Array) -> float:
    """Ratio of the means of two metrics on their common cases."""
    absent = np.isnan(one).all(axis=0) | np.isnan(other).all(axis=0)
    if absent.all():
        return float("nan")
    mine, theirs = (float(np.nanmean(np.where(absent, np.nan, values))) for values in (one, other))
    return mine / theirs if theirs != 0.0 else float("nan")
