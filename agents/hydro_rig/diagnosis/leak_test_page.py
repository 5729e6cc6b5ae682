"""The page of a leak test that was run, and its numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.recorded import Line, Mark, Signal, course_plot, recording_tables
from hydro_agents.report.sections import Block, Text, render_page, section
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, number
from hydro_env.files import write_text
from hydro_env.task.sensors import SENSORS
from hydro_rig.diagnosis.diagnosis_page import signals_of
from hydro_rig.diagnosis.leak_test_plan import FIND
from hydro_rig.diagnosis.leak_test_reading import WINDOW, LeakFit, LeakTest, Quantity
from hydro_rig.diagnosis.verdict import EXIT_CODES
from hydro_rig.estimation.estimator import WEAR, healthy_range
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.common_fit import WELL_FITTED

JOB = "leak-test"
READING_PAGE, NUMBERS_FILE = "leak_test.html", "leak_test.json"
READING_FILES = (READING_PAGE, NUMBERS_FILE, FIGURE_FILES)
READING_SECTIONS = ("diagnosed", "reading_quantities", "reading_course", "recording", "judging")

JUDGING = (
    "At a stop all oil that enters a chamber leaks: past the seal, or past the edges of the valve. The flow past the "
    "seal changes its direction from one stop to the other; the flow past the edges depends on the opening.",
    f"The simulator is fitted to the whole recording, in windows of {WINDOW:g} s that share leak, plant, wear of the "
    "valve, return line and offsets of the sensors. Windows that contradict each other widen the intervals.",
    "The bound is the smallest standard deviation that any method can reach with these readings and unknowns "
    "(Cramér–Rao). The interval also counts the scatter between the windows.",
    "The flow past the edges is that of the centred valve with closed ports at the supply pressure of the rig.",
)


def reading_to_folder(folder: Path, test: LeakTest, overwrite: bool, command: str) -> list[str]:
    """Write page and numbers; returns the lines for the user, the verdict last."""
    with output_folder(folder, JOB, READING_FILES, overwrite=overwrite):
        write_text(folder / NUMBERS_FILE, json.dumps(reading_facts(test), indent=1) + "\n")
        render_reading(test, Origin.now(command)).write(folder / READING_PAGE)
    lines = [finding.line() for finding in test.checked.findings]
    return [*lines, *flow_lines(test), str(folder / READING_PAGE), test.verdict.line()]


def flow_lines(test: LeakTest) -> list[str]:
    """The leak of the seal beside the flow through the edges, in sentences."""
    if test.fit is None:
        return []
    seal, edges, both = (_interval(quantity) for quantity in (test.fit.seal, test.fit.edges, test.fit.both))
    edges = f"through the edges of the closed valve {edges} l/min"
    if test.fit.apart:
        bound = number(test.fit.seal.bound, digits=2)
        return [f"past the seal {seal} l/min at 100 bar (bound ±{bound}); {edges}"]
    return [f"seal and edges cannot be told apart: together {both} l/min; past the seal {seal}, {edges}"]


def _interval(quantity: Quantity) -> str:
    return quantity.leak.text().removesuffix(" l/min at 100 bar")


def reading_facts(test: LeakTest) -> dict[str, Any]:
    """The result as numbers, for ``--json``: leaks in l/min at 100 bar, others in SI."""

    def facts(quantity: Quantity) -> dict[str, float]:
        return {**quantity.leak._asdict(), "bound": quantity.bound}

    fit = test.fit
    return {
        "verdict": test.verdict.kind.value,
        "line": test.verdict.line(),
        "exit_code": EXIT_CODES[test.verdict.kind],
        "seal_lpm": fit and facts(fit.seal),
        "edges_lpm": fit and facts(fit.edges),
        "both_lpm": fit and facts(fit.both),
        "apart": fit and fit.apart,
        "unknowns": {name: facts(quantity) for name, quantity in fit.quantities.items()} if fit else {},
        "windows": len(test.windows),
        "explained": fit.common.explained if fit else 0,
        "findings": [finding.line() for finding in test.checked.findings],
    }


def render_reading(test: LeakTest, origin: Origin) -> Page:
    """The page of a reading."""
    explained = test.fit.common.explained if test.fit else 0
    windows = f"{len(test.windows)} of {WINDOW:g} s, {explained} explained by the model"
    recording = test.recording
    tables = recording_tables(recording.source, test.task.plant, recording.time, test.checked.findings, Windows=windows)
    parts = {"leak_test": test, "verdict": test.verdict, "judging": JUDGING, "flows": tuple(flow_lines(test))}
    content = Content(tables, test.task, others=parts)
    sources = Markup("Numbers: <code>leak_test.json</code> beside this page.")
    return render_page("Leak test of the axis", READING_SECTIONS, content, origin, sources)


@section("What the test found", needs=("leak_test",))
def reading_quantities(content: Content) -> list[Block]:
    """Leak and wear with their intervals and bounds."""
    test = content.part("leak_test", LeakTest)
    if test.fit is None:
        return []
    seal, quantities = test.fit.seal, test.fit.quantities
    rows = [
        _row("Past the piston seal, at 100 bar", "l/min", 1.0, seal, f"to {test.limits.healthy:g}"),
        _row("Through the edges of the closed valve", "l/min", 1.0, test.fit.edges, ""),
        _row("Sum of the two", "l/min", 1.0, test.fit.both, ""),
    ]
    for name, quantity in quantities.items():
        if name in WEAR and name != LEAKAGE:
            wear = WEAR[name]
            low, high = (number(wear.factor * end, digits=3) for end in healthy_range(test.task, name))
            rows.append(_row(capitalised(wear.what), wear.unit, wear.factor, quantity, f"{low} to {high}"))
    if "valve.edge_ratio" in quantities:
        rows.append(_row("Edges of chamber b over those of chamber a", "", 1.0, quantities["valve.edge_ratio"], ""))
    shown = number(FIND * seal.deviation, digits=2)
    note = f"At 1 % false alarms the test shows a leak past the seal from {shown} l/min on."
    header = ("", "Value", "90 % interval", "Bound (±)", "Healthy", "Unit")
    return [Table("", header, rows, folded=False), Text(note)]


def _row(what: str, unit: str, factor: float, quantity: Quantity, healthy: str) -> tuple[str, ...]:
    reach = factor * HALF_WIDTH * quantity.deviation
    value, decimals = factor * quantity.value, max(0, 1 - int(np.floor(np.log10(max(abs(reach), 1e-9)))))
    ends = " to ".join(number(end, decimals) for end in (value - reach, value + reach))
    return what, number(value, decimals), ends, number(abs(factor) * quantity.bound, digits=2), healthy, unit


@section("Measured and simulated", needs=("leak_test",))
def reading_course(content: Content) -> list[Block]:
    """The readings beside those of the fitted model."""
    test = content.part("leak_test", LeakTest)
    if test.fit is None:
        return []
    note = (
        "Bold: the recording. Thin: the fitted model, in windows that share all unknowns but their start. Shaded: "
        "windows that the model does not explain within the noise."
    )
    alt = f"Position, pressures and valve, measured and simulated. {test.verdict.line()}"
    return [course_plot("leak_test", "The recording", note, alt, fitted_signals(test, test.fit))]


def fitted_signals(test: LeakTest, fit: LeakFit) -> list[Signal]:
    """The measured signals, with those of the fitted model."""
    windows, misfit, simulated = test.windows, fit.common.misfit, fit.simulated()
    marks = [Mark(windows.begin[window], windows.end[window]) for window in np.flatnonzero(~(misfit < WELL_FITTED))]
    used, steps = np.flatnonzero(np.isfinite(misfit)), np.arange(simulated.shape[2]) / simulated.shape[2]
    times = windows.begin[used, None] + (windows.end - windows.begin)[used, None] * steps

    def fitted(name: str, size: float) -> list[Line]:
        values = size * simulated[:, SENSORS.index(name)]
        return [Line(time, row) for time, row in zip(times, values, strict=True)]

    position, pressures, valve = signals_of(test.recording)
    return [
        position._replace(simulated=fitted("position", 1e3), marks=marks),
        pressures._replace(simulated=[*fitted("pressure_a", 1e-5), *fitted("pressure_b", 1e-5)], marks=marks),
        valve._replace(marks=marks),
    ]
