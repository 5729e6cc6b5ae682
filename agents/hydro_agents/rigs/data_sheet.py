"""Where a recording contradicts the data sheet: timing, noise, slow errors and spikes, in words and as lines of a file.

The estimator (:mod:`hydro_agents.estimation.estimate`) estimates them from the windows that the data sheet does not
explain.
"""

from __future__ import annotations

import math

import numpy as np
import yaml
from numpy.typing import NDArray

from hydro_agents.estimation.model import noise_of
from hydro_agents.estimation.result import Estimate
from hydro_agents.recordings.findings import Finding, Weight
from hydro_agents.running.text import Table, number
from hydro_env import TaskConfig
from hydro_env.task.sensors import SENSORS

MORE, LESS = 1.1, 0.7  # white noise over that of the data sheet that is worth a line
LATENCY_CHANGE = 0.1  # difference of the latency that is worth a line, in control periods
RISE_TIME_CHANGE = 1e-3  # s
SLOW = 1.0  # slow error that is worth a line, in standard deviations of the data sheet's noise
SPIKES = 0.002  # share of spikes that is worth a line

READ_IN = {"position": (1e3, "mm"), "spool_position": (100.0, "%")}
"""Displayed units per unit, and their name; pressures are in bar."""


def contradictions(found: Estimate, task: TaskConfig) -> list[Finding]:
    """What the recording says of timing and errors that the data sheet does not, one finding each.

    Args:
        found: the windows of a recording; those with an answer count, or all if there is none.
        task: as the estimate assumed it.
    """
    used = found.part(np.flatnonzero(found.holds)) if found.holds.any() else found
    end = "used" if found.holds.any() else "the model still does not hold"
    findings = []
    latency = float(np.median(used.latency))
    if abs(latency - task.command_latency) > LATENCY_CHANGE * task.control_period:
        ours = f"{number(1e3 * task.command_latency, 1)} ms"
        what = f"acts {number(1e3 * latency, 1)} ms after its row, and not {ours} (command_latency): {end}"
        findings.append(Finding("command", what, Weight.NOTE))
    rise, usual = float(np.median(used.rise_time)), task.sensors.pressure_rise_time
    if abs(rise - usual) > RISE_TIME_CHANGE:
        what = f"rise within {number(1e3 * max(rise, 0.0), 1)} ms, and not {number(1e3 * usual, 1)} ms"
        findings.append(Finding("pressures", f"{what} (pressure_rise_time): {end}", Weight.NOTE))
    white, slow, spikes = (np.median(part, axis=0) for part in (used.white, used.slow, used.spikes))
    for channel, name in enumerate(SENSORS):
        if not LESS <= white[channel] <= MORE:
            what = f"scatters {number(float(white[channel]), 1)} times its data sheet: {end}"
            findings.append(Finding(name, what, Weight.NOTE))
        if slow[channel] > SLOW:
            what = f"differs slowly from the model, by {_size(name, float(slow[channel]), task)}: {end}"
            findings.append(Finding(name, what, Weight.NOTE))
        if spikes[channel] > SPIKES:
            findings.append(Finding(name, "has spikes: left out", Weight.NOTE, share=float(spikes[channel])))
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


def residual_table(found: Estimate, task: TaskConfig) -> Table:
    """Noise, slow error and spikes of each signal that was recorded, medians over the windows."""
    rows = []
    values = zip(SENSORS, *(np.median(part, axis=0) for part in (found.white, found.slow, found.spikes)), strict=True)
    for name, white, slow, spikes in values:
        sizes = (_size(name, float(part), task) if part > 0.0 else "none" for part in (1.0, white, slow))
        rows.append((name.replace("_", " "), *sizes, f"{number(100.0 * float(spikes), 1)} %"))
    header = ("Signal", "noise of the data sheet", "noise found", "slow difference from the model", "spikes")
    return Table("Standard deviations; what the model does not explain, median over the windows", header, rows)


def lines_to_paste(found: Estimate, task: TaskConfig) -> str:
    """The contradictions as lines of a task's file; empty if there are none."""
    if not found.holds.any():
        return ""
    used = found.part(np.flatnonzero(found.holds))
    rows, values = 0, {}
    sensors: dict[str, object] = {}
    latency, rise = float(np.median(used.latency)), float(np.median(used.rise_time))
    if abs(latency - task.command_latency) > LATENCY_CHANGE * task.control_period:
        rows = math.floor(latency / task.control_period)
        values["command_latency"] = _rounded(latency - rows * task.control_period)
    if abs(rise - task.sensors.pressure_rise_time) > RISE_TIME_CHANGE:
        sensors["pressure_rise_time"] = _rounded(max(rise, 0.0))
    for channel, (name, white) in enumerate(zip(SENSORS, np.median(used.white, axis=0), strict=True)):
        if not LESS <= white <= MORE:
            sensors[name] = {"noise": _rounded(float(white * noise_of(task)[channel]))}
    whole: dict[str, object] = values | ({"sensors": sensors} if sensors else {})
    text: str = yaml.safe_dump(whole, sort_keys=False) if whole else ""
    return text + (f"# and in the map of the columns: command: {{rows_early: {rows}, …}}\n" if rows else "")


def lively(signals: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """The windows (B, 5, T) with the longest way of the command, which show best whether the model holds."""
    way = np.nansum(np.abs(np.diff(signals[:, -1], axis=1)), axis=1)
    return np.sort(np.argsort(-way, kind="stable")[:count])


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _size(name: str, size: float, task: TaskConfig) -> str:
    factor, unit = READ_IN.get(name, (1e-5, "bar"))
    return f"{number(factor * size * float(noise_of(task)[SENSORS.index(name)]), 3)} {unit}"
