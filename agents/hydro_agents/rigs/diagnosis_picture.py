"""The picture of a diagnosis: the leak over time with its interval, and the measured signals with the findings."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hydro_agents.detection.detector import Reading
from hydro_agents.recordings.findings import Finding, Weight
from hydro_agents.report.canvas import GREY, INK, PAPER, looks_of, thinned, with_gaps
from hydro_agents.report.palette import MEANINGS
from hydro_agents.rigs.verdict import Kind

if TYPE_CHECKING:
    from hydro_agents.rigs.diagnose import Diagnosis

GOOD, WORSE = MEANINGS["good"].light, MEANINGS["worse"].light
COLOUR = {Weight.SEVERE: WORSE, Weight.FAULT: WORSE, Weight.NOTE: GREY}
LOWEST, HIGHEST = 1e-3, 20.0
"""l/min at 100 bar; ends of the scale."""

PANELS = ("position", "pressure_a", "pressure_b", "spool_position", "command")


def paint(figure: Figure, diagnosis: Diagnosis) -> None:
    """Draw leak, position, pressures, spool and command over time."""
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1.7, 1, 1, 1])
    paint_leak(axes[0], diagnosis)
    paint_signals(axes[1:], diagnosis)
    axes[-1].set_xlabel("time, s")
    figure.suptitle(_title(diagnosis), fontsize=10, fontweight="bold", x=0.01, ha="left")
    for axis in axes:  # room for short labels
        axis.margins(x=0.01)


def paint_leak(axes: Axes, diagnosis: Diagnosis) -> None:
    """The leak of each window with its 90 % interval; a hollow marker is an invalid reading."""
    windows, limits = diagnosis.windows, diagnosis.limits
    axes.set_yscale("log")
    axes.set_ylim(LOWEST, HIGHEST)
    axes.set_ylabel("leak, l/min at 100 bar")
    axes.set_yticks([0.001, 0.01, 0.1, 1.0, 10.0], ["≤ 0.001", "0.01", "0.1", "1", "10"])
    axes.axhspan(LOWEST, limits.healthy, color=GOOD, alpha=0.10, linewidth=0)
    axes.axhspan(limits.fault, HIGHEST, color=WORSE, alpha=0.07, linewidth=0)
    for height, text in ((LOWEST, "healthy seal"), (limits.fault, "faulty seal")):
        axes.annotate(
            text, (0.004, height), xycoords=("axes fraction", "data"), xytext=(0, 3), textcoords="offset points",
            va="bottom", fontsize=8, color=GREY,
        )  # fmt: skip
    readings = {"leakage head": diagnosis.head, "estimator": diagnosis.estimator}
    looks = looks_of(["leakage head", "estimator"])
    middle = 0.5 * (windows.begin + windows.end)
    shift = 0.12 * float(windows.end[0] - windows.begin[0]) if len(middle) else 0.0
    for name, reading in readings.items():
        if reading is not None:
            side = -shift if name == "leakage head" else shift
            _paint_reading(axes, middle + side, reading, looks[name].colour, looks[name].marker, name)
    if diagnosis.alarm is not None and diagnosis.alarm.at is not None:
        axes.axvline(diagnosis.alarm.at, color=INK, linestyle="--", linewidth=1.2, label="alarm")
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8)
    else:
        axes.text(0.5, 0.5, "no window was read", transform=axes.transAxes, ha="center", color=GREY)


def _paint_reading(axes: Axes, place: NDArray[Any], reading: Reading, colour: str, marker: str, name: str) -> None:
    def shown(values: NDArray[Any]) -> NDArray[Any]:
        clipped: NDArray[Any] = np.clip(values, LOWEST, HIGHEST)
        return clipped

    counts, known = reading.answers, np.isfinite(reading.flow_lpm)
    for chosen, options, label in (
        (known & counts, {"markerfacecolor": colour}, name),
        (known & ~counts, {"markerfacecolor": PAPER, "alpha": 0.5}, f"{name}, does not count"),
    ):
        if chosen.any():
            parts = (reading.flow_lpm, reading.low_lpm, reading.high_lpm)
            value, low, high = (shown(values[chosen]) for values in parts)
            axes.errorbar(
                place[chosen], value, yerr=[value - low, high - value], fmt=marker, color=colour, markersize=4.5,
                capsize=2, linewidth=1.2, label=label, **options,
            )  # fmt: skip


def paint_signals(axes: Any, diagnosis: Diagnosis) -> None:
    """Draw position, pressures, and spool with command, in mm, bar and %, and mark the findings."""
    recording = diagnosis.recording
    position, pressure_a, pressure_b, spool, command = recording.signals
    looks = list(looks_of(range(2)).values())
    panels = (
        ("position, mm", [("position", 1e3 * position)]),
        ("pressure, bar", [("pressure_a", 1e-5 * pressure_a), ("pressure_b", 1e-5 * pressure_b)]),
        ("valve, %", [("spool_position", 100 * spool), ("command", 100 * command)]),
    )
    for axis, (label, lines) in zip(axes, panels, strict=True):
        for (name, values), look in zip(lines, looks, strict=False):
            axis.plot(
                *with_gaps(*thinned(recording.time, values)), label=name.replace("_", " "), linewidth=1.0, **look.stroke
            )
        axis.set_ylabel(label)
        names = {name for name, _ in lines}
        for finding in diagnosis.checked.findings:
            if finding.signal in names or (finding.signal == "time" and "position" in names):
                _mark(axis, finding, float(recording.time[-1]))
        if len(lines) > 1:
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, fontsize=8)


def _mark(axes: Axes, finding: Finding, last: float) -> None:
    """Shade the first place of a finding, and name it."""
    if not np.isfinite(finding.begin):
        return
    width = max(finding.end - finding.begin, 0.003 * last)
    axes.axvspan(finding.begin, finding.begin + width, color=COLOUR[finding.weight], alpha=0.35, linewidth=0)
    words = finding.what.split(",")[0].split(":")[0].split(";")[0]
    right = finding.begin > 0.6 * last
    axes.annotate(
        words[:60], (finding.begin + (0 if right else width), 0.97), xycoords=("data", "axes fraction"),
        xytext=(-3 if right else 3, 0), textcoords="offset points", ha="right" if right else "left", va="top",
        fontsize=8, color=INK,
    )  # fmt: skip


def _title(diagnosis: Diagnosis) -> str:
    line = diagnosis.verdict.line()
    if diagnosis.verdict.kind is Kind.UNKNOWN:
        line = line.split(";")[0]
    line = line[:1].upper() + line[1:]
    return fill(line, 105, max_lines=2, placeholder=" …")
