"""What the pages of a recording share: verdict, method, and the measured signals of the figure."""

from __future__ import annotations

from collections.abc import Sequence

from hydro_agents.report.canvas import GREY
from hydro_agents.report.content import Content
from hydro_agents.report.palette import MEANINGS
from hydro_agents.report.recorded import Line, Mark, Signal
from hydro_agents.report.sections import Block, Points, Text, section
from hydro_agents.running.text import capitalised
from hydro_rig.diagnosis.verdict import Kind, Verdict
from hydro_rig.recordings.columns import MEASURED
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.recording import Recording

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

COLOURS = {Weight.SEVERE: MEANINGS["worse"].light, Weight.FAULT: MEANINGS["worse"].light, Weight.NOTE: GREY}
LEAST_WIDTH = 0.003  # of a mark, as a share of the recording


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
        marks = [mark_of(finding, last) for finding in findings if finding.signal in about and finding.begin >= 0.0]
        rows.append(Signal(label, lines, marks=marks))
    return rows


def mark_of(finding: Finding, last: float) -> Mark:
    """The first place of a finding with its words, of a recording that ends at ``last`` s."""
    words = finding.what.split(",")[0].split(":")[0].split(";")[0]
    width = max(finding.end - finding.begin, LEAST_WIDTH * last)
    return Mark(finding.begin, finding.begin + width, words[:60], COLOURS[finding.weight], 0.35)
