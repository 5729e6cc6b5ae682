"""The page of a diagnosis, for the person who maintains the axis, and the files beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hydro_agents.detection.detector import Reading
from hydro_agents.report.canvas import GREY, PAPER, WIDE, Plot, make_plot
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.palette import MEANINGS, Look, looks_of
from hydro_agents.report.recorded import Line, Mark, Signal, paint_course, recording_tables
from hydro_agents.report.sections import Block, Points, Text, render_page, section
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import capitalised, setting
from hydro_env.files import write_text
from hydro_rig.diagnosis.diagnose import Diagnosis, findings_table, leak_table
from hydro_rig.diagnosis.verdict import Kind, Verdict
from hydro_rig.identification.data_sheet import lines_to_paste
from hydro_rig.recordings.columns import MEASURED
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.recording import Recording

PAGE_FILE, TABLE_FILE, FINDINGS_FILE = "diagnosis.html", "leak.csv", "findings.csv"
FILES = (PAGE_FILE, TABLE_FILE, FINDINGS_FILE, FIGURE_FILES)
JOB = "diagnose"

DIAGNOSIS = ("diagnosed", "leak_over_time", "recording", "judging")
"""Sections of the page, in order."""
SOURCES = Markup(
    "Readings of each window: <code>leak.csv</code>; findings: <code>findings.csv</code>; both are beside this page."
)

ESTIMATOR = Markup(
    "<strong>Estimator</strong>: simulates the rig of the data sheet with the recorded commands, and changes leak, "
    "plant, wear and sensor offsets until it reproduces the readings. If the difference remains above the sensors' "
    "noise, its reading is not valid."
)
HEAD = Markup("<strong>Leakage head</strong>: a network trained on simulated axes. It is faster, and less accurate.")
OWN = Markup("<strong>{}</strong>: a detector that was given with <code>--detector</code>.")
JUDGING = (
    "The estimator decides if it has read at least one window. If its model does not describe the recording, the "
    "verdict is “cannot tell”.",
    "The limits are those of servo faults. Acceptance tests of new cylinders require far less: about 0.06 ml/min for a "
    "bore of 40 mm.",
)

ADVICE = {
    Kind.HEALTHY: "The piston seal leaks too little to matter for the axis. Record again after some time.",
    Kind.LEAK: "The piston seal leaks. Plan its replacement by the size and by how fast it grows; record again after "
    "some time under the same conditions.",
    Kind.OTHER: "Something besides the piston seal differs from the rig's data sheet. Check the named part "
    "before the seal.",
    Kind.UNKNOWN: "This recording gives no answer. The verdict gives the reason; correct it and record again.",
}
"""What to do next."""

STYLES = {Kind.HEALTHY: "good", Kind.LEAK: "worse", Kind.OTHER: "doubtful", Kind.UNKNOWN: ""}
"""Class of the verdict in the style of the pages."""

PANELS = {
    "position, mm": (1e3, ("position",)),
    "pressure, bar": (1e-5, ("pressure_a", "pressure_b")),
    "valve, %": (100.0, ("spool_position", "command")),
}
"""Displayed units per SI unit, and signals, of each row of the figure."""

GOOD, WORSE = MEANINGS["good"].light, MEANINGS["worse"].light
COLOURS = {Weight.SEVERE: WORSE, Weight.FAULT: WORSE, Weight.NOTE: GREY}
LEAST_WIDTH = 0.003  # of a mark, as a share of the recording

MEND = "These lines in the file of the task (--task) make its data sheet agree with the recording:"

LOWEST, HIGHEST = 1e-3, 20.0  # l/min at 100 bar; ends of the scale


def diagnose_to_folder(folder: Path, diagnosis: Diagnosis, overwrite: bool, command: str) -> list[str]:
    """Write page, table, findings and picture; returns the lines for the user, the verdict last."""
    with output_folder(folder, JOB, FILES, overwrite=overwrite):
        write_text(folder / TABLE_FILE, leak_table(diagnosis).to_csv(index=False, lineterminator="\n"))
        write_text(folder / FINDINGS_FILE, findings_table(diagnosis.checked.findings))
        render_diagnosis(diagnosis, Origin.now(command)).write(folder / PAGE_FILE)
    lines = [finding.line() for finding in diagnosis.checked.findings]
    fitted = diagnosis.read.fitted
    mend = lines_to_paste(fitted, diagnosis.task) if fitted is not None else ""
    lines += [f"{MEND}\n{mend.rstrip()}"] if mend else []
    return [*lines, str(folder / PAGE_FILE), diagnosis.verdict.line()]


def render_diagnosis(diagnosis: Diagnosis, origin: Origin) -> Page:
    """The page."""
    samples, companion = diagnosis.checked.samples, diagnosis.companion
    read = [f"{int(each.reading.answers.sum())} read by the {each.name}" for each in diagnosis.readings]
    tables = recording_tables(
        diagnosis.recording.source,
        diagnosis.task.plant,
        diagnosis.recording.time,
        diagnosis.checked.findings,
        Control_period=f"{1e3 * samples.period:g} ms, {len(samples.time)} samples",
        Windows=", ".join([f"{len(diagnosis.windows)} windows", *read]),
    )
    method = (ESTIMATOR, OWN.format(companion.name) if companion.own else HEAD, *JUDGING)
    parts = {"diagnosis": diagnosis, "verdict": diagnosis.verdict, "judging": method}
    content = Content(tables, diagnosis.task, others=parts)
    return render_page("Diagnosis of the axis", DIAGNOSIS, content, origin, SOURCES)


@section("", needs=("verdict",))
def diagnosed(content: Content) -> list[Block]:
    """The verdict, and what to do next."""
    verdict = content.part("verdict", Verdict)
    style = f"verdict {STYLES[verdict.kind]}".strip()
    flows: tuple[str, ...] = content.other("flows", ())
    lines = [Text(capitalised(line) + ".") for line in flows]
    return [Text(capitalised(verdict.line()), style), *lines, Text(ADVICE[verdict.kind])]


@section("How it was judged", needs=("judging",))
def judging(content: Content) -> list[Block]:
    """The method, and the limits."""
    return [Points(content.part("judging", tuple))]


@section("Leak over time", needs=("diagnosis",))
def leak_over_time(content: Content) -> list[Block]:
    """The readings and the signals over time."""
    diagnosis = content.part("diagnosis", Diagnosis)
    blocks: list[Block] = [_plot(diagnosis)]
    if diagnosis.note:
        blocks.append(Text(f"{capitalised(diagnosis.note)}. Only the estimator was used.", "soft"))
    return blocks


# The figure ---------------------------------------------------------------------------------------------------------


def signals_of(recording: Recording, findings: Sequence[Finding] = ()) -> list[Signal]:
    """Position, pressures, and spool with command over time; the first place of each finding is marked and named."""
    last = float(recording.time[-1])
    rows: list[Signal] = []
    for label, (size, names) in PANELS.items():
        lines = {
            name.replace("_", " "): Line(recording.time, size * recording.signals[MEASURED.index(name)])
            for name in names
        }
        about = {*names, "time"} if "position" in names else set(names)
        marks = []
        for finding in findings:
            if finding.signal in about and finding.begin >= 0.0:
                words = re.split("[,:;]", finding.what)[0][:60]
                end = finding.begin + max(finding.end - finding.begin, LEAST_WIDTH * last)
                marks.append(Mark(finding.begin, end, words, COLOURS[finding.weight], 0.35))
        rows.append(Signal(label, lines, marks=marks))
    return rows


def _plot(diagnosis: Diagnosis) -> Plot:
    limits = diagnosis.limits
    note = (
        f"Each point is one window with its 90 % interval. Green: leaks of healthy seals, up to "
        f"{setting(limits.healthy)} l/min at 100 bar. Orange: leaks that count as a fault, from "
        f"{setting(limits.fault)} l/min. Shaded in the measured signals: the first place of each finding."
    )
    alt = f"Leak over time and measured signals. {diagnosis.verdict.line()}"
    return make_plot(
        "diagnosis", "Leak and measured signals", note, alt, lambda figure: paint(figure, diagnosis), 9.5, WIDE
    )


def paint(figure: Figure, diagnosis: Diagnosis) -> None:
    """Draw leak, position, pressures, spool and command over time."""
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1.7, 1, 1, 1])
    paint_leak(axes[0], diagnosis)
    paint_course(axes[1:], signals_of(diagnosis.recording, diagnosis.checked.findings))


def paint_leak(axes: Axes, diagnosis: Diagnosis) -> None:
    """The leak of each window with its 90 % interval; a hollow marker is an invalid reading."""
    windows, limits = diagnosis.windows, diagnosis.limits
    axes.set_yscale("log")
    axes.set_ylim(LOWEST, HIGHEST)
    axes.set_ylabel("leak, l/min at 100 bar")
    axes.set_yticks([0.001, 0.01, 0.1, 1.0, 10.0], ["≤ 0.001", "0.01", "0.1", "1", "10"])
    axes.axhspan(LOWEST, limits.healthy, color=GOOD, alpha=0.10, linewidth=0)
    axes.axhspan(limits.fault, HIGHEST, color=WORSE, alpha=0.07, linewidth=0)
    looks = looks_of(["companion", "estimator"])
    middle = 0.5 * (windows.begin + windows.end)
    shift = 0.12 * float(windows.end[0] - windows.begin[0]) if len(middle) else 0.0
    for name, column, reading, _ in reversed(diagnosis.readings):
        estimator = column == "estimator"
        look = looks["estimator" if estimator else "companion"]
        _paint_reading(axes, middle + (shift if estimator else -shift), reading, look, name)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8)


def _paint_reading(axes: Axes, place: NDArray[Any], reading: Reading, look: Look, name: str) -> None:
    counts, known = reading.answers, np.isfinite(reading.flow_lpm)
    ends = [np.clip(values, LOWEST, HIGHEST) for values in (reading.flow_lpm, reading.low_lpm, reading.high_lpm)]
    for chosen, options, label in (
        (known & counts, {"markerfacecolor": look.colour}, name),
        (known & ~counts, {"markerfacecolor": PAPER, "alpha": 0.5}, f"{name}, does not count"),
    ):
        if chosen.any():
            value, low, high = (values[chosen] for values in ends)
            axes.errorbar(
                place[chosen], value, yerr=[value - low, high - value], fmt=look.marker, color=look.colour,
                markersize=4.5, capsize=2, linewidth=1.2, label=label, **options,
            )  # fmt: skip
