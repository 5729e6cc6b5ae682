"""The findings of the protocol as sentences; all numbers and verdicts come from its tables."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from hydro_agents.evaluation.metrics import COMPARED
from hydro_agents.report.content import ALL, Content, interval, interval_text, percent
from hydro_agents.report.sections import Finding
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import listed, number, setting, unbroken

MOST_NAMED = 6
"""Largest number of conditions that a sentence names."""


def findings_of(content: Content) -> list[Finding]:
    """The findings: best controller, weaknesses of each controller, and cost of the leak."""
    items: list[Finding] = []
    if content.has("comparison"):
        items += [_winner(content), *(_controller(content, name) for name in content.controllers[1:])]
    if content.has("standstill"):
        items.append(_standstill(content))
    if content.has("leak_price"):
        items.append(_price(content))
    return [Finding(_unbroken(item.lead), _unbroken(item.text)) for item in items]


def _unbroken(text: str) -> str:
    """The text with every number kept on one line with its unit or its ×."""
    return re.sub(r"(?<=\d) (?=×|µm|Hz|W\b)", "\u00a0", unbroken(text))


def verdict(value: Interval) -> str:
    """'better' or 'worse' if the whole interval of a ratio is on one side of 1, else 'same'."""
    if value.high < 1.0:
        return "better"
    return "worse" if value.low > 1.0 else "same"


def _ratio(content: Content, name: str) -> Interval:
    return interval(content.against(name), "equal_weight")


def _winner(content: Content) -> Finding:
    base = content.baseline
    ranked = sorted(content.controllers[1:], key=lambda name: _ratio(content, name).value)
    best, value = ranked[0], _ratio(content, ranked[0])
    if verdict(value) != "better":
        return Finding(
            f"No controller is clearly better than {base}.",
            f"The error of the best other one, {best}, is {interval_text(value, decimals=2)} times as large.",
        )
    share = 100.0 * (1.0 - value.value)
    others = [f"{name} {interval_text(_ratio(content, name), decimals=2)}" for name in ranked[1:]]
    text = f"Error against {base}, all kinds of reference with equal weight: {best} {interval_text(value, decimals=2)}"
    text += f"; {'; '.join(others)}." if others else "."
    text += f" {_best_in(content)} {_cost(content, best)}"
    return Finding(f"{best} positions best: {number(share, 0)} % less error than {base}.", text)


def _best_in(content: Content) -> str:
    """Number of conditions in which each controller is the best, as a sentence."""
    ranking = content.table("ranking")
    if ranking.empty or "best_in" not in ranking:
        return ""
    rows = [row for row in ranking.to_dict("records") if int(row["best_in"]) > 0]
    parts = [f"{row['controller']} in {int(row['best_in'])}" for row in rows]
    return f"Best, of {int(ranking['conditions'].max())} conditions: {listed(parts)}."


def _cost(content: Content, name: str) -> str:
    """Cost of a controller for valve and supply, as a sentence."""
    row = content.against(name)
    parts = [
        f"{metric.word.lower()} {number(float(row[column]), 2)}"
        for column, metric in COMPARED.items()
        if metric.cost and np.isfinite(row.get(column, np.nan))
    ]
    return f"Its cost relative to {content.baseline}: {listed([f'{part} ×' for part in parts])}." if parts else ""


def _controller(content: Content, name: str) -> Finding:
    base, row = content.baseline, content.against(name)
    whole = _ratio(content, name)
    kinds = _by_verdict(content, name)
    ran = sum(len(conditions) for conditions in kinds.values())
    won, lost = len(kinds["better"]), len(kinds["worse"])
    lead = f"{name} beats {base} in {won} of {ran} conditions and loses in {lost or 'none'}."
    if won == 0:
        lead = f"{name} never beats {base}, and loses in {lost or 'none'} of {ran} conditions."
    text = f"Mean error {interval_text(interval(row, 'ratio'), decimals=2)}, "
    text += f"equal weights {interval_text(whole, decimals=2)}"
    better = interval(row, "share_better")
    text += f"; better in {percent(better)} of the cases" if np.isfinite(better.value) else ""
    text += f"; worst single case {number(float(row['worst_ratio']), 2)} ×." if "worst_ratio" in row else "."
    if kinds["worse"]:
        text += f" It loses under: {_named(content, kinds['worse'], name)}."
    gap = interval(row, "gap")
    if np.isfinite(gap.value):
        text += f" It closes {percent(gap)} of the gap between {base} and the best found."
    return Finding(lead, f"{text} {_cost(content, name)} {_troubles(content, name)}".strip())


def _by_verdict(content: Content, name: str) -> dict[str, list[str]]:
    kinds: dict[str, list[str]] = {"better": [], "worse": [], "same": []}
    table = content.table("comparison")
    for row in table[(table["controller"] == name) & (table["condition"] != ALL)].to_dict("records"):
        value = interval(row, "equal_weight")
        if np.isfinite(value.value):
            kinds[verdict(value)].append(str(row["condition"]))
    return kinds


def _named(content: Content, conditions: list[str], controller: str) -> str:
    """The worst of some conditions, by name."""
    values = {name: interval(content.against(controller, name), "equal_weight").value for name in conditions}
    worst = sorted(conditions, key=lambda name: -values[name])
    parts = [f"{content.label(name)} ({number(values[name], 2)})" for name in worst[:MOST_NAMED]]
    more = len(conditions) - len(parts)
    return ", ".join(parts) + (f" and {more} more" if more > 0 else "")


def _troubles(content: Content, name: str) -> str:
    """Failures and limit cycles of all runs, as a sentence."""
    ranking = content.table("ranking")
    own = ranking[ranking["controller"] == name].to_dict("records") if not ranking.empty else []
    if not own or "failures" not in own[0]:
        return ""
    failures = int(own[0]["failures"])
    return f"Failed runs: {failures}." if failures else "No run failed."


def cycle_counts(content: Content) -> dict[str, tuple[int, int, dict[str, Any]]]:
    """Per controller: cases with a limit cycle at standstill, all cases, and the row of the largest."""
    counts = {}
    for name, frame in content.table("standstill").groupby("controller", sort=False):
        cycles = frame[frame["limit_cycle"].astype(bool)]
        largest = cycles.sort_values("amplitude_um").tail(1).to_dict("records")
        counts[str(name)] = (len(cycles), len(frame), {str(k): v for k, v in largest[0].items()} if largest else {})
    return counts


def _standstill(content: Content) -> Finding:
    counts = cycle_counts(content)
    without = [name for name, (cycles, _, _) in counts.items() if cycles == 0]
    lead = "No controller oscillates while it holds a position."
    if len(without) < len(counts):
        lead = (
            f"Only {listed(without)} never oscillates at standstill."
            if len(without) == 1
            else (
                f"{listed(without)} never oscillate at standstill."
                if without
                else "Every controller can oscillate at rest."
            )
        )
    parts = []
    for name, (cycles, total, row) in counts.items():
        part = f"{name} {cycles} of {total}"
        if row:
            part += f" (up to {number(row['amplitude_um'], 0)} µm at {number(row['frequency_hz'], 1)} Hz)"
        parts.append(part)
    return Finding(lead, f"Held positions with a limit cycle: {'; '.join(parts)}. The runs are without sensor noise.")


def _price(content: Content) -> Finding:
    table = content.table("leak_price")
    held = table[np.isfinite(table["holding_power_w"])]  # the largest leaks may make holding impossible
    tight, leaking = held.iloc[0], held.iloc[-1]
    leak = setting(float(leaking["leakage_flow_lpm"]))
    lost = {name: 100.0 * (1.0 - leaking[name] / tight[name]) for name in ("speed_out_mm_s", "force_back_n")}
    power = leaking["holding_power_w"] / tight["holding_power_w"]
    lead = f"Even if the axis holds its position, a leak of {leak} l/min costs power and reserve."
    watts = [number(float(row["holding_power_w"])) for row in (tight, leaking)]
    text = (
        f"Power to hold {number(float(tight['place_mm']), 0)} mm: {watts[0]} W with a tight seal, {watts[1]} W "
        f"({number(power, 2)} ×). Speed at full command outwards falls by {number(lost['speed_out_mm_s'], 0)} %, the "
        f"largest force inwards by {number(lost['force_back_n'], 0)} %. No controller changes these figures."
    )
    return Finding(lead, text)
