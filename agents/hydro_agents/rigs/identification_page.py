"""The page of an identification: one HTML file without external parts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_agents.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, LEAKAGE
from hydro_agents.report.canvas import WIDE, make_plot
from hydro_agents.report.page import Page, make_page
from hydro_agents.rigs.found_rig import hull, path_of
from hydro_agents.rigs.identification_pictures import paint_held_back, paint_intervals
from hydro_agents.rigs.identification_shown import share_in_words, shown
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, listed, number
from hydro_env.task.sensors import SENSORS

if TYPE_CHECKING:
    from hydro_agents.rigs.identify import Identification

HERE = Path(__file__).parent

MOST_COMBINATIONS = 6
"""Rows of the table of singular values, the least determined first."""


def write_page(path: Path, found: Identification, command: str) -> None:
    """Write the page, and its figures into a folder beside it."""
    render_page(found, Origin.now(command)).write(path)


def render_page(found: Identification, origin: Origin) -> Page:
    """The page."""
    verdict = found.verdict()
    signals = make_plot(
        "held_back",
        "The held-back part",
        "Grey: measured; blue: simulated. The second panel shows their difference in position.",
        f"Held-back part, measured and simulated. {verdict}",
        lambda figure: paint_held_back(figure, found.held_back),
        7.5,
        WIDE,
    )
    intervals = make_plot(
        "intervals",
        "Intervals beside their ranges",
        "Dots with 95 % intervals, each relative to its earlier range; the shade is that range.",
        "Ranges of the rig file and identified intervals; the table holds the numbers.",
        lambda figure: paint_intervals(figure, found),
        1.0 + 0.27 * len(found.fit.names),
        WIDE,
    )
    findings = [*found.checked.findings, *found.parts.findings]
    rows = [(f.signal, f.line().removeprefix(f"{f.signal} ")) for f in findings]
    recording, parts = found.recording, found.parts
    facts = [
        ("Recording", recording.source),
        ("Duration", f"{number(float(recording.time[-1]), 2)} s, {len(recording.time)} rows"),
        ("Rig file", found.rig.source),
        ("Fitted to", f"{len(parts.fitted.begin)} windows of {_length(found):g} s, up to {parts.fitted.end[-1]:g} s"),
        ("Explained", f"{int(found.fit.explained.sum())} windows to within the sensors' noise"),
        ("Held back", f"{parts.begin:g} to {parts.begin + float(found.held_back.time[-1]):.4g} s"),
        ("Standard deviations", f"widened by {found.fit.widening:.3g}"),
    ]
    return make_page(
        HERE / "identification.html.j2",
        origin,
        line=verdict[:1].upper() + verdict[1:],
        describes=found.describes,
        notes=found.noted,
        findings=Table("", ("Signal", "Finding"), rows) if rows else None,
        unknowns=unknowns_table(found),
        open=open_table(found),
        combinations=combinations_table(found),
        shares=shares_table(found),
        signals=signals,
        intervals=intervals,
        begin=parts.begin,
        facts=Table("", ("Fact", "Value"), facts),
    )


def _length(found: Identification) -> float:
    windows = found.parts.fitted
    return float(round(windows.end[0] - windows.begin[0], 6))


def unknowns_table(found: Identification) -> Table:
    """Each unknown: its range before, its value, its interval, and whether it is determined."""
    rows = []
    fit, plant = found.fit, found.config.plant
    for name, value, low, high, known in zip(fit.names, fit.values, fit.low, fit.high, fit.determined, strict=True):
        look = shown(name, plant)
        rows.append(
            (
                look.words,
                look.unit,
                look.span(*ends) if (ends := range_before(found, name)) is not None else "–",
                look.value(float(value), float(high - low)),
                look.span(float(low), float(high)),
                "yes" if known else "no",
            )
        )
    return Table("", ("Unknown", "Unit", "Range before", "Found", "95 % interval", "Determined"), rows)


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
    return Table("", header, rows) if rows else None


def combinations_table(found: Identification) -> Table:
    """The least determined combinations of unknowns."""
    rows = []
    for one in found.combinations[:MOST_COMBINATIONS]:
        parts = [
            f"{number(weight, 2, signed=True)} × {shown(name, found.config.plant).words}" for name, weight in one.parts
        ]
        rows.append((number(one.singular_value, digits=3), listed(parts) if parts else "many, none of them large"))
    return Table("", ("Singular value", "Combination"), rows)


def shares_table(found: Identification) -> Table:
    """Share of the variance explained, by signal."""
    rows = []
    for name, share in zip(SENSORS, found.held_back.share.tolist(), strict=True):
        rows.append((name.replace("_", " "), "– (absent, or at rest)" if math.isnan(share) else share_in_words(share)))
    return Table("", ("Signal", "Share of variance explained"), rows)
