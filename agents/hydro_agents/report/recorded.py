"""What all pages of a recording share: facts and findings of the recording, and its signals over time.

Comes in: a recording, its rig, and signals in the units of a reader. Goes out: the tables of the section
:func:`recording`, and one figure with a row per signal. Open :class:`Signal` first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydro_agents.report.canvas import GREY, INK, WIDE, Plot, make_plot, thinned, with_gaps
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look, looks_of
from hydro_agents.report.sections import Block, Text, section, words_table
from hydro_agents.running.text import Table, number
from hydro_env import PlantParameters
from hydro_env.types import Floats
from hydro_env.units import UNITS

# Facts --------------------------------------------------------------------------------------------------------------

MEANING = {
    "severe": "rules out a verdict",
    "fault": "a sensor is faulty",
    "doubt": "nothing is healthy, and no other fault is sure",
    "note": "does not matter much",
}
"""What the weight of a finding about a recording means."""


@section("The recording", needs=("protocol",))
def recording(content: Content) -> list[Block]:
    """What is wrong with a recording, and facts about it; from :func:`recording_tables`."""
    blocks: list[Block] = [Text("Nothing is wrong with time stamps, units, signs, chambers and sensors.")]
    if content.has("findings"):
        blocks = [
            Text("Checks before any verdict: time stamps, units, signs, chambers, and each sensor."),
            words_table(content.table("findings")),
        ]
    return [*blocks, Table("", ("Fact", "Value"), list(content.facts.items()), style="words")]


def recording_tables(
    source: str, plant: PlantParameters, time: Floats, findings: Iterable[Any], **more: str
) -> dict[str, pd.DataFrame]:
    """The tables of the section :func:`recording`.

    Args:
        source: file of the recording.
        plant: the rig that was assumed.
        time: of its rows, s.
        findings: about it (:class:`hydro_rig.recordings.findings.Finding`).
        more: further facts; an underscore stands for a space.
    """
    facts = {
        "Recording": source,
        "Rig assumed": rig_line(plant),
        "Duration": f"{number(float(time[-1]), 2)} s, {len(time)} rows",
    }
    facts |= {name.replace("_", " "): fact for name, fact in more.items()}
    return {
        "protocol": pd.DataFrame(facts.items(), columns=["key", "value"]),
        "findings": findings_frame(findings),
    }


def findings_frame(findings: Iterable[Any]) -> pd.DataFrame:
    """Findings about a recording (:class:`hydro_rig.recordings.findings.Finding`) as texts."""
    rows = [(each.signal, each.line().removeprefix(f"{each.signal} "), MEANING[each.weight]) for each in findings]
    return pd.DataFrame(rows, columns=["Signal", "Finding", "For the verdict"])


def rig_line(plant: PlantParameters) -> str:
    """The nameplate of a rig in one line, by which a person sees whether it is the recorded one."""
    cylinder, supply = plant.cylinder, plant.supply.pressure / UNITS["Pa"]["bar"]
    return (
        f"bore {1e3 * cylinder.bore_diameter:g} mm, rod {1e3 * cylinder.rod_diameter:g} mm, "
        f"stroke {1e3 * cylinder.stroke:g} mm, supply {supply:g} bar"
    )


# The figure ---------------------------------------------------------------------------------------------------------


class Line(NamedTuple):
    """Values over time, in the unit of their row."""

    time: Floats  # (T,), s; a line breaks where rows are missing
    values: Floats  # (T,)


class Mark(NamedTuple):
    """A shaded stretch of time."""

    begin: float  # s
    end: float  # s
    text: str = ""
    colour: str = GREY
    strength: float = 0.15  # opacity


class Signal(NamedTuple):
    """One row of the figure: lines that share a unit."""

    label: str  # what the row shows, with its unit: "pressure, bar"
    measured: Mapping[str, Line]  # by name
    simulated: Sequence[Line] = ()  # of the fitted model, drawn over the measured ones
    marks: Sequence[Mark] = ()


def course_plot(
    key: str,
    title: str,
    note: str,
    alt: str,
    signals: Sequence[Signal],
    height: float = 7.5,
    looks: Mapping[str, Look] | None = None,
) -> Plot:
    """A wide figure of signals over time, measured and simulated, one row per signal.

    Args:
        key: name of its file.
        title: of the figure.
        note: how to read it.
        alt: description for readers who cannot see it.
        signals: the rows, from top to bottom.
        height: inches.
        looks: of the measured lines; default: by their order in each row.
    """

    def paint(figure: Figure) -> None:
        paint_course(list(figure.subplots(len(signals), 1, sharex=True, squeeze=False)[:, 0]), signals, looks)

    return make_plot(key, title, note, alt, paint, height, WIDE)


def paint_course(panels: Iterable[Axes], signals: Sequence[Signal], looks: Mapping[str, Look] | None = None) -> None:
    """Draw each signal into its panel; a name stands in the legend if a row has several, or simulated lines."""
    for axes, signal in zip(panels, signals, strict=True):
        bold: dict[str, Any] = {"linewidth": 2.2, "alpha": 0.55} if signal.simulated else {"linewidth": 1.0}
        own = looks or looks_of(signal.measured)
        for name, line in signal.measured.items():
            axes.plot(*with_gaps(*thinned(*line)), label=name, **own[name].stroke, **bold)
        for number_of_line, line in enumerate(signal.simulated):
            label = "" if number_of_line else "simulated"
            axes.plot(*with_gaps(*thinned(*line)), color=INK, linewidth=0.8, label=label)
        for mark in signal.marks:
            _shade(axes, mark)
        axes.set_ylabel(signal.label)
        axes.margins(x=0.01)
        if len(signal.measured) > 1 or signal.simulated:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, frameon=False, fontsize=8)
    axes.set_xlabel("time, s")  # of the last panel


def _shade(axes: Axes, mark: Mark) -> None:
    """Shade a stretch of time, and write its text beside it."""
    axes.axvspan(mark.begin, mark.end, color=mark.colour, alpha=mark.strength, linewidth=0)
    if mark.text:
        first, last = axes.dataLim.intervalx
        late = mark.begin > first + 0.6 * (last - first)
        place, side = (mark.begin, "right") if late else (mark.end, "left")
        across = axes.get_xaxis_transform()
        axes.text(place, 0.97, mark.text, transform=across, ha=side, va="top", fontsize=8, color=INK)
