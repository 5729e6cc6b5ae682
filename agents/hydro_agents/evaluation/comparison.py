"""Compares controllers on the same cases: ratios, shares and probabilities, each with its interval."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

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
from hydro_env.types import Floats

Mask = NDArray[np.bool_]

ALL = "all"
"""Name of what is over all conditions."""


class Sample(NamedTuple):
    """A metric of a controller on some plants and situations, with the weights of its resamplings."""

    values: Floats  # (S, U, K)
    weights: Weights

    @property
    def mean(self) -> Floats:
        """Mean in every resampling, (R + 1,)."""
        return means(self.values, self.weights)

    @property
    def present(self) -> Mask:
        """Whether any training seed has the case, (U, K)."""
        return np.asarray(~np.isnan(self.values).all(axis=0))

    @property
    def expected(self) -> Floats:
        """Mean over the training seeds that have the case, (U, K)."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nansum(self.values, axis=0) / (~np.isnan(self.values)).sum(axis=0))

    @property
    def plants(self) -> int:
        """Number of plants with a case."""
        return int(self.present.any(axis=1).sum())

    @property
    def dense(self) -> Sample:
        """The same without the plants that have no case."""
        used = self.present.any(axis=1)
        return Sample(self.values[:, used], self.weights._replace(plants=self.weights.plants[:, used]))

    def where(self, kept: Mask) -> Sample:
        """The same without the values of other cases."""
        return self._replace(values=np.where(kept, self.values, np.nan))

    def part(self, rows: Mask, columns: Mask) -> Sample:
        """The same on a part of its plants and situations."""
        weights = self.weights._replace(plants=self.weights.plants[:, rows])
        return Sample(self.values[:, rows][:, :, columns], weights)


class Grid:
    """Cases as arrays (S, U, K): training seeds, plants (of all families), situations (condition and leak).

    Args:
        cases: rows of the part ``tracking`` of :class:`~hydro_agents.evaluation.runner.Results`.
    """

    def __init__(self, cases: pd.DataFrame) -> None:
        missing = {name: 0 for name in ("condition", "training_seed") if name not in cases}
        cases = cases.assign(**missing) if missing else cases
        self.controllers = [str(name) for name in cases["controller"].unique()]
        plants = cases[["family", "plant"]].drop_duplicates()
        situations = cases[["condition", "leakage_flow_lpm"]].drop_duplicates()
        self.family: NDArray[np.str_] = plants["family"].to_numpy().astype(str)
        self.condition: NDArray[np.str_] = situations["condition"].to_numpy().astype(str)
        self.leak = situations["leakage_flow_lpm"].to_numpy(dtype=np.float64)
        self.all_plants: Mask = np.ones(len(plants), dtype=np.bool_)
        self.all_situations: Mask = np.ones(len(situations), dtype=np.bool_)
        self._plants = pd.MultiIndex.from_frame(plants)
        self._situations = pd.MultiIndex.from_frame(situations)
        self._rows = {name: cases[cases["controller"] == name] for name in self.controllers}
        self._plant_weights = plant_weights(self.family)
        self._made: dict[tuple[str, str], Floats] = {}

    def _array(self, rows: pd.DataFrame, metric: str) -> Floats:
        seeds = {seed: index for index, seed in enumerate(sorted(rows["training_seed"].unique()))}
        filled = np.full((len(seeds), len(self._plants), len(self._situations)), np.nan)
        plant = self._plants.get_indexer(pd.MultiIndex.from_frame(rows[["family", "plant"]]))
        situation = self._situations.get_indexer(pd.MultiIndex.from_frame(rows[["condition", "leakage_flow_lpm"]]))
        kept = (plant >= 0) & (situation >= 0)
        seed = rows["training_seed"].map(seeds).to_numpy()
        filled[seed[kept], plant[kept], situation[kept]] = rows[metric].to_numpy(dtype=np.float64)[kept]
        return filled

    def values(self, controller: str, metric: str) -> Floats:
        """A metric of a controller, (S, U, K)."""
        if (controller, metric) not in self._made:
            self._made[controller, metric] = self._array(self._rows[controller], metric)
        return self._made[controller, metric]

    def sample(self, controller: str, metric: str, plants: Mask, situations: Mask) -> Sample:
        """A metric of a controller on some plants and situations."""
        rows, columns = np.ix_(plants, situations)
        values = self.values(controller, metric)[:, rows, columns]
        # The weights of the plants are the same for all controllers.
        seeds = seed_weights(len(values), RESAMPLES, self.controllers.index(controller))
        return Sample(values, Weights(seeds, self._plant_weights[:, plants]))

    def mean(self, controller: str, metric: str, plants: Mask, situations: Mask) -> Interval:
        """Mean of a metric over some plants and situations of a controller."""
        chosen = self.sample(controller, metric, plants, situations).dense
        return interval(chosen.mean, chosen.plants)

    def under(self, condition: str) -> Mask:
        """The situations of a condition, or all of them."""
        return self.all_situations if condition == ALL else np.asarray(self.condition == condition)

    def pair(self, controller: str, against: str, metric: str, *part: Mask) -> tuple[Sample, Sample]:
        """A metric of two controllers on their common cases of some plants and situations."""
        mine, theirs = (self.sample(name, metric, *part) for name in (controller, against))
        common = mine.present & theirs.present
        return mine.where(common), theirs.where(common)

    def ratio(self, controller: str, against: str, metric: str) -> Interval:
        """Ratio of the means of a metric over the plants that both controllers have."""
        mine, theirs = self.pair(controller, against, metric, self.all_plants, self.all_situations)
        return interval(mine.mean / theirs.mean, mine.plants)

    def compare(self, controller: str, against: str, plants: Mask, situations: Mask) -> dict[str, float]:
        """Columns of one row of a comparison over some plants and situations of both controllers."""
        mine, theirs = self.pair(controller, against, ERROR, plants, situations)
        sensed, their_sensed = self.pair(controller, against, ERROR_SENSOR, plants, situations)
        kinds = list(self._kinds(plants, situations))
        ratios = mine.values / theirs.expected
        better = np.where(np.isnan(ratios), np.nan, mine.values < theirs.expected)
        statistics = {
            "ratio": mine.mean / theirs.mean,
            "equal_weight": _geometric_mean(_ratios(mine, theirs, kinds)),
            "ratio_sensor": sensed.mean / their_sensed.mean,
            "equal_weight_sensor": _geometric_mean(_ratios(sensed, their_sensed, kinds)),
            "iqm_ratio": interquartile_means(ratios, mine.weights),
            "share_better": means(better, mine.weights),
            "probability_of_improvement": improvements(mine.values, theirs.values, mine.weights, theirs.weights.seeds),
        }
        row: dict[str, float] = {}
        for name, resampled in statistics.items():
            row |= interval(resampled, mine.plants).named(name)
        row["worst_ratio"] = float(np.nanmax(ratios, initial=-np.inf)) if mine.plants else np.nan
        for name, metric in COMPARED.items():
            row[name] = _ratio(*self.pair(controller, against, metric.name, plants, situations))
        return row | {"cases": int((~np.isnan(mine.values)).sum())}

    def comparisons(self, column: str, parts: Iterable[tuple[str, Mask, Mask]]) -> pd.DataFrame:
        """Each controller against the first on named parts of the grid, one row each; the name is in ``column``."""
        rows, baseline = [], self.controllers[0]
        for controller in self.controllers[1:]:
            for name, plants, situations in parts:
                row = self.compare(controller, baseline, plants, situations)
                if row["cases"]:
                    rows.append({"controller": controller, "against": baseline, column: name, **row})
        return pd.DataFrame(rows)

    def corrected(self, pairs: Mapping[str, str]) -> pd.DataFrame:
        """Each policy against the controller that it corrects, unless that is the first one; ``pairs``: their names."""
        rows = []
        for name, base in pairs.items():
            if {name, base} <= set(self.controllers) and base != self.controllers[0]:
                row = self.compare(name, base, self.all_plants, self.all_situations)
                rows.append({"controller": name, "against": base, **row})
        return pd.DataFrame(rows)

    def _kinds(self, plants: Mask, situations: Mask) -> Iterator[tuple[Mask, Mask]]:
        """The plants of each family, and the situations of each condition."""
        families, conditions = self.family[plants], self.condition[situations]
        for condition in dict.fromkeys(conditions.tolist()):
            for family in dict.fromkeys(families.tolist()):
                yield families == family, conditions == condition


def _ratios(mine: Sample, theirs: Sample, kinds: list[tuple[Mask, Mask]]) -> Floats:
    """Ratio of the mean errors for each kind that has cases, in every resampling: (rows, R + 1)."""
    pairs = [(mine.part(*kind), theirs.part(*kind)) for kind in kinds]
    ratios = [own.mean / base.mean for own, base in pairs if own.plants and base.plants]
    return np.array(ratios) if ratios else np.full((1, len(mine.weights.plants)), np.nan)


def _geometric_mean(ratios: Floats) -> Floats:
    """Over the rows, all with the same weight."""
    return np.asarray(np.exp(np.mean(np.log(ratios), axis=0)))


def _ratio(mine: Sample, theirs: Sample) -> float:
    """Ratio of the means of a metric; NaN without cases, and to a mean of zero."""
    if not mine.plants:
        return float("nan")
    own, base = float(np.nanmean(mine.values)), float(np.nanmean(theirs.values))
    return own / base if base != 0.0 else float("nan")
