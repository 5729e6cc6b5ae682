"""The page of a diagnosis: one HTML file without external parts, for the person who maintains the axis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from agents.diagnosis.picture import paint
from agents.diagnosis.verdict import Kind, Reading, combined, named_fault
from agents.recordings.findings import Weight
from agents.report.canvas import WIDE, inline, render
from agents.report.text import Table, number, templates
from hydro_env import __version__
from hydro_env.files import write_text

if TYPE_CHECKING:
    from agents.diagnosis.diagnose import Diagnosis

HERE = Path(__file__).parent

ADVICE = {
    Kind.HEALTHY: "The piston seal leaks too little to matter for the axis. Record again after some time.",
    Kind.LEAK: "The piston seal leaks. Plan its replacement by the size and by how fast it grows; record again after "
    "some time under the same conditions.",
    Kind.OTHER: "Something besides the piston seal differs from the rig's data sheet. Check what the verdict names "
    "before the seal.",
    Kind.UNKNOWN: "This recording gives no answer. The reason stands in the verdict; mend it and record again.",
}

MEANING = {
    Weight.SEVERE: "rules out a verdict",
    Weight.FAULT: "a sensor is faulty",
    Weight.NOTE: "does not matter much",
}

MOST_ROWS = 200
"""Windows in the table of the page; the CSV file holds all."""


def write_page(path: Path, diagnosis: Diagnosis, command: str) -> None:
    """Write the page."""
    write_text(path, render_page(diagnosis, command))


def render_page(diagnosis: Diagnosis, command: str) -> str:
    """The page as HTML."""
    (svg,) = render(lambda figure: paint(figure, diagnosis), (WIDE, 9.5), "svg")
    verdict, recording = diagnosis.verdict, diagnosis.recording
    alt = f"Leak over time and measured signals. {verdict.line()}"
    samples = diagnosis.checked.samples
    facts = [
        ("Recording", recording.source),
        ("Duration", f"{number(float(recording.time[-1]), 2)} s, {len(recording.time)} rows"),
        ("Control period", f"{1e3 * samples.period:g} ms, {len(samples.time)} samples"),
        ("Windows", _counts(diagnosis)),
        ("Command", command),
        ("Version", f"hydro_env {__version__}"),
    ]
    return (
        templates(HERE)
        .get_template("page.html.j2")
        .render(
            line=sentence(verdict.line()),
            verdict=verdict,
            colour={Kind.HEALTHY: "#00805c", Kind.LEAK: "#d55e00", Kind.OTHER: "#8a6d00", Kind.UNKNOWN: "#5c5c63"}[
                verdict.kind
            ],
            advice=ADVICE[verdict.kind],
            findings=findings_table(diagnosis),
            svg=Markup(inline(svg, "diagnosis", alt)),
            table=leak_table(diagnosis),
            more=max(len(diagnosis.windows.begin) - MOST_ROWS, 0),
            limits=diagnosis.limits,
            alarm=diagnosis.alarm.line() if diagnosis.alarm is not None else "",
            head=head_line(diagnosis.head),
            note=diagnosis.note,
            facts=Table("", ("Fact", "Value"), facts),
        )
    )


def sentence(text: str) -> str:
    """The text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def head_line(reading: Reading | None) -> str:
    """What the leakage head says of the whole recording, to compare; empty if it was not used."""
    if reading is None:
        return ""
    if not reading.holds.any():
        return "The leakage head gives no reading that counts."
    leak, _ = combined(reading)
    fault = named_fault(reading)
    return f"The leakage head reads {leak.text()}; other faults that it names: {fault or 'none'}."


def _counts(diagnosis: Diagnosis) -> str:
    parts = [f"{len(diagnosis.windows.begin)} windows"]
    for name, reading in (("estimator", diagnosis.estimator), ("leakage head", diagnosis.head)):
        if reading is not None:
            parts.append(f"{int(reading.holds.sum())} read by the {name}")
    return ", ".join(parts)


def findings_table(diagnosis: Diagnosis) -> Table | None:
    """What is wrong with the recording; ``None`` if nothing is."""
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
    for window in range(min(len(diagnosis.windows.begin), MOST_ROWS)):
        begin, end = diagnosis.windows.begin[window], diagnosis.windows.end[window]
        cells = [f"{number(float(begin), 1)} to {number(float(end), 1)} s"]
        for _, reading in readings:
            cells += [_shown(reading, window), reading.fault[window] or reading.why[window]]
        rows.append(tuple(cells))
    header = ("Window", *(text for name, _ in readings for text in (name, "remark")))
    return Table("Leak in l/min at 100 bar, 90 % interval", header, rows)


def _shown(reading: Reading, window: int) -> str:
    value, low, high = reading.leak[window], reading.low[window], reading.high[window]
    text = f"{number(value, 3)} [{number(max(low, 0.0), 3)}, {number(max(high, 0.0), 3)}]"
    return text if reading.holds[window] else "–"
