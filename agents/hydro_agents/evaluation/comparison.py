"""Compares controllers on the same cases: ratios, shares and probabilities, each with its interval."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.evaluation.metrics import COMPARED, ERROR, ERROR_SENSOR
from hydro_agents.running.statistics import RESAMPLES, Weights, interval, means, plant_weights, seed_weights
from hydro_env.types import Floats, Mask

ALL = "all"  # name of the group over all cases


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
            return np.nansum(self.values, axis=0) / (~np.isnan(self.values)).sum(axis=0)

    @property
    def plants(self) -> int:
        """Number of plants with a case."""
        return self.present.any(axis=1).sum()

    def where(self, kept: Mask) -> "Sample":
        """The same without the values of other cases."""
        return self._replace(values=np.where(kept, self.values, np.nan))

    def part(self, rows: Mask, columns: Mask) -> "Sample":
        """The same on a part of its plants and situations."""
        return Sample(self.values[:, rows][:, :, columns], self.weights._replace(plants=self.weights.plants[:, rows]))


class Grid:
    """Rows of the table ``cases`` as arrays (S, U, K): training seeds, plants (of all families), and situations.

    A situation is a condition and a leak.
    """

    def __init__(self, cases: pd.DataFrame) -> None:
        self.controllers = cases["controller"].unique().tolist()
        plants = cases[["family", "plant"]].drop_duplicates()
        situations = cases[["condition", "leakage_flow_lpm"]].drop_duplicates()
        self.family = plants["family"].to_numpy(str)
        self.condition = situations["condition"].to_numpy(str)
        self.leak = situations["leakage_flow_lpm"].to_numpy(float)
        self.all_plants = np.ones(len(plants), bool)
        self.all_situations = np.ones(len(situations), bool)
        self._plant = _places(plants, cases)
        self._situation = _places(situations, cases)
        self._cases = cases
        self._of = {name: (cases["controller"] == name).to_numpy() for name in self.controllers}
        self._plant_weights = plant_weights(self.family)
        self._made: dict[tuple[str, str], Floats] = {}

    def values(self, controller: str, metric: str) -> Floats:
        """A metric of a controller, (S, U, K)."""
        if (controller, metric) not in self._made:
            own = self._of[controller]
            seeds, seed = np.unique(self._cases["training_seed"].to_numpy()[own], return_inverse=True)
            filled = np.full((len(seeds), len(self.all_plants), len(self.all_situations)), np.nan)
            filled[seed, self._plant[own], self._situation[own]] = self._cases[metric].to_numpy(float)[own]
            self._made[controller, metric] = filled
        return self._made[controller, metric]

    def sample(self, controller: str, metric: str, plants: Mask, situations: Mask) -> Sample:
        """A metric of a controller on some plants and situations."""
        rows, columns = np.ix_(plants, situations)
        values = self.values(controller, metric)[:, rows, columns]
        # The weights of the plants are the same for all controllers.
        seeds = seed_weights(len(values), RESAMPLES, self.controllers.index(controller))
        return Sample(values, Weights(seeds, self._plant_weights[:, plants]))

    def parts(self, families_under: Mask) -> Iterator[tuple[str, str, Mask, Mask]]:
        """Group, value, plants and situations of the rows of a table.

        The groups are all cases, each condition (or, of a single condition, each leak), and each family under the
        situations ``families_under``.
        """
        yield ALL, "", self.all_plants, self.all_situations
        conditions = list(dict.fromkeys(self.condition.tolist()))
        if len(conditions) > 1:
            for name in conditions:
                yield "condition", name, self.all_plants, self.condition == name
        else:
            for leak in dict.fromkeys(self.leak):
                yield "level", str(leak), self.all_plants, self.leak == leak
        for family in dict.fromkeys(self.family.tolist()):
            yield "family", family, self.family == family, families_under

    def pair(self, controller: str, against: str, metric: str, *part: Mask) -> tuple[Sample, Sample]:
        """A metric of two controllers on their common cases of some plants and situations."""
        mine, theirs = (self.sample(name, metric, *part) for name in (controller, against))
        common = mine.present & theirs.present
        return mine.where(common), theirs.where(common)

    def compare(self, controller: str, against: str, plants: Mask, situations: Mask) -> dict[str, float]:
        """Columns of one row of a comparison over some plants and situations of both controllers."""
        mine, theirs = self.pair(controller, against, ERROR, plants, situations)
        sensed, their_sensed = self.pair(controller, against, ERROR_SENSOR, plants, situations)
        kinds = self._kinds(plants, situations)
        ratios = mine.values / theirs.expected
        better = np.where(np.isnan(ratios), np.nan, mine.values < theirs.expected)
        statistics = {
            "ratio": mine.mean / theirs.mean,
            "equal_weight": _equal_weight(mine, theirs, kinds),
            "ratio_sensor": sensed.mean / their_sensed.mean,
            "equal_weight_sensor": _equal_weight(sensed, their_sensed, kinds),
            "share_better": means(better, mine.weights),
        }
        row: dict[str, float] = {}
        for name, resampled in statistics.items():
            row |= interval(resampled, mine.plants).named(name)
        row["worst_ratio"] = np.nanmax(ratios, initial=-np.inf) if mine.plants else np.nan
        for name, metric in COMPARED.items():
            row[name] = _ratio(*self.pair(controller, against, metric.name, plants, situations))
        return row | {"cases": (~np.isnan(mine.values)).sum()}

    def _kinds(self, plants: Mask, situations: Mask) -> list[tuple[Mask, Mask]]:
        """The plants of each family, and the situations of each condition."""
        families, conditions = self.family[plants], self.condition[situations]
        return [
            (families == family, conditions == condition)
            for condition in dict.fromkeys(conditions)
            for family in dict.fromkeys(families)
        ]


def _places(known: pd.DataFrame, rows: pd.DataFrame) -> NDArray[np.intp]:
    """For each row the place of its values among known ones of the same columns."""
    return pd.MultiIndex.from_frame(known).get_indexer(pd.MultiIndex.from_frame(rows[list(known)]))


def _equal_weight(mine: Sample, theirs: Sample, kinds: list[tuple[Mask, Mask]]) -> Floats:
    """Geometric mean of the ratios of the mean errors over the kinds that have cases, in every resampling, (R + 1,)."""
    ratios = []
    for kind in kinds:
        own, base = mine.part(*kind), theirs.part(*kind)
        if own.plants and base.plants:
            ratios.append(own.mean / base.mean)
    if not ratios:
        return np.full(len(mine.weights.plants), np.nan)
    return np.exp(np.mean(np.log(ratios), axis=0))


def _ratio(mine: Sample, theirs: Sample) -> float:
    """Ratio of the means of a metric; NaN without cases, and to a mean of zero."""
    if not mine.plants:
        return np.nan
    own, base = float(np.nanmean(mine.values)), float(np.nanmean(theirs.values))
    return own / base if base != 0.0 else np.nan
