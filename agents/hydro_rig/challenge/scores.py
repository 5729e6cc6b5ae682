"""``hydro score``: the predictions of any detector on the benchmark of leaking axes.

A recording gives at most one false alarm: at any look before the seal leaks, or at any look of an axis whose seal never
leaks. A leak is found if the first alarm comes after its onset. The ranked figure is that of the free-response ROC
(Bunch et al. 1978): the mean share of leaks found at the false-alarm rates :data:`BUDGETS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2

from hydro_agents.detection.detector import Cause, threshold_at_false_alarm_rate
from hydro_agents.running.statistics import CONFIDENCE, Interval, interval, plant_weights, share_interval
from hydro_agents.running.text import markdown, number
from hydro_env import ConfigurationError
from hydro_env.files import read_json
from hydro_env.types import Floats
from hydro_rig.challenge.axes import SPLITS
from hydro_rig.challenge.files import MANIFEST, digest_of_labels, read_labels

BUDGETS = (1.0, 2.0, 5.0, 10.0, 20.0)
"""False alarms per hour of the ranked figure."""

SHOWN_BUDGET = 2.0  # false alarms per hour at which delay and misses are shown, without alarms of the detector's own

REQUIRED = ("recording", "time", "score")
OPTIONAL = ("alarm", "probability", "cause", "size", "low", "high")
NUMBERS = (*REQUIRED, "probability", "size", "low", "high")

RESAMPLES = 200
CAUSES = tuple(dict.fromkeys(cause.word for cause in Cause if cause < Cause.UNKNOWN))


@dataclass(frozen=True)
class Outcomes:
    """What a detector made of N recordings; each field (N,)."""

    tier: NDArray[np.int64]
    leak: NDArray[np.bool_]
    free: Floats  # h, without a leak
    before: Floats  # highest score without a leak; −inf: no look
    after: Floats  # highest score from the onset on; −inf: no look or no leak

    def part(self, chosen: NDArray[Any]) -> Outcomes:
        """Those of some recordings."""
        return Outcomes(*(values[chosen] for values in vars(self).values()))

    def threshold(self, per_hour: float) -> float:
        """Lowest score that gives at most this many false alarms per hour."""
        looked = self.before[np.isfinite(self.before)]
        if not len(looked):
            return -np.inf
        return threshold_at_false_alarm_rate(looked, min(per_hour * float(self.free.sum()) / len(looked), 1.0))

    def found(self, threshold: float) -> NDArray[np.bool_]:
        """Leaks whose first alarm comes after the onset, (N,)."""
        return self.leak & (self.after >= threshold) & ~(self.before >= threshold)

    @property
    def found_share(self) -> float:
        """Mean share of leaks found at the false-alarm rates BUDGETS."""
        if not self.leak.any():
            return float("nan")
        return float(np.mean([self.found(self.threshold(rate))[self.leak].mean() for rate in BUDGETS]))

    def with_interval(self) -> Interval:
        """:attr:`found_share` with its 95 % bootstrap interval over recordings, stratified by tier."""
        weights = plant_weights(self.tier, RESAMPLES)
        drawn = [self.part(np.repeat(np.arange(len(row)), row.astype(int))).found_share for row in weights]
        return interval(np.array(drawn), len(self.tier))


@dataclass(frozen=True)
class Score:
    """All that the benchmark says about a detector."""

    name: str
    outcomes: Outcomes
    row: dict[str, Any]  # of the table
    by_tier: dict[int, Interval]


def score(name: str, predictions: pd.DataFrame, labels: pd.DataFrame) -> Score:
    """Score predictions.

    Args:
        name: of the detector, for tables and messages.
        predictions: a row per look, with the columns REQUIRED and any of OPTIONAL.
        labels: of one split, a row per recording, in the order of their numbers.

    Raises:
        ConfigurationError: a column is missing, a value is impossible, or a recording is unknown or has no look.
    """
    looks = _checked(name, predictions, labels)
    outcomes = _outcomes(looks, labels)
    last = looks.groupby("recording").last().reindex(labels["recording"])
    row = {"detector": name, **outcomes.with_interval().columns("found_share")}
    row |= _alarms(outcomes, looks, labels) | _sizes(last, labels)
    by_tier = {int(tier): outcomes.part(outcomes.tier == tier).with_interval() for tier in np.unique(outcomes.tier)}
    if "cause" in looks:
        truth, named = labels["cause"], last["cause"].fillna("none").to_numpy()
        row["cause_right"] = float(np.mean([(named[truth == cause] == cause).mean() for cause in truth.unique()]))
    return Score(name, outcomes, row, by_tier)


def _checked(name: str, predictions: pd.DataFrame, labels: pd.DataFrame) -> pd.DataFrame:
    missing = [column for column in REQUIRED if column not in predictions]
    if missing:
        raise ConfigurationError(f"{name}: has no column {', '.join(missing)}; required are {', '.join(REQUIRED)}")
    looks = predictions[[*REQUIRED, *(column for column in OPTIONAL if column in predictions)]].copy()
    for column in looks.columns.intersection(NUMBERS):
        try:
            looks[column] = pd.to_numeric(looks[column]).astype(np.float64)
        except (TypeError, ValueError):
            raise ConfigurationError(f"{name}: column '{column}' must hold numbers") from None
    seconds = labels.set_index("recording")["seconds"]
    unknown = looks.loc[~looks["recording"].isin(seconds.index), "recording"]
    if len(unknown):
        raise ConfigurationError(f"{name}: recording {unknown.iloc[0]:g} is not in this split")
    absent = seconds.index.difference(looks["recording"])
    if len(absent):
        raise ConfigurationError(
            f"{name}: {len(absent)} of {len(seconds)} recordings have no row, such as {absent[0]}; a look without an "
            "answer is a row with an empty score"
        )
    late = looks[~((looks["time"] >= 0.0) & (looks["time"] <= looks["recording"].map(seconds) + 1e-6))]
    if len(late):
        bad = late.iloc[0]
        raise ConfigurationError(
            f"{name}: recording {bad['recording']:g}, time {bad['time']:g} s: must be within the recording, 0 to "
            f"{seconds[int(bad['recording'])]:g} s"
        )
    if "probability" in looks and not looks["probability"].dropna().between(0.0, 1.0).all():
        raise ConfigurationError(f"{name}: probability must be within 0 to 1")
    if "cause" in looks:
        odd = looks.loc[~looks["cause"].isin(CAUSES) & looks["cause"].notna(), "cause"]
        if len(odd):
            raise ConfigurationError(f"{name}: cause '{odd.iloc[0]}': must be one of {', '.join(CAUSES)}")
    return looks.sort_values(["recording", "time"], kind="stable", ignore_index=True)


def _outcomes(looks: pd.DataFrame, labels: pd.DataFrame) -> Outcomes:
    onset = looks["recording"].map(labels.set_index("recording")["onset"])
    leaking = looks["time"] >= onset  # never where it is NaN: the seal does not leak

    def highest(chosen: pd.Series) -> Floats:
        found = looks[chosen].groupby("recording")["score"].max()
        return np.asarray(found.reindex(labels["recording"]).fillna(-np.inf).to_numpy(dtype=np.float64))

    leak = labels["leak"].to_numpy(dtype=bool)
    free = np.where(leak, labels["onset"].to_numpy(dtype=np.float64), labels["seconds"]) / 3600.0
    return Outcomes(labels["tier"].to_numpy(dtype=np.int64), leak, free, highest(~leaking), highest(leaking))


def _alarms(outcomes: Outcomes, looks: pd.DataFrame, labels: pd.DataFrame) -> dict[str, Any]:
    """False alarms, misses and delays: of the detector's own alarm, or at SHOWN_BUDGET."""
    own, leak = "alarm" in looks, outcomes.leak
    if own:
        raised = looks["alarm"].fillna(False).astype(bool)
    else:
        raised = looks["score"].fillna(-np.inf) >= outcomes.threshold(SHOWN_BUDGET)
    first = looks[raised].groupby("recording")["time"].min().reindex(labels["recording"]).to_numpy(dtype=np.float64)
    onset = labels["onset"].to_numpy(dtype=np.float64)
    found = leak & (first >= onset)
    wrong = np.isfinite(first) & ~found
    delay = np.where(found, first - onset, np.inf)[leak]
    hours = float(outcomes.free.sum())
    return {
        "alarm": "its own" if own else f"at {SHOWN_BUDGET:g} per hour",
        **poisson_interval(int(wrong.sum()), hours / 100.0).named("per_100_h"),
        "hours": hours,
        **share_interval(int((leak & ~found).sum()), int(leak.sum())).named("missed"),
        "delay": float(np.median(delay)) if len(delay) else float("nan"),
    }


def poisson_interval(count: int, exposure: float) -> Interval:
    """Rate of events per unit of exposure, with its exact interval (Garwood, Biometrika 28, 1936); NaN without any."""
    if not exposure > 0.0:
        return Interval(np.nan, np.nan, np.nan)
    outside = 0.5 * (1.0 - CONFIDENCE)
    low = 0.5 * float(chi2.ppf(outside, 2 * count)) if count else 0.0
    return Interval(count / exposure, low / exposure, 0.5 * float(chi2.ppf(1.0 - outside, 2 * count + 2)) / exposure)


def _sizes(last: pd.DataFrame, labels: pd.DataFrame) -> dict[str, float]:
    """Calibration of probability, size and interval at the last look."""
    found: dict[str, float] = {}
    leak, truth = labels["leak"].to_numpy(dtype=bool), labels["size"].to_numpy(dtype=np.float64)
    if "probability" in last:
        probability = last["probability"].fillna(0.5).to_numpy()
        found["brier"] = float(np.mean((probability - leak) ** 2))
    if "size" in last:
        size = last["size"].to_numpy()
        known = leak & (size > 0.0)
        ratio = np.abs(np.log(size[known] / truth[known]))
        found["size_factor"] = float(np.exp(np.median(ratio))) if known.any() else float("nan")
    if {"low", "high"} <= set(last):
        known = leak & (last["low"].notna() & last["high"].notna()).to_numpy()
        inside = (last["low"].to_numpy() <= truth) & (truth <= last["high"].to_numpy())
        found["interval_holds"] = float(inside[known].mean()) if known.any() else float("nan")
    return found


def labels_of(folder: Path, split: str) -> pd.DataFrame:
    """The labels of a split of a benchmark, checked against the SHA-256 in its ``benchmark.json``.

    Raises:
        ConfigurationError: there is no benchmark, the labels are not there, or they were changed.
    """
    if split not in SPLITS:
        raise ConfigurationError(f"--split {split}: must be one of {', '.join(SPLITS)}")
    expected = read_json(folder / MANIFEST).get("labels_sha256", {})
    table = read_labels(folder, split)
    if not isinstance(expected, Mapping) or digest_of_labels(table) != expected.get(split):
        raise ConfigurationError(f"{folder}: the labels of '{split}' are not those of {folder / MANIFEST}")
    return table


def table_of(scores: Sequence[Score]) -> pd.DataFrame:
    """A row per detector, the best first."""
    rows = pd.DataFrame([one.row for one in scores])
    return rows.sort_values("found_share", ascending=False, kind="stable", ignore_index=True)


def text_of(scores: Sequence[Score]) -> str:
    """The scores as Markdown."""
    ordered = sorted(scores, key=lambda one: -one.row["found_share"])
    header = ["detector", "leaks found", *(f"tier {tier}" for tier in ordered[0].by_tier)]
    header += ["false alarms per 100 h", "missed", "median delay, s"]
    header += ["cause right", "Brier score", "size off by", "90 % interval holds"]
    rates = ", ".join(f"{rate:g}" for rate in BUDGETS)
    table = markdown(header, [_cells(one) for one in ordered])
    return (
        f"{table}\n\nLeaks found: mean share at {rates} false alarms per hour, with its 95 % interval over recordings. "
        f"{number(ordered[0].row['hours'])} h without a leak."
    )


def _cells(one: Score) -> list[str]:
    """The row of a detector."""
    row = one.row
    shares = [(row["found_share"], row["low"], row["high"]), *one.by_tier.values()]
    missed = row["missed"], row["missed_low"], row["missed_high"]
    whole, *tiers, missing = (
        f"{number(100 * value, 1)} % ({number(100 * low, 0)} to {number(100 * high, 0)})"
        for value, low, high in (*shares, missed)
    )
    rate = f"{number(row['per_100_h'])} ({number(row['per_100_h_low'])} to {number(row['per_100_h_high'])})"
    rest = [
        f"{number(scale * row[name])}{unit}" if name in row else "–"
        for name, scale, unit in (
            ("cause_right", 100.0, " %"),
            ("brier", 1.0, ""),
            ("size_factor", 1.0, " ×"),
            ("interval_holds", 100.0, " %"),
        )
    ]
    return [one.name, whole, *tiers, f"{rate}, {row['alarm']}", missing, number(row["delay"]), *rest]
