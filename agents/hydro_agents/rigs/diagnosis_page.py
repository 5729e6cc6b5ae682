"""The page of a diagnosis: one HTML file without external parts, for the person who maintains the axis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hydro_agents.detection.detector import Reading
from hydro_agents.recordings.findings import Weight
from hydro_agents.report.canvas import WIDE, Plot, make_plot
from hydro_agents.report.page import Page, make_page
from hydro_agents.rigs.diagnosis_picture import paint
from hydro_agents.rigs.verdict import Kind, combined, named_fault
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, number, setting
from hydro_env import PlantParameters
from hydro_env.units import UNITS

if TYPE_CHECKING:
    from hydro_agents.rigs.diagnose import Diagnosis

HERE = Path(__file__).parent

ADVICE = {
    Kind.HEALTHY: "The piston seal leaks too little to matter for the axis. Record again after some time.",
    Kind.LEAK: "The piston seal leaks. Plan its replacement by the size and by how fast it grows; record again after "
    "some time under the same conditions.",
    Kind.OTHER: "Something besides the piston seal differs from the rig's data sheet. Check the named part "
    "before the seal.",
    Kind.UNKNOWN: "This recording gives no answer. The verdict gives the reason; correct it and record again.",
}

STYLES = {Kind.HEALTHY: "good", Kind.LEAK: "worse", Kind.OTHER: "doubtful", Kind.UNKNOWN: ""}
"""Class of the verdict in the style of the pages."""

MEANING = {
    Weight.SEVERE: "rules out a verdict",
    Weight.FAULT: "a sensor is faulty",
    Weight.NOTE: "does not matter much",
}

MOST_ROWS = 200
"""Largest number of windows in the table of the page; the CSV file holds all."""


def write_page(path: Path, diagnosis: Diagnosis, command: str) -> None:
    """Write the page, and its figure into a folder beside it."""
    render_page(diagnosis, Origin.now(command)).write(path)


def render_page(diagnosis: Diagnosis, origin: Origin) -> Page:
    """The page."""
    verdict, recording = diagnosis.verdict, diagnosis.recording
    samples = diagnosis.checked.samples
    facts = [
        ("Recording", recording.source),
        ("Rig assumed", rig_line(diagnosis.plant)),
        ("Duration", f"{number(float(recording.time[-1]), 2)} s, {len(recording.time)} rows"),
        ("Control period", f"{1e3 * samples.period:g} ms, {len(samples.time)} samples"),
        ("Windows", _counts(diagnosis)),
    ]
    return make_page(
        HERE / "diagnosis.html.j2",
        origin,
        line=sentence(verdict.line()),
        verdict=verdict,
        style=STYLES[verdict.kind],
        advice=ADVICE[verdict.kind],
        findings=findings_table(diagnosis),
        plot=_plot(diagnosis),
        table=leak_table(diagnosis),
        more=max(len(diagnosis.windows) - MOST_ROWS, 0),
        alarm=diagnosis.alarm.line() if diagnosis.alarm is not None else "",
        head=head_line(diagnosis.head),
        note=f"{sentence(diagnosis.note)}." if diagnosis.note else "",
        facts=Table("", ("Fact", "Value"), facts),
    )


def rig_line(plant: PlantParameters) -> str:
    """The nameplate of a rig in one line, by which a person sees whether it is the recorded one."""
    cylinder, supply = plant.cylinder, plant.supply.pressure / UNITS["Pa"]["bar"]
    return (
        f"bore {1e3 * cylinder.bore_diameter:g} mm, rod {1e3 * cylinder.rod_diameter:g} mm, "
        f"stroke {1e3 * cylinder.stroke:g} mm, supply {supply:g} bar"
    )


def _plot(diagnosis: Diagnosis) -> Plot:
    limits = diagnosis.limits
    note = (
        f"Each point is one window with its 90 % interval. Green: leaks of healthy seals, up to "
        f"{setting(limits.healthy)} l/min at 100 bar. Orange: leaks that count as a fault, from "
        f"{setting(limits.fault)} l/min. Shaded in the measured signals: the first place of each finding."
    )
    alt = f"Leak over time and measured signals. {diagnosis.verdict.line()}"
    title = "Leak and measured signals"
    return make_plot("diagnosis", title, note, alt, lambda figure: paint(figure, diagnosis), 9.5, WIDE)


def sentence(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def head_line(reading: Reading | None) -> str:
    """The result of the leakage head for the whole recording, for comparison; empty if it was not used."""
    if reading is None:
        return ""
    if not reading.answers.any():
        return "The leakage head gives no valid reading."
    leak, _ = combined(reading)
    fault = named_fault(reading)
    return f"The leakage head reads {leak.text()}; other faults that it names: {fault or 'none'}."


def _counts(diagnosis: Diagnosis) -> str:
    parts = [f"{len(diagnosis.windows)} windows"]
    for name, reading in (("estimator", diagnosis.estimator), ("leakage head", diagnosis.head)):
        if reading is not None:
            parts.append(f"{int(reading.answers.sum())} read by the {name}")
    return ", ".join(parts)


def findings_table(diagnosis: Diagnosis) -> Table | None:
    """The findings about the recording; ``None`` without findings."""
    findings = diagnosis.checked.findings
    if not findings:
        return None
    rows = [
        (finding.signal, finding.line().removeprefix(f"{finding.signal} "), MEANING[finding.weight])
        for finding in findings
    ]
    return Table("", ("Signal", "Finding", "For the verdict"), rows)


def leak_table(diagnosis: Diagnosis) -> Table | None:
    """The readings of each window; ``None`` without windows."""
    readings = [
        (n, r) for n, r in (("estimator", diagnosis.estimator), ("leakage head", diagnosis.head)) if r is not None
    ]
    if not readings:
        return None
    rows = []
    for window in range(min(len(diagnosis.windows), MOST_ROWS)):
        begin, end = diagnosis.windows.begin[window], diagnosis.windows.end[window]
        cells = [f"{number(float(begin), 1)} to {number(float(end), 1)} s"]
        for _, reading in readings:
            cells += [_shown(reading, window), reading.fault[window] or reading.why[window]]
        rows.append(tuple(cells))
    header = ("Window", *(text for name, _ in readings for text in (name, "remark")))
    return Table("Leak in l/min at 100 bar, 90 % interval", header, rows)


def _shown(reading: Reading, window: int) -> str:
    value, low, high = reading.flow_lpm[window], reading.low_lpm[window], reading.high_lpm[window]
    text = f"{number(value, 3)} [{number(max(low, 0.0), 3)}, {number(max(high, 0.0), 3)}]"
    return text if reading.answers[window] else "–"
