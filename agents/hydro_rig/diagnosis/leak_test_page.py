"""The page of a leak test that was run, and its numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.report.canvas import GREY, WIDE, Plot, make_plot, thinned
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.palette import COLOURS, looks_of
from hydro_agents.report.sections import Block, Points, Text, render_page, section
from hydro_agents.report.shared import findings_frame
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, number
from hydro_env.files import write_text
from hydro_rig.diagnosis.diagnosis_page import ADVICE, STYLES, rig_line
from hydro_rig.diagnosis.leak_test_plan import FIND
from hydro_rig.diagnosis.leak_test_reading import WINDOW, LeakTest, Quantity
from hydro_rig.diagnosis.verdict import EXIT_CODES, Leak
from hydro_rig.estimation.estimator import WEAR, healthy_range
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.common_fit import WELL_FITTED

JOB = "leak-test"
READING_PAGE, NUMBERS_FILE = "leak_test.html", "leak_test.json"
READING_FILES = (READING_PAGE, NUMBERS_FILE, FIGURE_FILES)
READING_SECTIONS = ("tested", "reading_quantities", "reading_course", "recording", "reading_judging")

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
    lines = [finding.line() for finding in test.findings]
    return [*lines, *flow_lines(test), str(folder / READING_PAGE), test.verdict.line()]


def flow_lines(test: LeakTest) -> list[str]:
    """The leak of the seal beside the flow through the edges, in sentences."""
    if test.seal is None or test.edges is None or test.both is None:
        return []
    edges = f"through the edges of the closed valve {_interval(test.edges)} l/min"
    if test.apart:
        bound = number(test.seal.bound, digits=2)
        return [f"past the seal {_interval(test.seal)} l/min at 100 bar (bound ±{bound}); {edges}"]
    return [
        f"seal and edges cannot be told apart: together {_interval(test.both)} l/min; past the seal "
        f"{_interval(test.seal)}, {edges}"
    ]


def _interval(quantity: Quantity) -> str:
    return quantity.leak.text().removesuffix(" l/min at 100 bar")


def reading_facts(test: LeakTest) -> dict[str, Any]:
    """The result as numbers, for ``--json``: leaks in l/min at 100 bar, others in SI."""

    def facts(quantity: Quantity | None) -> dict[str, float] | None:
        if quantity is None:
            return None
        leak: Leak = quantity.leak
        return {"value": leak.value, "low": leak.low, "high": leak.high, "bound": quantity.bound}

    return {
        "verdict": test.verdict.kind.value,
        "line": test.verdict.line(),
        "exit_code": EXIT_CODES[test.verdict.kind],
        "seal_lpm": facts(test.seal),
        "edges_lpm": facts(test.edges),
        "both_lpm": facts(test.both),
        "apart": None if test.seal is None else test.apart,
        "unknowns": {name: facts(quantity) for name, quantity in test.quantities.items()},
        "windows": len(test.windows),
        "explained": 0 if test.common is None else test.common.explained,
        "findings": [finding.line() for finding in test.findings],
    }


def render_reading(test: LeakTest, origin: Origin) -> Page:
    """The page of a reading."""
    explained = 0 if test.common is None else test.common.explained
    facts = {
        "Recording": test.recording.source,
        "Rig assumed": rig_line(test.task.plant),
        "Duration": f"{number(float(test.recording.time[-1]), 2)} s, {len(test.recording.time)} rows",
        "Windows": f"{len(test.windows)} of {WINDOW:g} s, {explained} explained by the model",
    }
    tables = {
        "protocol": pd.DataFrame(facts.items(), columns=["key", "value"]),
        "findings": findings_frame(test.findings),
    }
    content = Content(tables, test.task, others={"leak_test": test})
    sources = Markup("Numbers: <code>leak_test.json</code> beside this page.")
    return render_page("Leak test of the axis", READING_SECTIONS, content, origin, sources)


@section("", needs=("leak_test",))
def tested(content: Content) -> list[Block]:
    """The verdict, and what to do next."""
    test = content.part("leak_test", LeakTest)
    style = f"verdict {STYLES[test.verdict.kind]}".strip()
    lines = [Text(capitalised(line) + ".") for line in flow_lines(test)]
    return [Text(capitalised(test.verdict.line()), style), *lines, Text(ADVICE[test.verdict.kind])]


@section("What the test found", needs=("leak_test",))
def reading_quantities(content: Content) -> list[Block]:
    """Leak and wear with their intervals and bounds."""
    test = content.part("leak_test", LeakTest)
    if test.seal is None or test.edges is None or test.both is None:
        return []
    rows = [
        _row("Past the piston seal, at 100 bar", "l/min", 1.0, test.seal, f"to {test.limits.healthy:g}"),
        _row("Through the edges of the closed valve", "l/min", 1.0, test.edges, ""),
        _row("Sum of the two", "l/min", 1.0, test.both, ""),
    ]
    for name, quantity in test.quantities.items():
        if name in WEAR and name != LEAKAGE:
            wear = WEAR[name]
            low, high = (number(wear.factor * end, digits=3) for end in healthy_range(test.task, name))
            rows.append(_row(capitalised(wear.what), wear.unit, wear.factor, quantity, f"{low} to {high}"))
    rows += [
        _row("Edges of chamber b over those of chamber a", "", 1.0, quantity, "")
        for name, quantity in test.quantities.items()
        if name == "valve.edge_ratio"
    ]
    share = test.seal.value / (FIND * test.seal.deviation)
    present = "A leak past the seal is present" if share > 1.0 else "A leak past the seal is not shown"
    note = (
        f"{present}: at 1 % false alarms the test shows {number(FIND * test.seal.deviation, digits=2)} l/min and more."
    )
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
    if test.common is None:
        return []
    return [_reading_plot(test)]


def _reading_plot(test: LeakTest) -> Plot:
    note = (
        "Lines: the recording. Dots: the fitted model, in windows that share all unknowns but their start. Shaded: "
        "windows that the model does not explain within the noise."
    )
    alt = f"Opening, position and pressures, measured and simulated. {test.verdict.line()}"
    return make_plot("leak_test", "The recording", note, alt, lambda figure: paint_reading(figure, test), 7.5, WIDE)


def paint_reading(figure: Figure, test: LeakTest) -> None:
    """Draw command, position and pressures, and the fitted model over them."""
    assert test.common is not None
    axes = figure.subplots(3, 1, sharex=True)
    recording, windows, simulated = test.recording, test.windows, test.simulated()
    looks = list(looks_of(range(2)).values())
    axes[0].plot(*thinned(recording.time, 100 * recording.signals[-1]), color=COLOURS[1], linewidth=1.2)
    axes[0].set_ylabel("command, %")
    used = np.flatnonzero(np.isfinite(test.common.misfit))
    explained = test.common.misfit < WELL_FITTED
    panels = (
        (axes[1], "position, mm", [(0, 1e3, "position")]),
        (axes[2], "pressure, bar", [(1, 1e-5, "a (bore)"), (2, 1e-5, "b (rod)")]),
    )
    for axis, label, channels in panels:
        for (channel, size, name), look in zip(channels, looks, strict=False):
            axis.plot(
                *thinned(recording.time, size * recording.signals[channel]), label=name, linewidth=1.0, **look.stroke
            )
            for row, window in enumerate(used):
                count = simulated.shape[2]
                time = windows.begin[window] + (windows.end[window] - windows.begin[window]) * np.arange(count) / count
                chosen = slice(max(count // 32, 1), None, max(count // 16, 1))
                axis.plot(time[chosen], size * simulated[row, channel, chosen], ".", color=GREY, markersize=3)
        axis.set_ylabel(label)
        for window in np.flatnonzero(~explained):
            axis.axvspan(windows.begin[window], windows.end[window], color=GREY, alpha=0.15, linewidth=0)
    axes[2].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, fontsize=8)
    axes[-1].set_xlabel("time, s")
    for axis in axes:
        axis.margins(x=0.01)


@section("How it was judged", needs=("leak_test",))
def reading_judging(content: Content) -> list[Block]:
    """The method."""
    del content
    return [Points(JUDGING)]
