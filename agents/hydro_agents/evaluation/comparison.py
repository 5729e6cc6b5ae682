"""Compares controllers on the same cases: ratios, shares, probabilities and gaps, each with its interval."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.evaluation.metrics import COMPARED, ERROR, ERROR_SENSOR
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

LEAST_ROOM = 0.02
"""Below this share of the baseline's error between baseline and best found there is no score: it would be noise."""


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
        bound = None if bound is None else bound.assign(training_seed=0)
        self._best = {} if bound is None else {name: self._array(bound, name) for name in (ERROR, ERROR_SENSOR)}

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
        mine, theirs = self._pair(controller, against, ERROR, part)
        sensed = self._pair(controller, against, ERROR_SENSOR, part)
        absent = np.isnan(mine).all(axis=0)
        weights, their_weights = (
            self.weights(name, len(values), plants) for name, values in ((controller, mine), (against, theirs))
        )
        strata = (self.family[plants], self.condition[situations])
        count, searched = int(np.any(~absent, axis=1).sum()), self._searched(part)
        expected = _mean_over_seeds(theirs)
        ratios = mine / expected
        better = np.where(np.isnan(ratios), np.nan, mine < expected)
        found = {
            "ratio": means(mine, weights) / means(theirs, their_weights),
            "equal_weight": _geometric_mean(_ratios(mine, theirs, weights, their_weights, *strata)),
            "ratio_sensor": means(sensed[0], weights) / means(sensed[1], their_weights),
            "equal_weight_sensor": _geometric_mean(_ratios(*sensed, weights, their_weights, *strata)),
            "iqm_ratio": interquartile_means(ratios, weights),
            "share_better": means(better, weights),
            "probability_of_improvement": improvements(mine, theirs, weights, their_weights.seeds),
            "gap": self._gap(mine, theirs, weights, their_weights, part),
            "score": self._score(*sensed, weights, their_weights, part, strata),
        }
        row: dict[str, float] = {}
        for name, resampled in found.items():
            row |= interval(resampled, searched if name in ("gap", "score") else count).named(name)
        row["worst_ratio"] = float(np.nanmax(ratios, initial=-np.inf)) if not absent.all() else np.nan
        for name, metric in COMPARED.items():
            row[name] = _ratio(*(self.values(who, metric.name)[:, part[0], part[1]] for who in (controller, against)))
        row["cases"] = int((~np.isnan(mine)).sum())
        return row

    def _pair(self, controller: str, against: str, metric: str, part: Any) -> tuple[Array, Array]:
        """A metric of both controllers on a part of the grid, on their common cases."""
        mine, theirs = (self.values(name, metric)[:, part[0], part[1]] for name in (controller, against))
        absent = np.isnan(mine).all(axis=0) | np.isnan(theirs).all(axis=0)
        return np.where(absent, np.nan, mine), np.where(absent, np.nan, theirs)

    def _searched(self, part: Any) -> int:
        """Smallest number of plants with a best found in a family of a part of the grid."""
        if not self._best:
            return 0
        there = ~np.isnan(self._best[ERROR][0][part]).all(axis=1)
        _, counts = np.unique(self.family[part[0][:, 0]][there], return_counts=True)
        return int(min(counts, default=0))

    def _with_best(self, mine: Array, theirs: Array, metric: str, part: Any) -> tuple[Array, Array, Array]:
        """Errors of a controller, the baseline and the best found on the cases that all of them have."""
        best = self._best[metric][:, part[0], part[1]]
        mine, theirs = (np.where(np.isnan(best), np.nan, values) for values in (mine, theirs))
        return mine, theirs, np.where(np.isnan(_mean_over_seeds(theirs)), np.nan, best)

    def _gap(self, mine: Array, theirs: Array, weights: Weights, their_weights: Weights, part: Any) -> Array:
        """(baseline − x) / (baseline − best found) of the mean true errors, on the cases of the bound."""
        if not self._best:
            return np.full(len(weights.plants), np.nan)
        mine, theirs, best = self._with_best(mine, theirs, ERROR, part)
        base = means(theirs, their_weights)
        return np.asarray((base - means(mine, weights)) / (base - means(best, _one_seed(weights))))

    def _score(
        self, mine: Array, theirs: Array, weights: Weights, their_weights: Weights, part: Any, strata: Any
    ) -> Array:
        """0 for the baseline, 100 for the best found: Σ (1 − ratio) / Σ (1 − ratio of the best found) over the kinds.

        The sums run over kinds of reference and conditions; a ratio is that of the mean errors in the frame of the
        sensor, to the baseline's. Each kind thus counts as much as it can be improved: one at which the baseline is
        near the best found has little weight, while a mean of scores per kind would divide by almost nothing. A
        geometric mean would let one kind with an error near zero, such as slow sines, decide the score.
        """
        if not self._best:
            return np.full(len(weights.plants), np.nan)
        mine, theirs, best = self._with_best(mine, theirs, ERROR_SENSOR, part)
        closed, room = (
            np.mean(1.0 - _ratios(values, theirs, own, their_weights, *strata), axis=0)
            for values, own in ((mine, weights), (best, _one_seed(weights)))
        )
        return np.asarray(100.0 * closed / np.where(room > LEAST_ROOM, room, np.nan))


def _one_seed(weights: Weights) -> Weights:
    return Weights(np.ones((len(weights.plants), 1)), weights.plants)


def _ratios(
    mine: Array,
    theirs: Array,
    weights: Weights,
    their_weights: Weights,
    families: NDArray[np.str_],
    conditions: NDArray[np.str_],
) -> Array:
    """Ratio of the mean errors for each condition and family that has cases, in every resampling: (rows, R + 1)."""
    found = []
    for condition in dict.fromkeys(conditions.tolist()):
        for family in dict.fromkeys(families.tolist()):
            rows, columns = families == family, conditions == condition
            one, other = (values[:, rows][:, :, columns] for values in (mine, theirs))
            if not (np.isnan(one).all() or np.isnan(other).all()):
                own, base = (Weights(each.seeds, each.plants[:, rows]) for each in (weights, their_weights))
                found.append(means(one, own) / means(other, base))
    return np.array(found) if found else np.full((1, len(weights.plants)), np.nan)


def _geometric_mean(ratios: Array) -> Array:
    """Over the rows, all with the same weight."""
    return np.asarray(np.exp(np.mean(np.log(ratios), axis=0)))


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
