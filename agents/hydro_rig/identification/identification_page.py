"""The page of an identification, and the files beside it: rig and numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from hydro_agents.report.canvas import GREY, WIDE, make_plot, row_axis, thinned
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.palette import COLOURS
from hydro_agents.report.recorded import findings_frame
from hydro_agents.report.sections import Block, Text, render_page, section
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import capitalised, listed, number
from hydro_env import ConfigurationError, __version__
from hydro_env.files import read_yaml, write_text
from hydro_env.folders import page
from hydro_env.task.sensors import POSITION
from hydro_rig.identification.found_rig import rig_yaml, shown
from hydro_rig.identification.held_back import HeldBack
from hydro_rig.identification.identification_tables import (
    as_json,
    combinations_table,
    errors_table,
    forecasts_table,
    open_table,
    place_of_part,
    repeats_table,
    unknowns_table,
)
from hydro_rig.identification.identify import Identification
from hydro_rig.identification.repeatability import share_inside

PAGE_FILE, RIG_FILE, RESULT_FILE = "identification.html", "rig.yaml", "identification.json"
FILES = (PAGE_FILE, RIG_FILE, RESULT_FILE, FIGURE_FILES)
JOB = "identify"

IDENTIFICATION = (
    "identified",
    "held_back",
    "unknowns",
    "repeatability",
    "undetermined",
    "recording",
)  # sections of the page, in order
SOURCES = Markup(
    "All numbers: <code>identification.json</code> beside this page. How it works: <code>{}</code>."
).format(page("identify.md"))

PANELS = (("position, mm", 1e3), ("pressure a, bar", 1e-5), ("pressure b, bar", 1e-5), ("spool, %", 100.0))
"""Label and factor from SI of each channel."""


def identify_to_folder(folder: Path, found: Identification, overwrite: bool, command: str) -> list[str]:
    """Write page, numbers and, if the model describes the axis, the rig; returns the lines for the user.

    Raises:
        ConfigurationError: the folder cannot be written, or the model does not describe the axis; in this case page and
            numbers are written, but no rig.
    """
    with output_folder(folder, JOB, FILES, overwrite=overwrite):
        write_text(folder / RESULT_FILE, json.dumps(as_json(found, command), indent=1, allow_nan=False) + "\n")
        render_identification(found, Origin.now(command)).write(folder / PAGE_FILE)
        if found.describes:
            notes = [
                f"Found by: {command}",
                f"hydro_env {__version__}; {found.verdict()}.",
                "Ranges: 95 % intervals; an undetermined parameter keeps its range, or the part beyond its known end.",
            ]
            text = rig_yaml(read_yaml(found.rig.source), found.fit, found.config, found.rig.randomisation, notes)
            write_text(folder / RIG_FILE, text)
    if not found.describes:
        raise ConfigurationError(f"{found.source}: {found.verdict()}; see {folder / PAGE_FILE}")
    findings = [finding.line() for finding in found.findings]
    names = ", ".join(one.name for one in found.undetermined)
    left = [f"Not determined: {names}"] if names else []
    return [*findings, *found.noted, *left, str(folder / PAGE_FILE), str(folder / RIG_FILE), found.verdict()]


def render_identification(found: Identification, origin: Origin) -> Page:
    """The page."""
    parts, windows = found.parts, found.parts.fitted
    length = float(round(windows.end[0] - windows.begin[0], 6))
    used = [found.recordings[number].source for number in dict.fromkeys(parts.recording.tolist())]
    rows = sum(len(recording.time) for recording in found.recordings)
    duration = sum(float(recording.time[-1]) for recording in found.recordings)
    facts = {
        "Recordings": listed([recording.source for recording in found.recordings]),
        "Duration": f"{number(duration, 2)} s, {rows} rows",
        "Rig file": found.rig.source,
        "Fitted to": f"{len(windows)} windows of {length:g} s"
        + (f" of {len(used)} recordings" if len(used) > 1 else ""),
        "Explained": f"{int(found.fit.explained.sum())} windows to within the sensors' noise",
        "Left out": f"{int(np.isinf(found.fit.misfit).sum())} windows, which the model fits far worse than the others",
        "Held back": "; ".join(place_of_part(found, part) for part in found.held_back) or "nothing",
        "Standard deviations": f"widened by {found.fit.widening.min():.3g} to {found.fit.widening.max():.3g}",
    }
    tables = {
        "protocol": pd.DataFrame(facts.items(), columns=["key", "value"]),
        "findings": findings_frame(found.findings),
    }
    content = Content(tables, found.config, {"identification": found})
    return render_page("Identification of the axis", IDENTIFICATION, content, origin, SOURCES)


@section("", needs=("identification",))
def identified(content: Content) -> list[Block]:
    """The verdict, what to do next, and notes."""
    found = content.part("identification", Identification)
    verdict = found.verdict()
    following = Markup(
        "<code>rig.yaml</code> beside this page holds the identified rig. Continue with "
        "<code>hydro check-rig --rig rig.yaml</code> and <code>hydro study --rig rig.yaml</code>."
    )
    if not found.describes:
        following = Markup(
            "No rig was written. Check wiring, units and signs of the recording, and the values in the rig file that "
            "have no range."
        )
    style = f"verdict {('doubtful' if found.unexplained else 'good') if found.describes else 'worse'}"
    return [Text(capitalised(verdict), style), Text(following), *map(Text, found.noted)]


@section("Measured and simulated", needs=("identification",))
def held_back(content: Content) -> list[Block]:
    """The parts that the fit did not use."""
    found = content.part("identification", Identification)
    if not found.held_back:
        return [Text("The recording is too short: nothing was held back.")]
    worst = max(found.held_back, key=lambda part: np.nan_to_num(part.error[POSITION]))
    plot = make_plot(
        "held_back",
        "The held-back part",
        "Grey: measured; blue: simulated. The second panel shows their difference in position.",
        f"Held-back part, measured and simulated. {found.verdict()}",
        lambda figure: paint_held_back(figure, worst),
        7.5,
        WIDE,
    )
    which = "The part" if len(found.held_back) == 1 else "The part with the largest error"
    note = (
        f"The fit did not use these parts: {found.parts.reason}. The simulation gets the state at the start of a part "
        f"and the recorded commands, and then runs freely: its errors add up. {which}: {place_of_part(found, worst)}. "
        "The last table also begins every 2 s at the measured state: of an axis that a controller held in place, only "
        "this says whether the model is right."
    )
    return [Text(note), plot, errors_table(found), forecasts_table(found)]


@section("Identified values", needs=("identification",))
def unknowns(content: Content) -> list[Block]:
    """Each unknown with its interval."""
    found = content.part("identification", Identification)
    plot = make_plot(
        "intervals",
        "Intervals beside their ranges",
        "Dots with 95 % intervals, each relative to its earlier range; the shade is that range.",
        "Ranges of the rig file and identified intervals; the table holds the numbers.",
        lambda figure: paint_intervals(figure, found),
        1.0 + 0.27 * len(found.fit.names),
        WIDE,
    )
    note = (
        "An unknown is determined if its uncertainty is at most half of that of its range. The ranges come from the "
        "rig file and from the sensors' data sheets."
    )
    return [Text(note), unknowns_table(found), plot]


@section("Repeatability", needs=("identification",))
def repeatability(content: Content) -> list[Block]:
    """What each recording says by itself about each unknown; nothing for a single recording."""
    found = content.part("identification", Identification)
    if not found.repeats:
        return []
    inside = share_inside(found.repeats)
    note = (
        "Each recording by itself: one step of the fit from the common values with its own windows and the ranges of "
        "the rig file. Values count where the recording alone determines them."
    )
    if not math.isnan(inside):
        note += f" {100 * inside:.0f} % of their 95 % intervals hold the common value."
    return [Text(note), repeats_table(found)]


@section("What this recording cannot determine", needs=("identification",))
def undetermined(content: Content) -> list[Block]:
    """Undetermined unknowns, motions that would help, and combinations that compensate each other."""
    found = content.part("identification", Identification)
    left = open_table(found)
    note = (
        "“Uncertainty left” is the standard deviation as a share of that of the range. The motions were simulated on "
        "the identified rig, from rest."
    )
    combined = (
        "Some unknowns compensate each other: only their combination is visible. The singular values of the scaled "
        "derivatives show how well each combination is determined; below 1 the range gives more information than the "
        "recording. The least determined combinations:"
    )
    first = [Text("Every unknown is determined.")] if left is None else [Text(note), left]
    return [*first, Text(combined), combinations_table(found)]


# Figures ------------------------------------------------------------------------------------------------------------


def paint_held_back(figure: Figure, part: HeldBack) -> None:
    """Draw the held-back part: each recorded channel, measured and simulated, and the difference in position."""
    shown_rows = [row for row in range(len(PANELS)) if np.isfinite(part.measured[row]).any()]
    axes = figure.subplots(len(shown_rows) + 1, 1, sharex=True, squeeze=False)[:, 0]
    time = part.begin + part.time
    places = [0, *range(2, len(shown_rows) + 1)]
    for place, row in zip(places, shown_rows, strict=True):
        label, factor = PANELS[row]
        axis = axes[place]
        axis.plot(*thinned(time, factor * part.measured[row]), color=GREY, linewidth=2.4, label="measured", alpha=0.6)
        axis.plot(*thinned(time, factor * part.simulated[row]), color=COLOURS["blue"], linewidth=1.1, label="simulated")
        axis.set_ylabel(label)
    error = 1e3 * (part.simulated[0] - part.measured[0])
    axes[1].plot(*thinned(time, error), color=COLOURS["orange"], linewidth=0.9)
    axes[1].set_ylabel("simulated −\nmeasured, mm")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    axes[-1].set_xlabel("time, s")


def paint_intervals(figure: Figure, found: Identification) -> None:
    """Draw each unknown's 95 % interval, in standard deviations of its range; 0 is the middle of the range."""
    fit, axis = found.fit, figure.subplots()
    axis.axvspan(-1.7, 1.7, color=GREY, alpha=0.12, linewidth=0)
    rows = [[one.prior.scaled(value) for value in (one.value, one.low, one.high)] for one in fit.unknowns]
    middle, low, high = np.array(rows).T
    determined, places = np.array([fit.knows(one) for one in fit.unknowns]), np.arange(len(rows))
    for known, colour, label in ((True, COLOURS["blue"], "determined"), (False, COLOURS["orange"], "not determined")):
        chosen = determined == known
        if chosen.any():
            reach = np.maximum(np.array([middle - low, high - middle])[:, chosen], 0.0)
            axis.errorbar(middle[chosen], places[chosen], xerr=reach, fmt="o", color=colour, label=label)
    row_axis(axis, [shown(name, found.config.plant).words for name in fit.names])
    end = max(2.6, float(np.nanmax(np.abs([low, high]))) * 1.05)
    axis.set_xlim(-end, end)
    axis.set_xlabel("in standard deviations of the earlier range; shaded: about that range")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
