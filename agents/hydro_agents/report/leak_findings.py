"""The findings as sentences for maintenance people; all numbers come from the tables."""

from __future__ import annotations

import numpy as np

from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.report.content import Content, interval_text
from hydro_agents.report.sections import Finding
from hydro_agents.running.text import listed, number, setting

SURE = 95.0
"""Percentage of windows with detection for the sentence "is found"."""

TOO_OFTEN = 10.0
"""Percentage of healthy windows with false alarms above which a condition is named."""

MOST_NAMED = 5


def findings_of(content: Content) -> list[Finding]:
    """Findings on size, delay, reliability, confusions and windows without an answer."""
    return [_small(content), _sure(content), _confused(content), _silent(content)]


def _levels(content: Content, detector: str, condition: str) -> list[float]:
    table = content.table("detection")
    mine = table[(table["detector"] == detector) & (table["condition"] == condition) & (table["level"] > HEALTHY)]
    return sorted(float(level) for level in mine["level"])


def smallest_found(content: Content, detector: str, condition: str) -> float:
    """The smallest leak such that it and every larger one is found in 95 % of the windows; NaN if there is none."""
    found = np.nan
    for level in reversed(_levels(content, detector, condition)):
        if content.share(detector, condition, level, "at_1_percent").value < SURE:
            break
        found = level
    return float(found)


def _small(content: Content) -> Finding:
    sizes = {name: smallest_found(content, name, content.base) for name in content.detectors}
    known = {name: size for name, size in sizes.items() if np.isfinite(size)}
    duration = float(content.conditions["duration_s"][content.base])
    if not known:
        return Finding(
            "No size of leak is found reliably.", f"No detector finds any of them in {SURE:.0f} % of the windows."
        )
    best = min(known, key=lambda name: known[name])
    parts = [
        f"{name}: {setting(size)} l/min" if np.isfinite(size) else f"{name}: none of the sizes"
        for name, size in sizes.items()
    ]
    lead = f"A leak of {setting(known[best])} l/min is found within {setting(duration)} s of ordinary motion."
    text = (
        f"Smallest leak at 100 bar that is found in {SURE:.0f} % of the windows, when one healthy window in a hundred "
        f"raises a false alarm: {'; '.join(parts)}."
    )
    return Finding(lead, text)


def _sure(content: Content) -> Finding:
    parts, worst, rates = [], {}, {}
    for name in content.detectors:
        value = content.share(name, content.base, HEALTHY)
        per_hour = float(content.cell("detection", name, content.base, HEALTHY).get("per_hour", np.nan))
        parts.append(f"{name} {interval_text(value, '%', 1)}, which is {number(per_hour, 0)} per hour")
        if np.isfinite(per_hour):
            rates[name] = per_hour
        others = {where: content.share(name, where, HEALTHY) for where in content.in_groups("motion", "controller")}
        others = {where: share for where, share in others.items() if np.isfinite(share.value)}
        if others:
            where = max(others, key=lambda each: others[each].value)
            worst[name] = f"{name} {interval_text(others[where], '%', 1)}, {content.label(where)}"
    text = f"Healthy windows in which a leak is reported: {'; '.join(parts)}."
    if worst:
        text += f" Under the worst motion or controller: {'; '.join(worst.values())}."
    if not rates or max(rates.values()) < 1.0:
        return Finding("On healthy axes in ordinary motion false alarms are rare.", text)
    often = max(rates, key=lambda name: rates[name])
    lead = f"The {often} alone raises {number(rates[often], 0)} false alarms per hour: let an alarm sum up its windows."
    return Finding(lead, text)


def _confused(content: Content) -> Finding:
    parts, clean = [], []
    changed = content.in_groups("fault", "plant", "rig")
    for name in content.detectors:
        found = {where: content.share(name, where, HEALTHY).value for where in changed}
        shares = {where: value for where, value in found.items() if np.isfinite(value)}
        wrong = sorted((where for where in shares if shares[where] > TOO_OFTEN), key=lambda where: -shares[where])
        if wrong:
            named = [f"{content.label(where)} {number(shares[where], 0)} %" for where in wrong[:MOST_NAMED]]
            more = f" and {len(wrong) - MOST_NAMED} more" if len(wrong) > MOST_NAMED else ""
            parts.append(f"{name}: {', '.join(named)}{more}")
        elif shares:
            clean.append(name)
    lead = "Some other faults look like a worn seal." if parts else "No other fault looks like a worn seal."
    text = f"Mistaken for a leak in more than {TOO_OFTEN:.0f} % of the windows: {'; '.join(parts)}." if parts else ""
    if clean:
        text += f" {listed(clean)}: none in more than {TOO_OFTEN:.0f} % of the windows."
    return Finding(lead, text.strip())


def _silent(content: Content) -> Finding:
    parts = []
    table = content.table("detection")
    for name in content.detectors:
        mine = table[(table["detector"] == name) & (table["cannot_tell"] > 0.5)]
        labels = list(dict.fromkeys(content.label(str(condition)) for condition in mine["condition"]))
        if labels:
            more = f" and {len(labels) - MOST_NAMED} more" if len(labels) > MOST_NAMED else ""
            parts.append(f"{name}: {', '.join(labels[:MOST_NAMED])}{more}")
    if not parts:
        return Finding(
            "No detector stays silent.", "None answers “cannot tell” in more than half of the windows of a condition."
        )
    return Finding(
        "Where the model or the training is not valid, the answer is “cannot tell”.",
        f"In more than half of the windows: {'; '.join(parts)}.",
    )
