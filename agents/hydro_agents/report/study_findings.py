"""The findings of an evaluation as sentences; all numbers and verdicts come from its tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.report.content import Content, interval_text, percent
from hydro_agents.report.sections import Finding
from hydro_agents.running.resampling import ratio_interval
from hydro_agents.running.statistics import Interval, conditional_value_at_risk, share_interval
from hydro_agents.running.text import family_name, listed, number, unbroken

FEWEST_PLANTS = 3
"""Smallest number of plants for intervals and verdicts."""

FEW_PLANTS = 12
"""With fewer plants the intervals are rough; the report says so."""

FALSE_ALARM_TARGET = 0.01
"""Target false-alarm rate of the leakage head's threshold."""

NEITHER = "no clear difference"


def row_interval(row: Any, column: str) -> Interval:
    """Interval in a row of a table."""
    return Interval(float(row[column]), float(row["low"]), float(row["high"]))


# Judging ------------------------------------------------------------------------------------------------------------


def plants_of(content: Content) -> int:
    """Plants per leak size and family."""
    return int(content.table("cases")["plant"].nunique())


def verdict(interval: Interval, plants: int) -> str:
    """'wins' if the whole interval of a ratio of errors lies below 1, 'loses' if above, else 'no clear difference'."""
    if plants < FEWEST_PLANTS or not np.isfinite([interval.low, interval.high]).all():
        return NEITHER
    if interval.high < 1.0:
        return "wins"
    return "loses" if interval.low > 1.0 else NEITHER


def growth(cases: pd.DataFrame, controller: str, family: str | None = None) -> Interval:
    """Mean error at the largest leak over the mean error at the smallest, on the same plants."""
    own = cases[cases["controller"] == controller]
    own = own if family is None else own[own["family"] == family]
    level = own["leakage_flow_lpm"]
    most, least = (
        own[level == end].groupby("plant")["mean_error_mm"].mean().to_numpy() for end in (level.max(), level.min())
    )
    return ratio_interval(most, least)


def findings_of(content: Content) -> list[Finding]:
    """The findings, in the order of a user's questions."""
    items = [_leak(content)]
    items += [_comparison(content, name) for name in content.controllers[1:]]
    if content.has("detection_summary"):
        items += [_detection(content), _size(content)]
    return [Finding(unbroken(item.lead), unbroken(item.text)) for item in items]


def caution(content: Content) -> str:
    """A warning if there are few plants, else an empty text."""
    plants = plants_of(content)
    if plants >= FEW_PLANTS:
        return ""
    what = "without intervals" if plants < FEWEST_PLANTS else "with rough intervals"
    return f"A small run, {what}: {plants} plants per leak size and kind of reference are too few for a decision."


def failed_runs(content: Content) -> str:
    """Number of failed runs under each controller, as a sentence."""
    total = content.table("cases").groupby("controller", sort=False)["failed"].agg(["sum", "count"])
    if float(total["sum"].sum()) == 0.0:
        return "No run failed (end stop or pressure limit)."
    parts = [f"{int(row['sum'])} of {int(row['count'])} under {name}" for name, row in total.iterrows()]
    return f"Failed runs (end stop or pressure limit): {listed(parts)}."


# What a leak does ---------------------------------------------------------------------------------------------------


def _change(ratio: float) -> str:
    """A ratio of errors as a phrase."""
    if ratio >= 2.0:
        return f"{number(ratio)} times the error"
    return f"{number(100.0 * abs(ratio - 1.0), 0)} % {'more' if ratio > 1.0 else 'less'} error"


def _level_mean(content: Content, controller: str, level: float) -> Interval:
    table = content.table("levels")
    own = (table["controller"] == controller) & (table["metric"] == "mean_error_mm")
    return row_interval(table[own & (table["leakage_flow_lpm"] == level)].iloc[0], "mean")


def _seal(content: Content, level: float) -> str:
    healthy = level <= content.bounds.healthy_up_to
    return f"a healthy seal ({level:g} l/min)" if healthy else f"a leak of {level:g} l/min"


def _leak(content: Content) -> Finding:
    cases, names = content.table("cases"), content.controllers
    base, plants = names[0], plants_of(content)
    first, last = float(cases["leakage_flow_lpm"].min()), float(cases["leakage_flow_lpm"].max())
    least, most = _level_mean(content, base, first), _level_mean(content, base, last)
    if first == last:
        return Finding(
            f"One leak size was tried: {first:g} l/min.", f"Mean error of {base}: {interval_text(least, 'mm')}."
        )
    whole = growth(cases, base)
    kind = verdict(whole, plants)
    best, worst = _seal(content, first), _seal(content, last)
    lead = f"A leak of {last:g} l/min makes no clear difference to the mean error of {base}."
    if kind != NEITHER:
        than = "that it makes" if whole.value >= 2.0 else "than"
        lead = f"With a leak of {last:g} l/min, {base} makes {_change(whole.value)} {than} with {best}."
    text = (
        f"{base}: {interval_text(least, 'mm')} mean error with {best}, {interval_text(most, 'mm')} with "
        f"{worst}: × {interval_text(whole)}. {_growth_by_family(cases, base, plants)}"
    )
    others = [f"{name} × {interval_text(growth(cases, name))}" for name in names[1:]]
    return Finding(lead, text + (f" For comparison: {listed(others)}." if others else ""))


def _growth_by_family(cases: pd.DataFrame, base: str, plants: int) -> str:
    """References with more error, less error and no clear difference due to the leak, in one sentence."""
    parts: dict[str, list[str]] = {"loses": [], "wins": [], NEITHER: []}
    for family in map(str, cases["family"].unique()):
        interval = growth(cases, base, family)
        parts[verdict(interval, plants)].append(f"{family_name(family)} (× {number(interval.value)})")
    words = {"loses": "more error in", "wins": "less error in", NEITHER: "no clear difference in"}
    sentence = "; ".join(f"{words[kind]} {listed(names)}" for kind, names in parts.items() if names)
    return f"{sentence[0].upper()}{sentence[1:]}."


# Which controller copes better --------------------------------------------------------------------------------------


def _comparison(content: Content, name: str) -> Finding:
    frame = content.table("ratios")[content.table("ratios")["controller"] == name]
    base, plants = str(frame["against"].iloc[0]), plants_of(content)
    row = frame[frame["group"] == "all"].iloc[0]
    whole = row_interval(row, "ratio")
    lead = {
        "wins": f"{name} positions better than {base}: {_change(whole.value)}.",
        "loses": f"{name} loses to {base}: {_change(whole.value)}.",
    }.get(verdict(whole, plants), f"No clear difference between {name} and {base} over all runs.")
    errors = content.table("cases").groupby("controller")["mean_error_mm"]
    mine, theirs = (conditional_value_at_risk(errors.get_group(who).to_numpy()) for who in (name, base))
    equal = row_interval(frame[frame["group"] == "equal_weight"].iloc[0], "ratio")
    text = (
        f"Over all runs the mean error of {name} is {interval_text(whole)} times that of {base}; {name} is "
        f"better in {100.0 * float(row['share_of_cases_better']):.0f} % of the runs. "
        f"Steps have by far the largest errors and dominate this mean. With equal weights for all kinds of reference "
        f"(geometric mean of the ratios) the ratio is {interval_text(equal)}. "
        f"{_breakdown(frame, 'level', plants)} {_breakdown(frame, 'family', plants)} "
        f"Worst 5 % of the runs: {number(mine)} mm on average, against {number(theirs)} mm with {base}."
    )
    return Finding(lead, text)


def _breakdown(frame: pd.DataFrame, group: str, plants: int) -> str:
    """The levels or families at which a controller wins, loses, or does neither, as a sentence."""
    labels: dict[str, list[str]] = {"wins": [], "loses": [], NEITHER: []}
    for row in frame[frame["group"] == group].to_dict("records"):
        value = str(row["value"])
        label = f"{float(value):g}" if group == "level" else family_name(value)
        labels[verdict(row_interval(row, "ratio"), plants)].append(label)
    words = {"wins": "wins", "loses": "loses", NEITHER: "shows no clear difference"}
    kinds = [kind for kind, values in labels.items() if values]
    if len(kinds) == 1 and len(labels[kinds[0]]) > 1:
        return f"It {words[kinds[0]]} {'at every leak size' if group == 'level' else 'on every kind of reference'}."
    at, unit, what = ("at", " l/min", "By leak size") if group == "level" else ("on", "", "By reference")
    return f"{what} it " + "; ".join(f"{words[kind]} {at} {listed(labels[kind])}{unit}" for kind in kinds) + "."


# Noticing the leak --------------------------------------------------------------------------------------------------


def _flagged(content: Content, controller: str, value: str) -> Interval:
    rates = content.table("detection_rates")
    chosen = rates[(rates["controller"] == controller) & (rates["value"] == value)]
    return row_interval(chosen.iloc[0], "flagged_share")


def _false_alarms(row: Any) -> Interval:
    healthy = int(row["healthy_episodes"])
    return share_interval(round(float(row["false_alarm_rate"]) * healthy), healthy)


def _detection(content: Content) -> Finding:
    rates = content.table("detection_rates")
    smallest = next(str(value) for value in rates[rates["group"] == "range"]["value"])
    moderate = f"{content.bounds.moderate_from:g} l/min"
    summary = {str(row["controller"]): row for row in content.table("detection_summary").to_dict("records")}
    rate = {name: _flagged(content, name, content.bounds.moderate_label) for name in summary}
    alarms = {name: _false_alarms(row) for name, row in summary.items()}
    if min(rate[name].low for name in summary) >= 0.9 and max(alarms[name].high for name in summary) <= 0.05:
        lead = f"Leaks from {moderate} can be flagged from one episode of ordinary motion."
    elif min(rate[name].low - alarms[name].high for name in summary) > 0.0:
        lead = f"Leaks from {moderate} can be flagged, but not reliably."
    else:
        lead = f"Leaks from {moderate} cannot be distinguished from healthy seals here."
    parts = [
        f"Flagged under {name}: {percent(rate[name])} of the leaks from {moderate}, "
        f"{percent(_flagged(content, name, smallest))} of those of {smallest} l/min, and {percent(alarms[name])} of "
        f"the healthy seals (false alarms); AUROC {number(float(row['auroc']), 3)}."
        for name, row in summary.items()
    ]
    return Finding(lead, " ".join([*parts, "(AUROC: 1 is perfect, 0.5 is chance.)", _alarm_sentence(alarms)]))


def _alarm_sentence(alarms: dict[str, Interval]) -> str:
    """Sentence that compares the false alarms on test plants with the target set on validation plants."""
    sentence = f"The threshold was set for {100.0 * FALSE_ALARM_TARGET:g} % false alarms on validation plants"
    above = [name for name, interval in alarms.items() if interval.low > FALSE_ALARM_TARGET]
    return f"{sentence}; the test plants have clearly more under {listed(above)}." if above else f"{sentence}."


def _size(content: Content) -> Finding:
    rows, above = content.table("detection_summary").to_dict("records"), content.bounds.leaking_above
    middle = max(float(row["median_size_error_factor"]) for row in rows)
    lead = f"The size of a leak is estimated within a factor of {number(middle)} for half of the leaks."
    parts = [f"{number(float(row['p90_size_error_factor']))} under {row['controller']}" for row in rows]
    text = f"For nine in ten it is within a factor of {listed(parts)} (leaks above {above:g} l/min; 1 would be exact)."
    return Finding(lead, text)
