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
from pydantic_core import to_jsonable_python

from hydro_agents.report.canvas import GREY, WIDE, make_plot, thinned
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.palette import COLOURS
from hydro_agents.report.recorded import findings_frame
from hydro_agents.report.sections import Block, Text, render_page, section
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, listed, number
from hydro_env import ConfigurationError, __version__
from hydro_env.files import read_yaml, write_text
from hydro_env.folders import page
from hydro_env.task.sensors import POSITION, SENSORS
from hydro_env.types import Floats
from hydro_rig.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, GAINS, LATENCY, LEAKAGE, RISE_TIME
from hydro_rig.identification.found_rig import path_of, rig_yaml, share_in_words
from hydro_rig.identification.held_back import HeldBack, sizes_of
from hydro_rig.identification.identify import Identification
from hydro_rig.identification.intervals import hull

PAGE_FILE, RIG_FILE, RESULT_FILE = "identification.html", "rig.yaml", "identification.json"
FILES = (PAGE_FILE, RIG_FILE, RESULT_FILE, FIGURE_FILES)
JOB = "identify"

IDENTIFICATION = ("identified", "held_back", "unknowns", "recording")
"""Sections of the page, in order."""

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
        first, *others = (recording.source for recording in found.recordings)
        more = f" and {len(others)} more" if others else ""
        raise ConfigurationError(f"{first}{more}: {found.verdict()}; see {folder / PAGE_FILE}")
    findings = [finding.line() for finding in found.findings]
    names = ", ".join(one.name for one in found.undetermined)
    left = [f"Not determined: {names}"] if names else []
    return [*findings, *found.noted, *left, str(folder / PAGE_FILE), str(folder / RIG_FILE), found.verdict()]


def as_json(found: Identification, command: str) -> Any:
    """The result for programs; SI units, leaks in l/min at 100 bar; ``None`` if there is no number."""
    fit, sources = found.fit, [recording.source for recording in found.recordings]

    def by_sensor(values: Floats, what: str = "") -> dict[str, float]:
        return {f"{name}{what}": value for name, value in zip(SENSORS, values.tolist(), strict=True)}

    unknowns = {}
    for one in fit.unknowns:
        unknowns[one.name] = {
            "value": one.value,
            "low": one.low,
            "high": one.high,
            "unit": "l/min at 100 bar" if one.name in (LEAKAGE, EXTERNAL_LEAKAGE) else "SI",
            "remaining": one.remaining,
            "determined": fit.knows(one),
            "known_ends": {0: "both", 1: "low", -1: "high"}[one.side],
            "widening": one.widening,
        }
    parts = [
        {
            "recording": sources[part.recording],
            "from_s": part.begin,
            "to_s": part.begin + float(part.time[-1]),
            "share_of_variance": by_sensor(part.share),
            **by_sensor(part.error, "_rms"),
            "speed_rms": part.speed_error,
            **dict(zip(("speed_out", "speed_in"), part.speed_ratios, strict=True)),
        }
        for part in found.held_back
    ]
    forecasts = [
        {"over_s": over, "speed_rms": forecast.speed_error}
        | by_sensor(forecast.share, "_share_of_variance")
        | by_sensor(forecast.error, "_rms")
        for over, forecast in found.tested.items()
    ]
    whole = {
        "command": command,
        "hydro_env": __version__,
        "recordings": sources,
        "rig": found.rig.source,
        "describes": found.describes,
        "verdict": found.verdict(),
        "share_of_variance": by_sensor(found.tested[math.inf].share),
        "forecasts": forecasts,
        "held_back": {"why": found.parts.reason, "parts": parts},
        "windows": len(fit.misfit),
        "windows_explained": int(fit.explained.sum()),
        "another_minimum": fit.second,
        "unknowns": unknowns,
        "findings": [finding.line() for finding in found.findings],
        "notes": found.noted,
    }
    return to_jsonable_python(whole, inf_nan_mode="null", fallback=lambda value: value.tolist())


def render_identification(found: Identification, origin: Origin) -> Page:
    """The page."""
    windows = found.parts.fitted
    facts = {
        "Recordings": listed([recording.source for recording in found.recordings]),
        "Fitted to": f"{len(windows)} windows, of recordings: {len(np.unique(found.parts.recording))}",
        "Explained": f"{int(found.fit.explained.sum())} windows to within the sensors' noise",
        "Held back": "; ".join(place_of_part(found, part) for part in found.held_back) or "nothing",
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
    following = Markup(
        "<code>rig.yaml</code> beside this page holds the identified rig. Continue with "
        "<code>hydro check-rig --rig rig.yaml</code> and <code>hydro study --rig rig.yaml</code>."
    )
    if not found.describes:
        following = Markup(
            "No rig was written. Check wiring, units and signs of the recording, and the values in the rig file that "
            "have no range."
        )
    style = "worse" if not found.describes else "doubtful" if found.unexplained else "good"
    return [Text(capitalised(found.verdict()), f"verdict {style}"), Text(following), *map(Text, found.noted)]


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
        "The table also begins every 2 s at the measured state: of an axis that a controller held in place, only "
        "this says whether the model is right."
    )
    return [Text(note), plot, forecasts_table(found)]


@section("Identified values", needs=("identification",))
def unknowns(content: Content) -> list[Block]:
    """Each unknown: its range before, its value, its interval, and whether it is determined."""
    found = content.part("identification", Identification)
    note = (
        "An unknown is determined if its uncertainty is at most half of that of its range. The ranges come from the "
        "rig file and from the sensors' data sheets. What to record for the others: the table of motions in "
        f"{page('identify.md')}."
    )
    rows = []
    for one in found.fit.unknowns:
        look, before = found.look(one.name), range_before(found, one.name)
        span = look.span(*before) if before is not None else "–"
        value, interval = look.value(one.value, one.high - one.low), look.interval(one.low, one.high, one.side)
        rows.append((look.words, look.unit, span, value, interval, "yes" if found.fit.knows(one) else "no"))
    header = ("Unknown", "Unit", "Range before", "Found", "95 % interval", "Determined")
    return [Text(note), Table("", header, rows, style="words", folded=False)]


def range_before(found: Identification, name: str) -> tuple[float, float] | None:
    """Range of an unknown before the recording, in its unit; ``None``: it has none of its own (leaks, timing)."""
    if name in (LEAKAGE, EXTERNAL_LEAKAGE, LATENCY, RISE_TIME, *GAINS):
        return None
    if name in BIASES:
        bias = getattr(found.config.sensors, name.removesuffix("_bias")).bias
        return -bias, bias
    path = path_of(name)
    return hull(found.config.plant, found.plant, path, found.rig.randomisation[path])


# Errors --------------------------------------------------------------------------------------------------------------


def forecasts_table(found: Identification) -> Table:
    """Errors and shares of variance over times from a measured state, and over the whole parts."""
    rows = []
    for over, forecast in found.tested.items():
        shares = ["–" if math.isnan(share) else share_in_words(share) for share in forecast.share.tolist()]
        name = f"{over:g} s" if math.isfinite(over) else "the whole part"
        rows.append((name, *(number(size, digits=2) for size in sizes_of(forecast)), *shares))
    shares = [f"Share: {word}" for word in ("position", "pressure a", "pressure b", "spool")]
    caption = "How the error grows: root mean square error, and share of the variance explained"
    errors = ("Position, mm", "Speed, mm/s", "Pressure a, bar", "Pressure b, bar")
    return Table(caption, ("Simulated for", *errors, *shares), rows, style="words")


def place_of_part(found: Identification, part: HeldBack) -> str:
    """Recording and time of a held-back part."""
    name = f"{Path(found.recordings[part.recording].source).name}, " if len(found.recordings) > 1 else ""
    return f"{name}{part.begin:g} to {part.begin + float(part.time[-1]):.4g} s"


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
