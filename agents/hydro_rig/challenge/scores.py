"""``hydro score``: the predictions of any detector on the benchmark of leaking axes.

A recording gives at most one false alarm: at any look before the seal leaks, or at any look of an axis whose seal never
leaks. A leak is found if the first alarm comes after its onset. The ranked figure is that of the free-response ROC
(Bunch et al. 1978): the mean share of leaks found at the false-alarm rates :data:`BUDGETS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.detection.detector import Cause, threshold_at_false_alarm_rate
from hydro_agents.running.statistics import Interval, interval, plant_weights, share_interval
from hydro_agents.running.text import markdown, number
from hydro_env import ConfigurationError
from hydro_env.files import read_json
from hydro_env.types import Floats
from hydro_rig.challenge.axes import SPLITS
from hydro_rig.challenge.files import MANIFEST, digest_of_labels, read_labels
from hydro_rig.monitoring.alarm_calibration import poisson_interval

BUDGETS = (1.0, 2.0, 5.0, 10.0, 20.0)
"""False alarms per hour of the ranked figure."""

SHOWN_BUDGET = 2.0  # false alarms per hour at which delay and misses are shown, without alarms of the detector's own

REQUIRED = ("recording", "time", "score")
OPTIONAL = ("alarm", "probability", "cause", "size", "low", "high")

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
    onset: Floats  # s
    alarm: Floats  # s, the detector's own first alarm; NaN: none, or it gives none

    def part(self, chosen: NDArray[Any]) -> Outcomes:
        """Those of some recordings."""
        return Outcomes(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

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


class Score(NamedTuple):
    """All that the benchmark says about a detector."""

    name: str
    outcomes: Outcomes
    row: dict[str, Any]  # of the table
    by_tier: dict[int, Interval]
    confusion: pd.DataFrame | None  # share of each cause that is named, true causes as rows; None: names none


def score(name: str, predictions: pd.DataFrame, labels: pd.DataFrame) -> Score:
    """Score predictions.

    Args:
        name: of the detector, for tables and messages.
        predictions: a row per look, with the columns REQUIRED and any of OPTIONAL.
        labels: of one split, a row per recording.

    Raises:
        ConfigurationError: a column is missing, a value is impossible, or a recording is unknown or has no look.
    """
    looks = _checked(name, predictions, labels)
    outcomes, first = _outcomes(looks, labels)
    shares = outcomes.with_interval()
    row: dict[str, Any] = {"detector": name, **shares.columns("found_share")}
    row |= _alarms(outcomes, looks, first)
    last = looks.groupby("recording").last().reindex(labels["recording"])
    row |= _sizes(last, labels)
    by_tier = {int(t): outcomes.part(outcomes.tier == t).with_interval() for t in np.unique(outcomes.tier)}
    confusion = None
    if "cause" in looks:
        named = last["cause"].fillna("none").to_numpy()
        confusion = pd.crosstab(labels["cause"].to_numpy(), named, normalize="index")
        right = [float((named[labels["cause"] == cause] == cause).mean()) for cause in labels["cause"].unique()]
        row["cause_right"] = float(np.mean(right))
    return Score(name, outcomes, row, by_tier, confusion)


def _checked(name: str, predictions: pd.DataFrame, labels: pd.DataFrame) -> pd.DataFrame:
    missing = [column for column in REQUIRED if column not in predictions]
    if missing:
        raise ConfigurationError(f"{name}: has no column {', '.join(missing)}; required are {', '.join(REQUIRED)}")
    looks = predictions[[*REQUIRED, *(column for column in OPTIONAL if column in predictions)]].copy()
    for column in (*REQUIRED, *("probability", "size", "low", "high")):
        if column in looks:
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


def _outcomes(looks: pd.DataFrame, labels: pd.DataFrame) -> tuple[Outcomes, Floats]:
    """The outcomes, and per look the time since the onset (negative or NaN: the seal does not leak)."""
    order = labels["recording"]
    since = looks["time"].to_numpy() - looks["recording"].map(labels.set_index("recording")["onset"]).to_numpy()
    leaking = since >= 0.0
    values = looks["score"].fillna(-np.inf)

    def highest(chosen: NDArray[np.bool_]) -> Floats:
        found = values[chosen].groupby(looks.loc[chosen, "recording"]).max()
        return np.asarray(found.reindex(order).fillna(-np.inf).to_numpy(dtype=np.float64))

    alarm = np.full(len(order), np.nan)
    if "alarm" in looks:
        raised = looks[looks["alarm"].fillna(False).astype(bool)]
        alarm = raised.groupby("recording")["time"].min().reindex(order).to_numpy(dtype=np.float64)
    onset, leak = labels["onset"].to_numpy(dtype=np.float64), labels["leak"].to_numpy(dtype=bool)
    free = np.where(leak, onset, labels["seconds"]) / 3600.0
    tier = labels["tier"].to_numpy(dtype=np.int64)
    return Outcomes(tier, leak, free, highest(~leaking), highest(leaking), onset, alarm), since


def _alarms(outcomes: Outcomes, looks: pd.DataFrame, since: Floats) -> dict[str, Any]:
    """False alarms, misses and delays: of the detector's own alarm, or at SHOWN_BUDGET."""
    leak, own = outcomes.leak, "alarm" in looks
    if own:
        first = outcomes.alarm
        wrong = np.isfinite(first) & ~(leak & (first >= outcomes.onset))
    else:
        threshold = outcomes.threshold(SHOWN_BUDGET)
        wrong = outcomes.before >= threshold
        raised = looks.assign(since=since)[(since >= 0.0) & (looks["score"] >= threshold)]
        delays = raised.groupby("recording")["since"].min().reindex(np.unique(looks["recording"]))
        first = delays.to_numpy(dtype=np.float64) + outcomes.onset
    found = leak & np.isfinite(first) & ~wrong
    delay = np.where(found, first - outcomes.onset, np.inf)[leak]
    hours = float(outcomes.free.sum())
    return {
        "alarm": "its own" if own else f"at {SHOWN_BUDGET:g} per hour",
        **poisson_interval(int(wrong.sum()), hours / 100.0).named("per_100_h"),
        "hours": hours,
        **share_interval(int((leak & ~found).sum()), int(leak.sum())).named("missed"),
        "delay": float(np.median(delay)) if len(delay) else float("nan"),
    }


def _sizes(last: pd.DataFrame, labels: pd.DataFrame) -> dict[str, float]:
    """Calibration of probability, size and interval at the last look."""
    found: dict[str, float] = {}
    leak = labels["leak"].to_numpy(dtype=bool)
    truth = labels["size"].to_numpy(dtype=np.float64)
    if "probability" in last:
        told = last["probability"].fillna(0.5).to_numpy()
        found["brier"] = float(np.mean((told - leak) ** 2))
        bins = np.minimum((10 * told).astype(int), 9)
        found["calibration_error"] = float(
            sum(abs((told - leak)[bins == each].sum()) for each in range(10)) / len(told)
        )
    if "size" in last:
        known = leak & (last["size"].to_numpy() > 0.0)
        ratio = np.abs(np.log(last["size"].to_numpy()[known] / truth[known]))
        found["size_factor"] = float(np.exp(np.median(ratio))) if known.any() else float("nan")
    if {"low", "high"} <= set(last):
        told_interval = (last["low"].notna() & last["high"].notna()).to_numpy() & leak
        inside = (last["low"].to_numpy() <= truth) & (truth <= last["high"].to_numpy())
        found["interval_holds"] = float(inside[told_interval].mean()) if told_interval.any() else float("nan")
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
    table = table.sort_values("recording", ignore_index=True) if "recording" in table else table
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
    rows = []
    for one in ordered:
        row = one.row
        tiers = [_share(*each) for each in one.by_tier.values()]
        per_hours = f"{number(row['per_100_h'])} ({number(row['per_100_h_low'])} to {number(row['per_100_h_high'])})"
        missed = _share(row["missed"], row["missed_low"], row["missed_high"])
        rest = [_known(row, "cause_right", 100, " %"), _known(row, "brier"), _known(row, "size_factor", 1, " ×")]
        rest.append(_known(row, "interval_holds", 100, " %"))
        whole = _share(row["found_share"], row["low"], row["high"])
        rows.append([one.name, whole, *tiers, f"{per_hours}, {row['alarm']}", missed, number(row["delay"]), *rest])
    parts = [markdown(header, rows)]
    rates = ", ".join(f"{rate:g}" for rate in BUDGETS)
    parts.append(
        f"Leaks found: mean share at {rates} false alarms per hour, with its 95 % interval over recordings. "
        f"{number(ordered[0].row['hours'])} h without a leak."
    )
    for one in ordered:
        if one.confusion is not None:
            named = list(one.confusion.columns)
            cells = [[cause, *(f"{100 * v:.0f} %" for v in values)] for cause, values in one.confusion.iterrows()]
            parts.append(f"Causes named by {one.name}:")
            parts.append(markdown(["true cause", *named], cells))
    return "\n\n".join(parts)


def _share(value: float, low: float, high: float) -> str:
    return f"{number(100 * value, 1)} % ({number(100 * low, 0)} to {number(100 * high, 0)})"


def _known(row: Mapping[str, Any], name: str, scale: float = 1.0, unit: str = "") -> str:
    return f"{number(scale * row[name])}{unit}" if name in row else "–"
