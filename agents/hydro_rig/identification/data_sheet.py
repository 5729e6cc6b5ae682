"""Where a recording contradicts the data sheet: timing, noise, slow errors and spikes, in words.

The estimator (:mod:`hydro_rig.estimation.estimate`) estimates them from the windows that the data sheet does not
explain.
"""

from collections import Counter

import numpy as np

from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_rig.estimation.model import noise_of
from hydro_rig.estimation.result import NOISY, SLOW, Estimate
from hydro_rig.estimation.unknowns import LATENCY, RISE_TIME
from hydro_rig.identification.found_rig import shown
from hydro_rig.recordings.findings import Finding, Weight

LESS = 0.7  # white noise over that of the data sheet that is worth a line, as is more than NOISY
LATENCY_CHANGE = 0.1  # difference of the latency that is worth a line, in control periods
RISE_TIME_CHANGE = 1e-3  # s
MOST_DIFFER = 0.5  # share of the windows with an answer from which on the model counts as wrong
SPIKES = 0.002  # share of spikes that is worth a line


def contradictions(found: Estimate, task: TaskConfig) -> list[Finding]:
    """What the windows of a recording say of timing and errors that the data sheet does not, one finding each.

    The medians of the windows with an answer count, or of all if there is none.
    """
    holds = found.holds
    used = found.part(np.flatnonzero(holds)) if holds.any() else found
    end = "used" if holds.any() else "the model still does not hold"
    odd = [
        ("model", f"shows {part} that the assumed rig lacks")
        for part, count in Counter(part for parts in found.parts for part in parts).items()
        if count >= MOST_DIFFER * len(found)
    ]
    latency, rise_time = np.median(used.latency), np.median(used.rise_time)
    odd += off_the_sheet(latency, rise_time, np.median(used.white, axis=0), task)
    spiky = []
    for channel, name in enumerate(SENSORS):
        slow, spikes = (np.median(part[:, channel]) for part in (used.slow, used.spikes))
        if slow > SLOW:
            odd.append((name, f"differs slowly from the model, by {_size(channel, slow, task)}"))
        if spikes > SPIKES:
            spiky.append(Finding(name, "has spikes: left out", share=spikes))
    findings = [Finding(signal, f"{what}: {end}") for signal, what in odd] + spiky
    if holds.any() and found.of_model[holds].mean() >= MOST_DIFFER:
        findings.append(Finding("model", "differs slowly from several signals, which can hide a leak", Weight.DOUBT))
    return findings


def off_the_sheet(latency: float, rise_time: float, white: Floats, task: TaskConfig) -> list[tuple[str, str]]:
    """Signals whose timing (s) or white noise, (channels,) over that of the data sheet, is another, and how."""
    odd = []
    if abs(latency - task.command_latency) > LATENCY_CHANGE * task.control_period:
        odd.append(("command", f"acts {_ms(latency)} after its row, and not {_ms(task.command_latency)} ({LATENCY})"))
    rise_time, usual = max(rise_time, 0.0), task.sensors.pressure_rise_time
    if abs(rise_time - usual) > RISE_TIME_CHANGE:
        odd.append(("pressures", f"rise within {_ms(rise_time)}, and not {_ms(usual)} ({RISE_TIME})"))
    for name, noise in zip(SENSORS, white, strict=True):
        if not LESS <= noise <= NOISY:
            odd.append((name, f"scatters {number(noise, 1)} times its data sheet"))
    return odd


def worst_signal(found: Estimate, task: TaskConfig) -> str:
    """The signal that differs most from the model, and how: ``pressure_a differs most, slowly, by 3.2 bar``."""
    slow, white = np.median(found.slow, axis=0), np.median(found.white, axis=0)
    total = np.hypot(slow, np.where(white > NOISY, white, 0.0))
    channel = int(total.argmax())
    if not total[channel] > SLOW:
        return ""
    how = "slowly" if slow[channel] > white[channel] else "from sample to sample"
    return f"{SENSORS[channel]} differs most from the model, {how}, by {_size(channel, total[channel], task)}"


def _ms(seconds: float) -> str:
    return f"{number(1e3 * seconds, 1)} ms"


def _size(channel: int, size: float, task: TaskConfig) -> str:
    """An error over the noise of the data sheet, in the unit of its channel."""
    look = shown(f"{SENSORS[channel]}_bias")
    return f"{number(look.factor * size * noise_of(task)[channel], 3)} {look.unit}"
