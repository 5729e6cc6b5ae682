"""The page of a diagnosis, for the person who maintains the axis, and the files beside it."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.kit import GREEN, ORANGE, PAPER, Page, drawn, signal, time_panels
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import capitalised
from hydro_env.files import write_text
from hydro_env.types import Array, Floats
from hydro_rig.diagnosis.diagnose import Diagnosis, leak_table
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.identification.identification_page import findings_frame, rig_line
from hydro_rig.recordings.columns import MEASURED
from hydro_rig.recordings.findings import Finding, lines_of

PAGE_FILE, TABLE_FILE, FINDINGS_FILE = FILES = ("diagnosis.html", "leak.csv", "findings.csv")
JOB = "diagnose"

ADVICE = {
    Kind.HEALTHY: "The piston seal leaks too little to matter for the axis. Record again after some time.",
    Kind.LEAK: "The piston seal leaks. Plan its replacement by the size and by how fast it grows; record again after "
    "some time under the same conditions.",
    Kind.OTHER: "Something besides the piston seal differs from the rig's data sheet. Check the named part "
    "before the seal.",
    Kind.UNKNOWN: "This recording gives no answer. The verdict gives the reason; correct it and record again.",
}
"""What to do next."""

STYLES = {Kind.HEALTHY: "good", Kind.LEAK: "worse", Kind.OTHER: "doubtful", Kind.UNKNOWN: ""}  # of the pages

PANELS = {
    "position, mm": (1e3, ("position",)),
    "pressure, bar": (1e-5, ("pressure_a", "pressure_b")),
    "valve, %": (100.0, ("spool_position", "command")),
}
"""Displayed units per SI unit, and signals, of each row of the figure."""

FIRST_DATE = 1e9  # s since 1970; smaller stamps are no dates
LOWEST, HIGHEST = 1e-3, 20.0  # l/min at 100 bar; ends of the scale


def diagnose_to_folder(folder: Path, diagnosis: Diagnosis, overwrite: bool, command: str, change: str) -> list[str]:
    """Write page, table and findings; returns the lines for the user, the verdict last; ``change``: a sentence."""
    with output_folder(folder, JOB, FILES, overwrite=overwrite):
        write_text(folder / TABLE_FILE, leak_table(diagnosis).to_csv(index=False, lineterminator="\n"))
        findings = pd.DataFrame(diagnosis.checked.findings, columns=Finding._fields)
        write_text(folder / FINDINGS_FILE, findings.to_csv(index=False, lineterminator="\n", float_format="%.6g"))
        diagnosis_page(diagnosis, line=change).write(folder / PAGE_FILE, Origin.now(command))
    lines = lines_of(diagnosis.checked.findings)
    return [*lines, str(folder / PAGE_FILE), *filter(None, [change]), diagnosis.verdict.line()]


@drawn
def diagnosis_page(
    diagnosis: Diagnosis,
    title: str = "Diagnosis",
    numbers: str = "leak.csv (readings of each window) and findings.csv",
    line: str = "",
) -> Page:
    """The verdict and what to do next, the readings over time, and what is wrong with the recording."""
    recording = diagnosis.recording
    page = Page(f"{title}: {Path(recording.source).name}", f"Numbers: {numbers} beside this page.")
    page.verdict(capitalised(diagnosis.verdict.line()), STYLES[diagnosis.verdict.kind])
    if line:
        page.text(f"{capitalised(line)}.")
    page.text(ADVICE[diagnosis.verdict.kind])
    page.text("The true leak lies within the interval in brackets in nine of ten recordings.", "soft")
    page.heading("Leak over time")
    axes = time_panels(("leak, l/min at 100 bar", *PANELS), 9.5, height_ratios=[1.7, 1, 1, 1])
    draw_leak(axes[0], diagnosis)
    draw_signals(axes[1:], recording.time, recording.signals)
    page.figure(
        axes,
        "Leak and measured signals",
        "Each point is one window with its 90 % interval; a hollow one does not count. Green: healthy. Orange: faults.",
    )
    page.heading("The recording")
    if diagnosis.checked.findings:
        page.table(findings_frame(diagnosis.checked.findings), "Findings", words=True)
    samples = diagnosis.checked.samples
    began = "without a date"
    if recording.begin > FIRST_DATE:
        began = datetime.fromtimestamp(recording.begin, UTC).isoformat(" ", "seconds")
    facts = {
        "recording": recording.source,
        "rig assumed": rig_line(diagnosis.task.plant),
        "begins": began,
        "duration, s": recording.time[-1],
        "rows": len(recording.time),
        "control period, ms": 1e3 * samples.period,
        "windows": len(diagnosis.windows),
        "windows with an answer": diagnosis.reading.answers.sum(),
    }
    page.facts(facts)
    return page


def draw_signals(axes: Sequence[Axes], time: Array, signals: Floats) -> None:
    """The signals (5, T) over time, one panel each of :data:`PANELS`."""
    for one, (factor, names) in zip(axes, PANELS.values(), strict=True):
        for name in names:
            signal(one, time, factor * signals[MEASURED.index(name)], label=name.replace("_", " "), linewidth=1.0)


def scale_of_leaks(axes: Axes) -> None:
    """The scale of leaks, l/min at 100 bar: logarithmic, from LOWEST to HIGHEST."""
    axes.set(yscale="log", ylim=(LOWEST, HIGHEST))
    axes.set_yticks([0.001, 0.01, 0.1, 1.0, 10.0], ["≤ 0.001", "0.01", "0.1", "1", "10"])
    axes.set_yticks([], minor=True)


def draw_leak(axes: Axes, diagnosis: Diagnosis) -> None:
    """The leak of each window with its 90 % interval; a hollow marker does not count."""
    windows, limits = diagnosis.windows, diagnosis.limits
    scale_of_leaks(axes)
    axes.axhspan(LOWEST, limits.healthy, color=GREEN, alpha=0.10, linewidth=0)
    axes.axhspan(limits.fault, HIGHEST, color=ORANGE, alpha=0.07, linewidth=0)
    reading, middle = diagnosis.reading, 0.5 * (windows.begin + windows.end)
    if not len(reading.answers):
        return
    sizes = np.clip(reading.sizes, LOWEST, HIGHEST)
    for counts, face, label in ((reading.answers, ORANGE, "estimator"), (~reading.answers, PAPER, "does not count")):
        chosen = np.isfinite(reading.flow_lpm) & counts
        value, low, high = sizes[:, chosen]
        axes.errorbar(
            middle[chosen],
            value,
            [value - low, high - value],
            fmt="s",
            color=ORANGE,
            markerfacecolor=face,
            markersize=4.5,
            linewidth=1.2,
            label=label if chosen.any() else "_",
        )
