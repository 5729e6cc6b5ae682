"""The findings of the protocol as sentences; all numbers and verdicts come from its tables."""

from __future__ import annotations

import numpy as np

from hydro_agents.evaluation.metrics import COMPARED
from hydro_agents.report.content import ALL, Content, interval, interval_text, percent, verdict
from hydro_agents.report.sections import Finding
from hydro_agents.report.shared_findings import against_corrected, held
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import listed, number, setting

MOST_NAMED = 6
"""Largest number of conditions that a sentence names."""


def findings_of(content: Content) -> list[Finding]:
    """The findings: best controller, weaknesses of each controller, and cost of the leak."""
    items: list[Finding] = []
    if content.has("comparison"):
        items += [_winner(content), *(_controller(content, name) for name in content.controllers[1:])]
        items += against_corrected(content)
    if content.has("standstill"):
        items.append(_standstill(content))
    items += held(content)
    if content.has("leak_price"):
        items.append(_price(content))
    return items


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
    score = interval(row, "score")
    if np.isfinite(score.value):
        text += f" Score: {interval_text(score, decimals=0)} (0: {base}, 100: best found, in the frame of the sensor)."
    return Finding(lead, f"{text} {_cost(content, name)} {_troubles(content, name)}".strip())


def _by_verdict(content: Content, name: str) -> dict[str, list[str]]:
    kinds: dict[str, list[str]] = {"better": [], "worse": [], "same": []}
    for row in content.rows("comparison", controller=name).to_dict("records"):
        value = interval(row, "equal_weight")
        if row["condition"] != ALL and np.isfinite(value.value):
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
    own = content.row("ranking", controller=name)
    if "failures" not in own:
        return ""
    return f"Failed runs: {int(own['failures'])}." if own["failures"] else "No run failed."


def _standstill(content: Content) -> Finding:
    parts, without = [], []
    for name, frame in content.table("standstill").groupby("controller", sort=False):
        cycles = frame[frame["limit_cycle"].astype(bool)].sort_values("amplitude_um")
        parts.append(f"{name} {len(cycles)} of {len(frame)}")
        if len(cycles):
            size, frequency = cycles.iloc[-1][["amplitude_um", "frequency_hz"]]
            parts[-1] += f" (up to {number(size, 0)} µm at {number(frequency, 1)} Hz)"
        else:
            without.append(str(name))
    lead = "Every controller can oscillate at rest."
    if len(without) == len(parts):
        lead = "No controller oscillates while it holds a position."
    elif len(without) == 1:
        lead = f"Only {without[0]} never oscillates at standstill."
    elif without:
        lead = f"{listed(without)} never oscillate at standstill."
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
