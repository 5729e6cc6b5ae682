"""Where a recording contradicts the data sheet: timing, noise, slow errors and spikes, in words and as lines of a file.

The estimator (:mod:`hydro_rig.estimation.estimate`) estimates them from the windows that the data sheet does not
explain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import yaml

from hydro_agents.running.text import Table, number
from hydro_env import TaskConfig
from hydro_env.task.sensors import SENSORS
from hydro_rig.estimation.model import noise_of
from hydro_rig.estimation.result import Estimate
from hydro_rig.identification.found_rig import shown
from hydro_rig.recordings.findings import Finding, Weight

MORE, LESS = 1.1, 0.7  # white noise over that of the data sheet that is worth a line
LATENCY_CHANGE = 0.1  # difference of the latency that is worth a line, in control periods
RISE_TIME_CHANGE = 1e-3  # s
SLOW = 1.0  # slow error that is worth a line, in standard deviations of the data sheet's noise
SPIKES = 0.002  # share of spikes that is worth a line


class _Contradicted(NamedTuple):
    """What the recording says that the data sheet does not; ``None``, or no entry: they agree."""

    latency: float | None  # s
    rise_time: float | None  # s
    white: dict[str, float]  # by sensor, over the noise of the data sheet
    slow: dict[str, float]
    spikes: dict[str, float]  # share of the readings

    @classmethod
    def of(cls, used: Estimate, task: TaskConfig) -> _Contradicted:
        """The medians over some windows, where they are worth a line."""
        latency, rise = float(np.median(used.latency)), float(np.median(used.rise_time))
        late = abs(latency - task.command_latency) > LATENCY_CHANGE * task.control_period
        slower = abs(rise - task.sensors.pressure_rise_time) > RISE_TIME_CHANGE
        white, slow, spikes = (
            dict(zip(SENSORS, np.median(part, axis=0).tolist(), strict=True))
            for part in (used.white, used.slow, used.spikes)
        )
        return cls(
            latency if late else None,
            max(rise, 0.0) if slower else None,
            {name: size for name, size in white.items() if not LESS <= size <= MORE},
            {name: size for name, size in slow.items() if size > SLOW},
            {name: share for name, share in spikes.items() if share > SPIKES},
        )


def contradictions(found: Estimate, task: TaskConfig) -> list[Finding]:
    """What the recording says of timing and errors that the data sheet does not, one finding each.

    Args:
        found: the windows of a recording; those with an answer count, or all if there is none.
        task: as the estimate assumed it.
    """
    used = found.part(np.flatnonzero(found.holds)) if found.holds.any() else found
    end = "used" if found.holds.any() else "the model still does not hold"
    odd, findings = _Contradicted.of(used, task), []
    if odd.latency is not None:
        ours = f"{number(1e3 * task.command_latency, 1)} ms"
        what = f"acts {number(1e3 * odd.latency, 1)} ms after its row, and not {ours} (command_latency): {end}"
        findings.append(Finding("command", what, Weight.NOTE))
    if odd.rise_time is not None:
        usual = f"{number(1e3 * task.sensors.pressure_rise_time, 1)} ms"
        what = f"rise within {number(1e3 * odd.rise_time, 1)} ms, and not {usual} (pressure_rise_time): {end}"
        findings.append(Finding("pressures", what, Weight.NOTE))
    for name in SENSORS:
        if name in odd.white:
            what = f"scatters {number(odd.white[name], 1)} times its data sheet: {end}"
            findings.append(Finding(name, what, Weight.NOTE))
        if name in odd.slow:
            what = f"differs slowly from the model, by {_size(name, odd.slow[name], task)}: {end}"
            findings.append(Finding(name, what, Weight.NOTE))
        if name in odd.spikes:
            findings.append(Finding(name, "has spikes: left out", Weight.NOTE, share=odd.spikes[name]))
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
    odd = _Contradicted.of(found.part(np.flatnonzero(found.holds)), task)
    rows, values = 0, {}
    sensors: dict[str, object] = {}
    if odd.latency is not None:
        rows = math.floor(odd.latency / task.control_period)
        values["command_latency"] = _rounded(odd.latency - rows * task.control_period)
    if odd.rise_time is not None:
        sensors["pressure_rise_time"] = _rounded(odd.rise_time)
    for name, white in odd.white.items():
        sensors[name] = {"noise": _rounded(white * _noise(name, task))}
    whole: dict[str, object] = values | ({"sensors": sensors} if sensors else {})
    text: str = yaml.safe_dump(whole, sort_keys=False) if whole else ""
    return text + (f"# and in the map of the columns: command: {{rows_early: {rows}, …}}\n" if rows else "")


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _size(name: str, size: float, task: TaskConfig) -> str:
    look = shown(f"{name}_bias", task.plant)
    return f"{number(look.factor * size * _noise(name, task), 3)} {look.unit}"


def _noise(name: str, task: TaskConfig) -> float:
    return float(noise_of(task)[SENSORS.index(name)])
