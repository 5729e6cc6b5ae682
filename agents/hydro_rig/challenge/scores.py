"""``hydro score``: the predictions of any detector in the challenge, beside those of a perfect and of a silent one."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.detection.detector import Cause
from hydro_agents.running.statistics import Interval, poisson_interval, share_interval
from hydro_agents.running.text import markdown, number
from hydro_env import ConfigurationError
from hydro_env.files import read_json
from hydro_env.types import Floats
from hydro_rig.challenge.axes import HARSH, SPLITS, TIERS
from hydro_rig.challenge.files import MANIFEST, digest_of_labels, read_labels
from hydro_rig.challenge.outcomes import (
    BUDGETS,
    COST_RATIOS,
    HOURS_PER_YEAR,
    MONTHS_PER_YEAR,
    Outcomes,
    true_alarms,
)

SHOWN_BUDGET = 2.0  # false alarms per hour at which delay and misses are shown, without alarms of the detector's own

REQUIRED = ("recording", "time", "score")
OPTIONAL = ("alarm", "probability", "cause", "size", "low", "high")

CAUSES = tuple(dict.fromkeys(cause.word for cause in Cause if cause < Cause.UNKNOWN))
PERFECT, SILENT = "perfect", "silent"
"""Names of the two detectors that stand in every table: the best that can be, and one that never answers."""

ANSWERED = {
    "cause right": ("cause_right", 100, " %"),
    "Brier score": ("brier", 1, ""),
    "calibration error": ("calibration_error", 1, ""),
    "size off by": ("size_factor", 1, " ×"),
    "90 % interval holds": ("interval_holds", 100, " %"),
}
"""Heading, column, factor and unit of what a detector may answer."""

BINS = 10
"""Of the probability, for its calibration."""


class Score(NamedTuple):
    """All that the challenge says about a detector."""

    name: str
    outcomes: Outcomes
    row: dict[str, Any]  # of the table
    groups: dict[str, Interval]  # share found by tier, on known and new axes, under each disturbance
    reliability: pd.DataFrame  # per bin of the probability: its mean, the share of leaks, the count
    confusion: pd.DataFrame | None  # share of each cause that is named, true causes as rows; None: names none
    remarks: list[str]  # rows that do not count, and why


def score(name: str, predictions: pd.DataFrame, labels: pd.DataFrame) -> Score:
    """Score predictions.

    Args:
        name: of the detector, for tables and messages.
        predictions: a row per look, with the columns REQUIRED and any of OPTIONAL. A recording without a row has no
            answer; a row of an unknown recording, outside its recording, or for a time that has one already, does not
            count, and a remark says so.
        labels: of one split, a row per recording.

    Raises:
        ConfigurationError: a column is missing, or a value is impossible.
    """
    looks, remarks = _counted(_checked(name, predictions), labels)
    outcomes, since = _outcomes(looks, labels)
    row: dict[str, Any] = {"detector": name, **outcomes.with_interval().columns("found_share")}
    row |= _alarms(outcomes, looks, since, labels["recording"])
    row |= {f"cost_{ratio:g}": cost for ratio, cost in zip(COST_RATIOS, outcomes.costs(), strict=True)}
    last = looks.groupby("recording").last().reindex(labels["recording"])
    row |= _sizes(last, labels)
    groups = {
        group: outcomes.part(chosen).with_interval()  # at the thresholds of the group itself
        for group, chosen in _groups(labels).items()
        if outcomes.leak[chosen].any()
    }
    row |= {f"found_{group}": share.value for group, share in groups.items()}
    confusion = None
    if "cause" in looks:
        named = last["cause"].fillna("none").to_numpy()
        confusion = pd.crosstab(labels["cause"].to_numpy(), named, normalize="index")
        right = [float((named[labels["cause"] == cause] == cause).mean()) for cause in labels["cause"].unique()]
        row["cause_right"] = float(np.mean(right))
    return Score(name, outcomes, row, groups, _reliability(last, labels), confusion, remarks)


def bounds(labels: pd.DataFrame) -> list[Score]:
    """The scores of a perfect and of a silent detector."""
    silent = pd.DataFrame({"recording": labels["recording"], "time": 0.0, "score": np.nan, "alarm": False})
    at_start, at_onset = labels[labels["onset"] != 0.0], labels[labels["leak"]]
    looks = pd.concat([at_start.assign(time=0.0, score=0.0), at_onset.assign(time=at_onset["onset"], score=1.0)])
    looks["leak"] &= looks["score"] > 0.0
    known = {"alarm": looks["leak"], "probability": looks["leak"].astype(float)}
    perfect = looks[["recording", "time", "score", "cause", "size"]].assign(
        low=looks["size"], high=looks["size"], **known
    )
    return [score(PERFECT, perfect, labels), score(SILENT, silent, labels)]


def _checked(name: str, predictions: pd.DataFrame) -> pd.DataFrame:
    """The columns that count, as numbers, true or false, and causes."""
    missing = [column for column in REQUIRED if column not in predictions]
    if missing:
        raise ConfigurationError(f"{name}: has no column {', '.join(missing)}; required are {', '.join(REQUIRED)}")
    looks = predictions[[*REQUIRED, *(column for column in OPTIONAL if column in predictions)]].copy()
    for column in (*REQUIRED, "probability", "size", "low", "high"):
        if column in looks:
            try:
                looks[column] = pd.to_numeric(looks[column]).astype(np.float64)
            except (TypeError, ValueError):
                raise ConfigurationError(f"{name}: column '{column}' must hold numbers") from None
    if "alarm" in looks:
        looks["alarm"] = looks["alarm"].fillna(False).astype(bool)
    if "probability" in looks and not looks["probability"].dropna().between(0.0, 1.0).all():
        raise ConfigurationError(f"{name}: probability must be within 0 to 1")
    if "cause" in looks:
        odd = looks.loc[~looks["cause"].isin(CAUSES) & looks["cause"].notna(), "cause"]
        if len(odd):
            raise ConfigurationError(f"{name}: cause '{odd.iloc[0]}': must be one of {', '.join(CAUSES)}")
    return looks


def _counted(looks: pd.DataFrame, labels: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The rows that count, in the order of recording and time, and a remark on each kind of the others."""
    seconds = looks["recording"].map(labels.set_index("recording")["seconds"])
    inside = (looks["time"] >= 0.0) & (looks["time"] <= seconds + 1e-6)
    again = looks.duplicated(["recording", "time"])
    wrong = {
        "of a recording that is not in this split": seconds.isna(),
        "outside the time of their recording": seconds.notna() & ~inside,
        "for a time that has a row already": inside & again,
    }
    remarks = [
        f"{rows.sum()} rows {what} do not count, such as recording {looks.loc[rows, 'recording'].iloc[0]:g} at "
        f"{looks.loc[rows, 'time'].iloc[0]:g} s"
        for what, rows in wrong.items()
        if rows.any()
    ]
    kept = looks[inside & ~again]
    silent = len(labels) - kept["recording"].nunique()
    if silent:
        remarks.append(f"{silent} of {len(labels)} recordings have no row that counts: no answer, no alarm")
    return kept.sort_values(["recording", "time"], kind="stable", ignore_index=True), remarks


def _groups(labels: pd.DataFrame) -> dict[str, NDArray[np.bool_]]:
    """Recordings of each tier, of known and new axes, and of each disturbance of tier 3."""
    groups = {f"tier {tier}": labels["tier"] == tier for tier in TIERS}
    if labels["new_axis"].any():
        groups |= {"known axes": ~labels["new_axis"], "new axes": labels["new_axis"]}
    groups |= {kind: labels["harsh"] == kind for kind in HARSH}
    return {name: chosen.to_numpy(dtype=bool) for name, chosen in groups.items()}


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
        first = looks[looks["alarm"]].groupby("recording")["time"].min()
        alarm = first.reindex(order).to_numpy(dtype=np.float64)
    onset, leak = labels["onset"].to_numpy(dtype=np.float64), labels["leak"].to_numpy(dtype=bool)
    free = np.where(leak, onset, labels["seconds"]) / 3600.0
    tier = labels["tier"].to_numpy(dtype=np.int64)
    return Outcomes(tier, leak, free, highest(~leaking), highest(leaking), onset, alarm), since


def _alarms(outcomes: Outcomes, looks: pd.DataFrame, since: Floats, order: pd.Series[int]) -> dict[str, Any]:
    """False alarms, misses, delays, and what a plant meets: of the detector's own alarm, or at SHOWN_BUDGET."""
    leak, own = outcomes.leak, "alarm" in looks
    if own:
        first = outcomes.alarm
        wrong = np.isfinite(first) & ~(leak & (first >= outcomes.onset))
        found = leak & np.isfinite(first) & ~wrong
        delay = first - outcomes.onset
    else:
        threshold = outcomes.threshold(SHOWN_BUDGET)
        wrong, found = outcomes.before >= threshold, outcomes.found(threshold)
        raised = looks.assign(since=since)[(since >= 0.0) & (looks["score"] >= threshold)]
        delay = raised.groupby("recording")["since"].min().reindex(order).to_numpy(dtype=np.float64)
    hours = outcomes.hours
    per_hour = float(wrong.sum()) / hours if hours > 0.0 else float("nan")
    late = np.where(found, delay, np.inf)[leak]
    return {
        "alarm": "its own" if own else f"at {SHOWN_BUDGET:g} per hour",
        **poisson_interval(int(wrong.sum()), hours / 100.0).named("per_100_h"),
        "hours": hours,
        **share_interval(int((leak & ~found).sum()), int(leak.sum())).named("missed"),
        "delay": float(np.median(late)) if len(late) else float("nan"),
        "per_month": per_hour * HOURS_PER_YEAR / MONTHS_PER_YEAR,
        "true_alarms": true_alarms(float(found[leak].mean()) if leak.any() else 0.0, per_hour),
    }


def _reliability(last: pd.DataFrame, labels: pd.DataFrame) -> pd.DataFrame:
    """How often the seal leaks where the detector gives a probability, at the last look of each recording."""
    given = last["probability"].dropna() if "probability" in last else pd.Series(dtype=float)
    leak = labels.set_index("recording")["leak"].reindex(given.index)
    frame = pd.DataFrame({"bin": np.minimum((BINS * given).astype(int), BINS - 1), "told": given, "leaks": leak})
    return frame.groupby("bin").agg(told=("told", "mean"), leaks=("leaks", "mean"), count=("told", "size"))


def _sizes(last: pd.DataFrame, labels: pd.DataFrame) -> dict[str, float]:
    """Calibration of probability, size and interval at the last look."""
    found: dict[str, float] = {}
    leak = labels["leak"].to_numpy(dtype=bool)
    truth = labels["size"].to_numpy(dtype=np.float64)
    if "probability" in last:
        told = last["probability"].fillna(0.5).to_numpy()
        found["brier"] = float(np.mean((told - leak) ** 2))
        bins = np.minimum((BINS * told).astype(int), BINS - 1)
        wrong = sum(abs((told - leak)[bins == each].sum()) for each in range(BINS))
        found["calibration_error"] = float(wrong / len(told))
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
    """The labels of a split, checked against the SHA-256 in ``benchmark.json``.

    Raises:
        ConfigurationError: there is no challenge, the labels are not there, or they were changed.
    """
    if split not in SPLITS:
        raise ConfigurationError(f"--split {split}: must be one of {', '.join(SPLITS)}")
    expected = read_json(folder / MANIFEST).get("labels_sha256", {})
    table = read_labels(folder, split)
    if not isinstance(expected, Mapping) or digest_of_labels(table) != expected.get(split):
        raise ConfigurationError(f"{folder}: the labels of '{split}' are not those of {folder / MANIFEST}")
    return table


def by_rank(scores: Sequence[Score]) -> list[Score]:
    """The scores, the best first."""
    return sorted(scores, key=lambda one: -one.row["found_share"])


def table_of(scores: Sequence[Score]) -> pd.DataFrame:
    """A row per detector, the best first."""
    return pd.DataFrame([one.row for one in by_rank(scores)])


def differences(scores: Sequence[Score]) -> list[tuple[str, Interval]]:
    """By how much each detector finds more than the next one of the ranking, with the paired interval."""
    ordered = [one for one in by_rank(scores) if one.name not in (PERFECT, SILENT)]
    return [
        (f"{one.name} − {other.name}", one.outcomes.ahead_of(other.outcomes))
        for one, other in itertools.pairwise(ordered)
    ]


def tables_of(scores: Sequence[Score]) -> dict[str, tuple[list[str], list[list[str]]]]:
    """The tables of the console and of the page by title: header and rows."""
    ordered = by_rank(scores)
    groups = [*(f"tier {tier}" for tier in TIERS), "known axes", "new axes"]
    kinds = [kind for kind in HARSH if any(kind in one.groups for one in ordered)]
    found, plant, answers, harsh = [], [], [], []
    for one in ordered:
        row = one.row
        whole = Interval(row["found_share"], row["low"], row["high"])
        found.append([one.name, *map(_share, [whole, *map(one.groups.get, groups)])])
        rate = f"{number(row['per_100_h'])} ({number(row['per_100_h_low'])} to {number(row['per_100_h_high'])})"
        missed = _share(Interval(row["missed"], row["missed_low"], row["missed_high"]))
        right = _with_unit(100 * row["true_alarms"], " %", 2)
        plant.append([one.name, row["alarm"], rate, missed, number(row["delay"]), number(row["per_month"]), right])
        known = (_with_unit(scale * row.get(name, np.nan), unit) for name, scale, unit in ANSWERED.values())
        answers.append([one.name, *known])
        shares = (one.groups[kind].value if kind in one.groups else np.nan for kind in kinds)
        harsh.append([one.name, *(_with_unit(100 * share, " %", decimals=0) for share in shares)])
    ahead = [[name, _share(value)] for name, value in differences(scores)]
    alarms = ["alarm", "false alarms per 100 h", "missed", "median delay, s", "false alarms per month"]
    return {
        "Leaks found": (["detector", "all", *groups], found),
        "In a plant": (["detector", *alarms, "alarms that are leaks"], plant),
        "Answers": (["detector", *ANSWERED], answers),
        "Leaks found in tier 3": (["detector", *kinds], harsh),
        "Paired differences of leaks found": (["detectors", "difference (95 %)"], ahead),
    }


def notes(scores: Sequence[Score]) -> list[str]:
    """How the tables are read, and what they cannot say."""
    hours = scores[0].row["hours"]
    rates = ", ".join(f"{rate:g}" for rate in BUDGETS)
    return [
        f"Leaks found: mean share at {rates} false alarms per hour, with its 95 % interval over recordings.",
        f"{number(hours)} h without a leak: no rate below {number(300.0 / hours)} false alarms per 100 h can be shown.",
        "Alarms that are leaks: where an axis leaks once a year and runs all the time.",
        *(f"{one.name}: {remark}." for one in scores for remark in one.remarks),
    ]


def text_of(scores: Sequence[Score]) -> str:
    """The scores as Markdown."""
    parts = [f"{title}:\n\n{markdown(header, rows)}" for title, (header, rows) in tables_of(scores).items() if rows]
    for one in by_rank(scores):
        if one.confusion is not None and one.name != PERFECT:
            named = list(one.confusion.columns)
            cells = [[cause, *(f"{100 * v:.0f} %" for v in values)] for cause, values in one.confusion.iterrows()]
            parts.append(f"Causes named by {one.name}:\n\n{markdown(['true cause', *named], cells)}")
    return "\n\n".join([*parts, "\n".join(notes(scores))])


def _share(share: Interval | None) -> str:
    if share is None:
        return "–"
    return f"{number(100 * share.value, 1)} % ({number(100 * share.low, 0)} to {number(100 * share.high, 0)})"


def _with_unit(value: float, unit: str, digits: int = 3, decimals: int | None = None) -> str:
    return f"{number(value, decimals, digits)}{unit}" if np.isfinite(value) else "–"
