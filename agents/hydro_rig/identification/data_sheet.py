"""Where a recording contradicts the data sheet: timing, noise, slow errors and spikes, in words.

The estimator (:mod:`hydro_rig.estimation.estimate`) estimates them from the windows that the data sheet does not
explain.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.task.sensors import SENSORS
from hydro_rig.estimation.errors import SLOW
from hydro_rig.estimation.model import noise_of
from hydro_rig.estimation.result import Estimate
from hydro_rig.estimation.unknowns import LATENCY, RISE_TIME
from hydro_rig.identification.found_rig import shown
from hydro_rig.recordings.findings import Finding, Weight

MORE, LESS = 1.1, 0.7  # white noise over that of the data sheet that is worth a line
LATENCY_CHANGE = 0.1  # difference of the latency that is worth a line, in control periods
RISE_TIME_CHANGE = 1e-3  # s
MOST_DIFFER = 0.5  # share of the windows with an answer from which on the model counts as wrong
SPIKES = 0.002  # share of spikes that is worth a line


class _Odd(NamedTuple):
    """One value of a recording that the data sheet contradicts."""

    signal: str
    kind: str  # command_latency or pressure_rise_time (s); white, slow (over the data sheet's noise), spikes (share)
    size: float


def _odd(found: Estimate, task: TaskConfig) -> list[_Odd]:
    """The medians over the windows with an answer, or over all if there is none, where they are worth a line."""
    used = found.part(np.flatnonzero(found.holds)) if found.holds.any() else found
    latency, rise = float(np.median(used.latency)), float(np.median(used.rise_time))
    odd = []
    if abs(latency - task.command_latency) > LATENCY_CHANGE * task.control_period:
        odd.append(_Odd("command", LATENCY, latency))
    if abs(rise - task.sensors.pressure_rise_time) > RISE_TIME_CHANGE:
        odd.append(_Odd("pressures", RISE_TIME, max(rise, 0.0)))
    for channel, name in enumerate(SENSORS):
        white, slow, spikes = (float(np.median(part[:, channel])) for part in (used.white, used.slow, used.spikes))
        if not LESS <= white <= MORE:
            odd.append(_Odd(name, "white", white))
        if slow > SLOW:
            odd.append(_Odd(name, "slow", slow))
        if spikes > SPIKES:
            odd.append(_Odd(name, "spikes", spikes))
    return odd


def contradictions(found: Estimate, task: TaskConfig) -> list[Finding]:
    """What the recording says of timing and errors that the data sheet does not, one finding each.

    Args:
        found: the windows of a recording; those with an answer count, or all if there is none.
        task: as the estimate assumed it.
    """
    end = "used" if found.holds.any() else "the model still does not hold"
    shown_parts = Counter(part for parts in found.parts for part in parts)
    findings = [
        Finding("model", f"shows {part} that the rig's file does not tell: {end}", Weight.NOTE)
        for part, count in shown_parts.items()
        if count >= MOST_DIFFER * len(found)
    ]
    for signal, kind, size in _odd(found, task):
        if kind == "spikes":
            findings.append(Finding(signal, "has spikes: left out", Weight.NOTE, share=size))
            continue
        if kind == LATENCY:
            what = f"acts {_ms(size)} after its row, and not {_ms(task.command_latency)} ({kind})"
        elif kind == RISE_TIME:
            what = f"rise within {_ms(size)}, and not {_ms(task.sensors.pressure_rise_time)} ({kind})"
        elif kind == "white":
            what = f"scatters {number(size, 1)} times its data sheet"
        else:
            what = f"differs slowly from the model, by {_size(signal, size, task)}"
        findings.append(Finding(signal, f"{what}: {end}", Weight.NOTE))
    if found.holds.any() and found.of_model[found.holds].mean() >= MOST_DIFFER:
        findings.append(Finding("model", "differs slowly from several signals, which can hide a leak", Weight.DOUBT))
    return findings


def worst_signal(found: Estimate, task: TaskConfig) -> str:
    """The signal that differs most from the model, and how: ``pressure_a differs most, slowly, by 3.2 bar``."""
    slow, white = np.median(found.slow, axis=0), np.median(found.white, axis=0)
    total = np.hypot(slow, np.where(white > MORE, white, 0.0))
    channel = int(total.argmax())
    if not total[channel] > SLOW:
        return ""
    how = "slowly" if slow[channel] > white[channel] else "from sample to sample"
    name = SENSORS[channel]
    return f"{name} differs most from the model, {how}, by {_size(name, float(total[channel]), task)}"


def _ms(seconds: float) -> str:
    return f"{number(1e3 * seconds, 1)} ms"


def _size(name: str, size: float, task: TaskConfig) -> str:
    look = shown(f"{name}_bias", task.plant)
    return f"{number(look.factor * size * _noise(name, task), 3)} {look.unit}"


def _noise(name: str, task: TaskConfig) -> float:
    return float(noise_of(task)[SENSORS.index(name)])
