"""The findings of an evaluation as sentences; all numbers and verdicts come from its tables."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from hydro_agents.evaluation.limit_cycles import comes_to_rest, is_broken, rest_text
from hydro_agents.evaluation.metrics import FRAMES
from hydro_agents.report.content import Content, interval, interval_text, percent, verdict
from hydro_agents.report.sections import Finding
from hydro_agents.report.shared_findings import against_corrected, change, held
from hydro_agents.running.statistics import (
    LEAST_SAMPLES,
    Interval,
    conditional_value_at_risk,
    ratio_interval,
    share_interval,
)
from hydro_agents.running.text import family_name, listed, number, setting

FEW_PLANTS = 12
"""With fewer plants the intervals are rough; the report says so."""

FALSE_ALARM_TARGET = 0.01
"""Target false-alarm rate of the leakage head's threshold."""


def findings_of(content: Content) -> list[Finding]:
    """The findings, in the order of a user's questions."""
    items = [*_score(content), _leak(content), *(_comparison(content, name) for name in content.controllers[1:])]
    items += against_corrected(content)
    items += [_standstill(content)] if content.has("limit_cycle_summary") else []
    items += held(content)
    return [*items, _detection(content), _size(content)] if content.has("detection_summary") else items


def caution(content: Content) -> str:
    """A warning if there are few plants, else an empty text."""
    plants = content.table("cases")["plant"].nunique()
    if plants >= FEW_PLANTS:
        return ""
    what = "without intervals" if plants < LEAST_SAMPLES else "with rough intervals"
    return f"A small run, {what}: {plants} plants per leak size and kind of reference are too few for a decision."


def failed_runs(content: Content) -> str:
    """Number of failed runs under each controller, as a sentence."""
    total = content.table("cases").groupby("controller", sort=False)["failed"].agg(["sum", "count"])
    if float(total["sum"].sum()) == 0.0:
        return "No run failed (end stop or pressure limit)."
    parts = [f"{int(row['sum'])} of {int(row['count'])} under {name}" for name, row in total.iterrows()]
    return f"Failed runs (end stop or pressure limit): {listed(parts)}."


# The headline -------------------------------------------------------------------------------------------------------


def scores(content: Content) -> dict[str, Interval]:
    """Score of every controller but the baseline; NaN without a best found."""
    return {name: interval(content.row("score", controller=name), "score") for name in content.controllers[1:]}


def _score(content: Content) -> list[Finding]:
    """The scores, with the mean errors in both frames; nothing without a best found."""
    base, cases = content.baseline, content.table("cases")
    found = {name: value for name, value in scores(content).items() if not math.isnan(value.value)}
    if not found:
        return []
    best = max(found, key=lambda name: found[name].value)
    errors = cases.groupby("controller", sort=False)[list(FRAMES)].mean()
    frames = [
        f"{word}: {listed([f'{number(float(errors.loc[name, metric]))} mm with {name}' for name in (*found, base)])}"
        for metric, word in FRAMES.items()
    ]
    text = (
        f"0 is {base}, 100 the best found, a search that knows plant, state and leak; in the frame of the sensor, and "
        "with equal weights of the kinds of reference: "
        f"{listed([f'{name} {interval_text(value, decimals=0)}' for name, value in found.items()])}. "
        f"Mean error over all runs, {'; '.join(reversed(frames))}."
    )
    return [Finding(f"{best} scores {number(found[best].value, 0)} of 100.", text)]


# What a leak does ---------------------------------------------------------------------------------------------------


def growth(cases: pd.DataFrame, controller: str, family: str | None = None) -> Interval:
    """Mean error at the largest leak over the mean error at the smallest, on the same plants."""
    own = cases[cases["controller"] == controller]
    own = own if family is None else own[own["family"] == family]
    errors = own.pivot_table("mean_error_mm", "plant", "leakage_flow_lpm").to_numpy()
    return ratio_interval(errors[:, -1], errors[:, 0])


def _leak(content: Content) -> Finding:
    cases, base = content.table("cases"), content.baseline
    first, last = (float(cases["leakage_flow_lpm"].agg(end)) for end in ("min", "max"))
    least, most = (
        interval(content.row("levels", controller=base, metric="mean_error_mm", leakage_flow_lpm=leak), "mean")
        for leak in (first, last)
    )
    if first == last:
        lead = f"One leak size was tried: {setting(first)} l/min."
        return Finding(lead, f"Mean error of {base}: {interval_text(least, 'mm')}.")
    healthy = content.bounds.healthy_up_to
    best, worst = (
        f"a healthy seal ({setting(leak)} l/min)" if leak <= healthy else f"a leak of {setting(leak)} l/min"
        for leak in (first, last)
    )
    whole, short = growth(cases, base), best.partition(" (")[0]
    lead = f"A leak of {setting(last)} l/min makes no clear difference to the mean error of {base}."
    if verdict(whole) != "same":
        than = "that it makes" if whole.value >= 2.0 else "than"
        lead = f"With a leak of {setting(last)} l/min, {base} makes {change(whole.value)} {than} with {short}."
    text = (
        f"{base}: {interval_text(least, 'mm')} mean error with {best}, {interval_text(most, 'mm')} with "
        f"{worst}: × {interval_text(whole)}. {_growth_by_family(cases, base)}"
    )
    others = [f"{name} × {interval_text(growth(cases, name))}" for name in content.controllers[1:]]
    return Finding(lead, text + (f" For comparison: {listed(others)}." if others else ""))


def _growth_by_family(cases: pd.DataFrame, base: str) -> str:
    """References with more error, less error and no clear difference due to the leak, in one sentence."""
    words = {"worse": "more error in", "better": "less error in", "same": "no clear difference in"}
    parts: dict[str, list[str]] = {kind: [] for kind in words}
    for family in map(str, cases["family"].unique()):
        value = growth(cases, base, family)
        parts[verdict(value)].append(f"{family_name(family)} (× {number(value.value)})")
    sentence = "; ".join(f"{words[kind]} {listed(names)}" for kind, names in parts.items() if names)
    return f"{sentence[0].upper()}{sentence[1:]}."


# Which controller copes better --------------------------------------------------------------------------------------


def _comparison(content: Content, name: str) -> Finding:
    row, equal = (content.row("ratios", controller=name, group=group) for group in ("all", "equal_weight"))
    whole, base = interval(row, "ratio"), row["against"]
    unrest, at_rest = _unrest(content, base)
    lead = {
        "better": f"{name} positions better than {base}{unrest}: {change(whole.value)}.",
        "worse": f"{name} loses to {base}{unrest}: {change(whole.value)}.",
        "same": f"No clear difference between {name} and {base}{unrest and f'{unrest},'} over all runs.",
    }[verdict(whole)]
    mine, theirs = (
        number(conditional_value_at_risk(content.rows("cases", controller=who)["mean_error_mm"].to_numpy()))
        for who in (name, base)
    )
    text = (
        f"Over all runs the mean error of {name} is {interval_text(whole)} times that of {base}; {name} is "
        f"better in {100.0 * float(row['share_of_cases_better']):.0f} % of the runs. "
        f"Steps have by far the largest errors and dominate this mean. With equal weights for all kinds of reference "
        f"(geometric mean of the ratios) the ratio is {interval_text(interval(equal, 'ratio'))}. "
        f"{_breakdown(content, name, 'level')} {_breakdown(content, name, 'family')} "
        f"Worst 5 % of the runs: {mine} mm on average, against {theirs} mm with {base}.{at_rest}"
    )
    return Finding(lead, text)


def _breakdown(content: Content, name: str, group: str) -> str:
    """The levels or families at which a controller wins, loses, or does neither, as a sentence."""
    words = {"better": "wins", "worse": "loses", "same": "shows no clear difference"}
    labels: dict[str, list[str]] = {kind: [] for kind in words}
    for row in content.rows("ratios", controller=name, group=group).to_dict("records"):
        value = str(row["value"])
        labels[verdict(interval(row, "ratio"))].append(
            setting(float(value)) if group == "level" else family_name(value)
        )
    kinds = [kind for kind, values in labels.items() if values]
    if len(kinds) == 1 and len(labels[kinds[0]]) > 1:
        return f"It {words[kinds[0]]} {'at every leak size' if group == 'level' else 'on every kind of reference'}."
    at, unit, what = ("at", " l/min", "By leak size") if group == "level" else ("on", "", "By reference")
    return f"{what} it " + "; ".join(f"{words[kind]} {at} {listed(labels[kind])}{unit}" for kind in kinds) + "."


# At rest ------------------------------------------------------------------------------------------------------------


def _unrest(content: Content, name: str) -> tuple[str, str]:
    """A clause and a sentence about a controller that does not come to rest, else empty texts."""
    found = content.row("limit_cycle_summary", controller=name)
    if not found or comes_to_rest(found):
        return "", ""
    clause = f", which {'cannot hold this axis' if is_broken(found) else 'does not come to rest'}"
    return clause, f" {name} at rest: {rest_text(found)}."


def _standstill(content: Content) -> Finding:
    rows = content.table("limit_cycle_summary").to_dict("records")
    restless = [str(row["controller"]) for row in rows if not comes_to_rest(row)]
    lead = f"Without sensor noise {listed(restless or ['every controller'])} "
    if restless:
        lead += f"{'do' if len(restless) > 1 else 'does'} not come to rest at every standstill."
    else:
        lead += "comes to rest at every standstill."
    parts = [f"{row['controller']}: {rest_text(row)}" for row in rows]
    text = f"{'; '.join(parts)}."
    if content.baseline in restless and len(rows) > 1:
        text += f" Ratios to {content.baseline} compare with a controller in this state."
    return Finding(lead, text)


# Noticing the leak --------------------------------------------------------------------------------------------------


def _flagged(content: Content, controller: str, value: str) -> Interval:
    return interval(content.row("detection_rates", controller=controller, value=value), "flagged_share")


def _false_alarms(row: Any) -> Interval:
    healthy = int(row["healthy_episodes"])
    return share_interval(round(float(row["false_alarm_rate"]) * healthy), healthy)


def _detection(content: Content) -> Finding:
    smallest = str(content.row("detection_rates", group="range")["value"])
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
