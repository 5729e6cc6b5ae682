"""Score tables of predictions in the challenge: leaks found, delay, sizes; README.md explains them.

python -m challenge.score DATA PREDICTIONS... [--split test] [--output scores.csv]
"""

from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd

from benchmarks import command_line
from challenge.recordings import TIERS, labels_folder
from hydro_agents.detection.detector import threshold_at_false_alarm_rate
from hydro_agents.running.statistics import interval, plant_weights, share_interval
from hydro_env.types import Floats, Indices, Mask

BUDGETS = (1.0, 2.0, 5.0, 10.0, 20.0)  # false alarms per hour of the ranked figure
SHOWN_BUDGET = 2.0  # false alarms per hour at which misses and delay are shown
RESAMPLES = 200


class Outcomes(NamedTuple):
    """What a detector made of N recordings; each field (N,)."""

    tier: Indices
    leak: Mask
    free: Floats  # h, without a leak
    before: Floats  # highest score without a leak; −inf: no look
    after: Floats  # highest score from the onset on; −inf: no look or no leak

    def part(self, chosen: Any) -> Self:
        """Those of some recordings."""
        return type(self)(*(field[chosen] for field in self))

    def threshold(self, per_hour: float) -> float:
        """Lowest score that gives at most this many false alarms per hour; a recording gives at most one."""
        looked = self.before[np.isfinite(self.before)]
        if not len(looked):
            return -np.inf
        return threshold_at_false_alarm_rate(looked, min(per_hour * float(self.free.sum()) / len(looked), 1.0))

    def found(self, threshold: float) -> Mask:
        """Leaks whose first alarm comes after the onset, (N,)."""
        return self.leak & np.isfinite(self.after) & (self.after >= threshold) & ~(self.before >= threshold)

    def found_share(self) -> float:
        """Mean share of leaks found at the false-alarm rates BUDGETS (free-response ROC, Bunch et al. 1978)."""
        if not self.leak.any():
            return float("nan")
        shares = [self.found(self.threshold(rate))[self.leak].mean() for rate in BUDGETS]
        return float(np.mean(shares))


def counted(looks: pd.DataFrame, labels: pd.DataFrame) -> pd.DataFrame:
    """The rows that count, in the order of recording and time: of a recording of the split, within it, none twice."""
    seconds = looks["recording"].map(labels.set_index("recording")["seconds"])
    inside = (looks["time"] >= 0.0) & (looks["time"] <= seconds + 1e-6)
    kept = looks[inside & ~looks.duplicated(["recording", "time"])]
    return kept.sort_values(["recording", "time"], kind="stable", ignore_index=True)


def outcomes_of(looks: pd.DataFrame, labels: pd.DataFrame) -> Outcomes:
    """The outcomes of looks that count."""
    onset = looks["recording"].map(labels.set_index("recording")["onset"])
    leaking = looks["time"] >= onset  # false where the seal never leaks
    scores = looks["score"].fillna(-np.inf)
    highest = []
    for chosen in (~leaking, leaking):
        found = scores[chosen].groupby(looks.loc[chosen, "recording"]).max()
        highest.append(found.reindex(labels["recording"]).fillna(-np.inf).to_numpy(dtype=np.float64))
    leak = labels["leak"].to_numpy(dtype=bool)
    free = np.where(leak, labels["onset"], labels["seconds"]) / 3600.0
    return Outcomes(labels["tier"].to_numpy(), leak, free, *highest)


def score(predictions: pd.DataFrame, labels: pd.DataFrame) -> dict[str, float]:
    """The figures of predictions beside the labels of one split; a recording without a row has no answer.

    A row per look: ``recording``, ``time`` (s), ``score``, perhaps ``size``, ``low`` and ``high`` (l/min at 100 bar).
    """
    looks = counted(predictions, labels)
    all_of_them = outcomes_of(looks, labels)
    drawn = [np.repeat(np.arange(len(row)), row.astype(int)) for row in plant_weights(all_of_them.tier, RESAMPLES)]
    resampled = np.array([all_of_them.part(one).found_share() for one in drawn])
    row = interval(resampled, len(labels)).named("found")
    groups = {f"tier {tier}": labels["tier"] == tier for tier in TIERS}
    groups |= {"known axes": ~labels["new_axis"], "new axes": labels["new_axis"]}
    for name, chosen in groups.items():  # at the thresholds of the group itself
        row[name] = all_of_them.part(chosen.to_numpy(dtype=bool)).found_share()
    threshold = all_of_them.threshold(SHOWN_BUDGET)
    found = all_of_them.found(threshold)
    leaks = int(all_of_them.leak.sum())
    row |= share_interval(leaks - int(found.sum()), leaks).named("missed")
    onset = labels["onset"].to_numpy()
    raised = looks[looks["score"] >= threshold].merge(labels[["recording", "onset"]], on="recording")
    first = raised[raised["time"] >= raised["onset"]].groupby("recording")["time"].min()
    delay = first.reindex(labels["recording"]).to_numpy() - onset
    row["delay"] = float(np.median(np.where(found, delay, np.inf)[all_of_them.leak]))  # s; a miss is infinite
    last = looks.groupby("recording").last().reindex(labels["recording"])
    if {"size", "low", "high"} <= set(looks):
        size, low, high = last[["size", "low", "high"]].to_numpy(dtype=np.float64).T
        truth, told = labels["size"].to_numpy(), all_of_them.leak & np.isfinite(low + high)
        row["90 % interval holds"] = float(((low <= truth) & (truth <= high))[told].mean())
        known = all_of_them.leak & (size > 0.0)
        row["size off by"] = float(np.exp(np.median(np.abs(np.log(size[known] / truth[known])))))
    return row


def main() -> None:
    """Score the tables, print the figures, and write them."""
    given = command_line(__doc__, "data", "predictions...", split=("test", "train", "validation"), output=Path)
    labels = pd.read_parquet(labels_folder(given.data, given.split)).sort_values("recording", ignore_index=True)
    rows = {path.stem: score(pd.read_parquet(path), labels) for path in given.predictions}
    table = pd.DataFrame(rows)
    print(table.to_string(float_format="%.4g"))
    if given.output:
        table.T.to_csv(given.output, index_label="detector")


if __name__ == "__main__":
    main()
