"""What the pages of a recording share: verdict, facts, method, and the figure of the measured signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.canvas import thinned, with_gaps
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look, looks_of
from hydro_agents.report.sections import Block, Points, Text, section
from hydro_agents.report.shared import findings_frame
from hydro_agents.running.text import capitalised, number
from hydro_env import PlantParameters, TaskConfig
from hydro_env.types import Floats
from hydro_env.units import UNITS
from hydro_rig.diagnosis.verdict import Kind, Verdict
from hydro_rig.recordings.columns import MEASURED
from hydro_rig.recordings.findings import Finding
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
"""Displayed units per SI unit, and signals, of each panel of the figure."""


def content_of(
    recording: Recording,
    task: TaskConfig,
    verdict: Verdict,
    findings: Sequence[Finding],
    facts: Mapping[str, str],
    judging: Sequence[str],
    **parts: object,
) -> Content:
    """The content of a page of a recording.

    Args:
        recording: the rows.
        task: that was assumed.
        verdict: on the recording.
        findings: about it.
        facts: in addition to source, rig and duration.
        judging: how the verdict came about.
        parts: what other sections show.
    """
    common = {
        "Recording": recording.source,
        "Rig assumed": rig_line(task.plant),
        "Duration": f"{number(float(recording.time[-1]), 2)} s, {len(recording.time)} rows",
    }
    protocol = pd.DataFrame([*common.items(), *facts.items()], columns=["key", "value"])
    tables = {"protocol": protocol, "findings": findings_frame(findings)}
    return Content(tables, task, others={"verdict": verdict, "judging": tuple(judging), **parts})


def rig_line(plant: PlantParameters) -> str:
    """The nameplate of a rig in one line, by which a person sees whether it is the recorded one."""
    cylinder, supply = plant.cylinder, plant.supply.pressure / UNITS["Pa"]["bar"]
    return (
        f"bore {1e3 * cylinder.bore_diameter:g} mm, rod {1e3 * cylinder.rod_diameter:g} mm, "
        f"stroke {1e3 * cylinder.stroke:g} mm, supply {supply:g} bar"
    )


@section("", needs=("verdict",))
def diagnosed(content: Content) -> list[Block]:
    """The verdict, and what to do next."""
    verdict = content.part("verdict", Verdict)
    style = f"verdict {STYLES[verdict.kind]}".strip()
    flows = [Text(capitalised(line) + ".") for line in content.other("flows", ())]
    return [Text(capitalised(verdict.line()), style), *flows, Text(ADVICE[verdict.kind])]


@section("How it was judged", needs=("judging",))
def judging(content: Content) -> list[Block]:
    """The method, and the limits."""
    return [Points(content.part("judging", tuple))]


def draw_signals(panels: Sequence[Axes], recording: Recording) -> dict[str, Axes]:
    """Draw position, pressures, and spool with command over time; returns the panel of each signal."""
    panel_of: dict[str, Axes] = {}
    for axes, (label, (size, names)) in zip(panels, PANELS.items(), strict=True):
        lines = {name: size * recording.signals[MEASURED.index(name)] for name in names}
        draw_lines(axes, recording.time, lines, label)
        panel_of |= dict.fromkeys(names, axes)
    return panel_of


def size_of(signal: str) -> float:
    """Displayed units per SI unit of a signal in the figure."""
    return next(size for size, names in PANELS.values() if signal in names)


def draw_lines(axes: Axes, time: Floats, lines: Mapping[str, Floats], label: str) -> None:
    """Draw lines over time in one panel, with a legend for more than one."""
    for (name, values), look in zip(lines.items(), _LOOKS, strict=False):
        axes.plot(*with_gaps(*thinned(time, values)), label=name.replace("_", " "), linewidth=1.0, **look.stroke)
    axes.set_ylabel(label)
    axes.margins(x=0.01)  # room for short labels
    if len(lines) > 1:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, fontsize=8)


_LOOKS: list[Look] = list(looks_of(range(2)).values())
