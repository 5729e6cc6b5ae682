"""The page of an identification, and the files beside it: rig and numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from hydro_agents.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, LEAKAGE
from hydro_agents.report.canvas import GREY, WIDE, make_plot, row_axis, thinned
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.palette import COLOURS
from hydro_agents.report.sections import Block, Text, render_page, section
from hydro_agents.report.shared import findings_frame
from hydro_agents.rigs.found_rig import hull, path_of, rig_yaml, share_in_words, shown
from hydro_agents.rigs.identify import Identification, as_json
from hydro_agents.rigs.parts import HeldBack
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, listed, number, setting
from hydro_env import ConfigurationError, __version__
from hydro_env.files import read_yaml, write_text
from hydro_env.task.sensors import SENSORS

PAGE_FILE, RIG_FILE, RESULT_FILE = "identification.html", "rig.yaml", "identification.json"
FILES = (PAGE_FILE, RIG_FILE, RESULT_FILE, FIGURE_FILES)
JOB = "identify"

IDENTIFICATION = ("identified", "held_back", "unknowns", "undetermined", "recording")  # sections of the page, in order
SOURCES = Markup(
    "All numbers: <code>identification.json</code> beside this page. How it works: <code>docs/identify.md</code>."
)

MOST_COMBINATIONS = 6  # rows of the table of singular values, the least determined first
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
                "Ranges: 95 % intervals; an undetermined parameter keeps its range.",
            ]
            text = rig_yaml(read_yaml(found.rig.source), found.fit, found.config, found.rig.randomisation, notes)
            write_text(folder / RIG_FILE, text)
    if not found.describes:
        raise ConfigurationError(f"{found.recording.source}: {found.verdict()}; see {folder / PAGE_FILE}")
    findings = [finding.line() for finding in [*found.checked.findings, *found.parts.findings]]
    open_ones = [name for name, known in zip(found.fit.names, found.fit.determined, strict=True) if not known]
    lines = [*findings, *found.noted]
    if open_ones:
        lines.append(f"Not determined: {', '.join(open_ones)}")
    return [*lines, str(folder / PAGE_FILE), str(folder / RIG_FILE), found.verdict()]


def render_identification(found: Identification, origin: Origin) -> Page:
    """The page."""
    recording, parts = found.recording, found.parts
    length = float(round(parts.fitted.end[0] - parts.fitted.begin[0], 6))
    facts = {
        "Recording": recording.source,
        "Duration": f"{number(float(recording.time[-1]), 2)} s, {len(recording.time)} rows",
        "Rig file": found.rig.source,
        "Fitted to": f"{len(parts.fitted.begin)} windows of {length:g} s, up to {parts.fitted.end[-1]:g} s",
        "Explained": f"{int(found.fit.explained.sum())} windows to within the sensors' noise",
        "Held back": f"{parts.begin:g} to {parts.begin + float(found.held_back.time[-1]):.4g} s",
        "Standard deviations": f"widened by {found.fit.widening:.3g}",
    }
    tables = {
        "protocol": pd.DataFrame(facts.items(), columns=["key", "value"]),
        "findings": findings_frame([*found.checked.findings, *parts.findings]),
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
    style = "verdict good" if found.describes else "verdict worse"
    return [Text(capitalised(verdict), style), Text(following), *map(Text, found.noted)]


@section("Measured and simulated", needs=("identification",))
def held_back(content: Content) -> list[Block]:
    """The part that the fit did not use."""
    found = content.part("identification", Identification)
    plot = make_plot(
        "held_back",
        "The held-back part",
        "Grey: measured; blue: simulated. The second panel shows their difference in position.",
        f"Held-back part, measured and simulated. {found.verdict()}",
        lambda figure: paint_held_back(figure, found.held_back),
        7.5,
        WIDE,
    )
    note = (
        f"The fit did not use the part from {setting(found.parts.begin)} s on. The simulation gets the state at its "
        "start and the recorded commands, and then runs freely: its errors add up."
    )
    return [Text(note), plot, shares_table(found)]


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


# Tables -------------------------------------------------------------------------------------------------------------


def unknowns_table(found: Identification) -> Table:
    """Each unknown: its range before, its value, its interval, and whether it is determined."""
    rows = []
    fit, plant = found.fit, found.config.plant
    for name, value, low, high, known in zip(fit.names, fit.values, fit.low, fit.high, fit.determined, strict=True):
        look, before = shown(name, plant), range_before(found, name)
        width = look.value(float(value), float(high - low)), look.span(float(low), float(high))
        span = look.span(*before) if before is not None else "–"
        rows.append((look.words, look.unit, span, *width, "yes" if known else "no"))
    header = ("Unknown", "Unit", "Range before", "Found", "95 % interval", "Determined")
    return Table("", header, rows, style="words", folded=False)


def range_before(found: Identification, name: str) -> tuple[float, float] | None:
    """Range of an unknown before the recording, in its unit; ``None`` for leaks, whose resistance has the range."""
    if name in (LEAKAGE, EXTERNAL_LEAKAGE):
        return None
    if name in BIASES:
        bias = getattr(found.config.sensors, name.removesuffix("_bias")).bias
        return -bias, bias
    path = path_of(name)
    return hull(found.config.plant, found.plant, path, found.rig.randomisation[path])


def open_table(found: Identification) -> Table | None:
    """The undetermined unknowns, each with a motion that would determine it; ``None`` if all are determined."""
    rows = []
    for name, advice in found.advice.items():
        before = f"{100 * found.fit.remaining[found.fit.names.index(name)]:.0f} %"
        words = shown(name, found.config.plant).words
        if advice is None:
            rows.append((words, before, "none of the candidates", "–"))
        else:
            left = f"{100 * advice.remaining:.0f} %"
            rows.append((words, before, advice.motion, left if advice.enough else f"{left}, not enough alone"))
    header = ("Unknown", "Uncertainty left", "Most informative motion", "Left after 8 s of it")
    return Table("", header, rows, style="words") if rows else None


def combinations_table(found: Identification) -> Table:
    """The least determined combinations of unknowns."""
    rows = []
    for one in found.combinations[:MOST_COMBINATIONS]:
        parts = [
            f"{number(weight, 2, signed=True)} × {shown(name, found.config.plant).words}" for name, weight in one.parts
        ]
        rows.append((number(one.singular_value, digits=3), listed(parts) if parts else "many, none of them large"))
    return Table("", ("Singular value", "Combination"), rows, style="words")


def shares_table(found: Identification) -> Table:
    """Share of the variance explained, by signal."""
    shares = zip(SENSORS, found.held_back.share.tolist(), strict=True)
    rows = [
        (name.replace("_", " "), "– (absent, or at rest)" if math.isnan(share) else share_in_words(share))
        for name, share in shares
    ]
    return Table("", ("Signal", "Share of variance explained"), rows)


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
        axis.plot(*thinned(time, factor * part.simulated[row]), color=COLOURS[0], linewidth=1.1, label="simulated")
        axis.set_ylabel(label)
    error = 1e3 * (part.simulated[0] - part.measured[0])
    axes[1].plot(*thinned(time, error), color=COLOURS[1], linewidth=0.9)
    axes[1].set_ylabel("simulated −\nmeasured, mm")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    axes[-1].set_xlabel("time, s")


def paint_intervals(figure: Figure, found: Identification) -> None:
    """Draw each unknown's 95 % interval, in standard deviations of its range; 0 is the middle of the range."""
    fit = found.fit
    axis = figure.subplots()
    names = [shown(name, found.config.plant).words for name in fit.names]
    low, middle, high = (_scaled(found, values) for values in (fit.low, fit.values, fit.high))
    places = np.arange(len(names))
    axis.axvspan(-1.7, 1.7, color=GREY, alpha=0.12, linewidth=0)
    for known, colour, label in ((True, COLOURS[0], "determined"), (False, COLOURS[1], "not determined")):
        rows = fit.determined == known
        if rows.any():
            reach = np.array([middle - low, high - middle])[:, rows]
            axis.errorbar(middle[rows], places[rows], xerr=np.maximum(reach, 0.0), fmt="o", color=colour, label=label)
    row_axis(axis, names)
    limit = max(2.6, float(np.nanmax(np.abs([low, high]))) * 1.05)
    end = min(limit, 6.0)
    axis.set_xlim(-end, end)
    for row in np.flatnonzero(np.abs(middle) > end):  # an arrow at the edge instead of a point beyond it
        side, colour = np.sign(middle[row]), COLOURS[0 if fit.determined[row] else 1]
        axis.plot(side * end, places[row], ">" if side > 0 else "<", color=colour, markersize=7.0, clip_on=False)
        words: dict[str, Any] = {"xytext": (-9.0 * side, 0), "textcoords": "offset points", "va": "center"}
        text = f"at {number(float(middle[row]))}"
        axis.annotate(text, (side * end, places[row]), ha="right" if side > 0 else "left", fontsize=8.0, **words)
    axis.set_xlabel("in standard deviations of the earlier range; shaded: about that range")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)


def _scaled(found: Identification, values: np.ndarray) -> np.ndarray:
    """Values in standard deviations of their priors."""
    scaled = []
    for name, value in zip(found.fit.names, values.tolist(), strict=True):
        prior = found.fit.priors[name]
        away = np.log(value / prior.mean) if prior.logarithmic else value - prior.mean
        scaled.append(float(away) / prior.deviation)
    return np.array(scaled)
