"""The pages of a leak test: of its plan, for the person who runs it, and of its reading; and the files beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.detection.estimator import WEAR, healthy_range
from hydro_agents.estimation.unknowns import LEAKAGE
from hydro_agents.export.c_files import render as render_code
from hydro_agents.recordings.simulated import recording_csv
from hydro_agents.report.canvas import GREY, WIDE, Plot, make_plot, thinned
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.palette import COLOURS, looks_of
from hydro_agents.report.sections import Block, Points, Text, render_page, section
from hydro_agents.report.shared import findings_frame
from hydro_agents.rigs.common_fit import WELL_FITTED
from hydro_agents.rigs.diagnosis_page import ADVICE, STYLES, rig_line
from hydro_agents.rigs.leak_test import FIND, RAMP, Plan, speeds
from hydro_agents.rigs.leak_test_reading import WINDOW, LeakTest, Quantity
from hydro_agents.rigs.verdict import EXIT_CODES, Leak
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, number
from hydro_env import __version__
from hydro_env.files import write_text
from hydro_env.units import FULL_VOLTAGE

JOB = "leak-test"
PLAN_PAGE, COMMANDS_FILE, HEADER_FILE, TRIAL_FILE = "plan.html", "commands.csv", "leak_test.h", "simulated.csv"
PLAN_FILES = (PLAN_PAGE, COMMANDS_FILE, HEADER_FILE, TRIAL_FILE, FIGURE_FILES)
READING_PAGE, NUMBERS_FILE = "leak_test.html", "leak_test.json"
READING_FILES = (READING_PAGE, NUMBERS_FILE, FIGURE_FILES)

PLAN_SECTIONS = ("planned", "plan_course", "plan_steps", "plan_forms", "plan_running")
READING_SECTIONS = ("tested", "test_quantities", "test_course", "recording", "test_judging")

LIMIT_BEFORE = (
    "The limits hold on the simulated axes. Clear the whole stroke, keep the emergency stop at hand, and run the test "
    "first with half the openings: what stands in the way, and a wrong sign of the command, no simulation knows."
)
RUNNING = (
    Markup(
        "Bring the axis to the start, at rest, with the oil at its working temperature. Then play <code>commands.csv"
        "</code> (one row per control period) to the valve in open loop, or call <code>leak_test_opening(t)</code> of "
        "<code>leak_test.h</code> in every period."
    ),
    "Record position, both pressures, spool position and command in every control period, from a second before the "
    "first step to the end.",
    Markup("Read the recording with <code>hydro leak-test RECORDING --rig FILE</code>."),
    Markup(
        "<code>simulated.csv</code> is such a recording of one simulated axis with a leak of {} l/min: try the reading "
        "with it first."
    ),
)
JUDGING = (
    "At a stop all oil that enters a chamber leaks: past the seal, or past the edges of the valve. The flow past the "
    "seal changes its direction from one stop to the other; the flow past the edges depends on the opening.",
    f"The simulator is fitted to the whole recording, in windows of {WINDOW:g} s that share leak, plant, wear of the "
    "valve, return line and offsets of the sensors. Windows that contradict each other widen the intervals.",
    "The bound is the smallest standard deviation that any method can reach with these readings and unknowns "
    "(Cramér–Rao). The interval also counts the scatter between the windows.",
    "The flow past the edges is that of the centred valve with closed ports at the supply pressure of the rig.",
)


# The plan -----------------------------------------------------------------------------------------------------------


def plan_to_folder(folder: Path, plan: Plan, overwrite: bool, command: str) -> list[str]:
    """Write the page, the commands as CSV and C, and a simulated recording; returns lines for the user."""
    period, windows = plan.task.control_period, plan.best.windows
    with output_folder(folder, JOB, PLAN_FILES, overwrite=overwrite):
        write_text(folder / COMMANDS_FILE, commands_csv(plan))
        write_text(folder / HEADER_FILE, header_code(plan, command))
        time = period * np.arange(windows.signals.shape[2], dtype=np.float64)
        note = f"{command}: simulated axis, leak {plan.allowed.leak:g} l/min at 100 bar"
        write_text(folder / TRIAL_FILE, recording_csv(time, windows.signals[0], note))
        render_plan(plan, Origin.now(command)).write(folder / PLAN_PAGE)
    files = [str(folder / name) for name in (PLAN_PAGE, COMMANDS_FILE, HEADER_FILE, TRIAL_FILE)]
    return [*files, capitalised(plan_line(plan))]


def commands_csv(plan: Plan) -> str:
    """The openings, one row per control period, and the voltages of the valve."""
    openings = plan.commands
    table = pd.DataFrame(
        {
            "time [s]": np.round(plan.task.control_period * np.arange(len(openings)), 6),
            "opening [1]": openings,
            "voltage [V]": FULL_VOLTAGE * openings,
        }
    )
    text: str = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return text


def header_code(plan: Plan, command: str) -> str:
    """The steps as a header in C99."""
    values = {
        "version": __version__,
        "command": command.replace("*/", "* /"),
        "steps": plan.best.steps,
        "ramp": RAMP,
        "period": plan.task.control_period,
    }
    return render_code("leak_test.h.j2", values)


def plan_line(plan: Plan) -> str:
    """The plan in one sentence."""
    largest = max(abs(step.opening) for step in plan.best.steps)
    return (
        f"a test of {sum(step.seconds for step in plan.best.steps):.0f} s, the valve at most {100 * largest:.2g} % "
        f"open: {plan.best.form.name}; 90 % interval of the leak at the bound "
        f"±{number(HALF_WIDTH * plan.deviation, digits=2)} l/min at 100 bar"
    )


def plan_facts(plan: Plan) -> dict[str, Any]:
    """The plan as numbers, for ``--json``."""
    return {
        "steps": [{"opening": step.opening, "seconds": step.seconds, "what": step.what} for step in plan.best.steps],
        "form": plan.best.form.name,
        "bound_lpm": plan.best.mean_bound(),
        "largest_bound_lpm": plan.deviation,
        "smallest_leak_lpm": plan.smallest,
        "largest_speed": float(np.abs(speeds(plan.best.position, plan.task.control_period)).max()),
        "positions": [float(plan.best.position.min()), float(plan.best.position.max())],
        "largest_pressure": float(plan.best.pressures.max()),
    }


def render_plan(plan: Plan, origin: Origin) -> Page:
    """The page of a plan."""
    content = Content({}, plan.task, others={"plan": plan})
    sources = Markup("Numbers: <code>commands.csv</code> beside this page; <code>--json</code> prints the others.")
    return render_page("Plan of a leak test", PLAN_SECTIONS, content, origin, sources)


@section("", needs=("plan",))
def planned(content: Content) -> list[Block]:
    """The test in one sentence, the rig and its limits."""
    plan = content.part("plan", Plan)
    return [
        Text(capitalised(plan_line(plan)) + ".", "verdict"),
        Text(f"Rig: {rig_line(plan.task.plant)}.", "soft"),
        Text(_limits(plan)),
        Text(LIMIT_BEFORE, "caution"),
    ]


def _limits(plan: Plan) -> str:
    """What the simulated axes reach, and the limits."""
    limits, best = plan.allowed, plan.best
    fastest = 1e3 * np.abs(speeds(best.position, plan.task.control_period)).max()
    low, high = 1e3 * best.position.min(), 1e3 * best.position.max()
    ends = " to ".join("the stop" if np.isinf(end) else f"{1e3 * end:.0f} mm" for end in (limits.low, limits.high))
    allowed = "the whole stroke" if np.isinf([limits.low, limits.high]).all() else ends
    return (
        f"{len(best.position)} simulated axes with worn valves stay within the limits: up to {fastest:.0f} mm/s (limit "
        f"{1e3 * limits.speed:.0f}, also against a stop), {1e-5 * best.pressures.max():.0f} bar (limit "
        f"{1e-5 * limits.pressure:.0f}), from {low:.0f} to {high:.0f} mm (allowed: {allowed}). They start at "
        f"{1e3 * limits.start:.0f} mm."
    )


@section("What happens", needs=("plan",))
def plan_course(content: Content) -> list[Block]:
    """Commands, positions, pressures, and how the bound falls."""
    plan = content.part("plan", Plan)
    note = (
        f"Grey: {len(plan.best.position)} simulated axes, with worn valves and a leak of {plan.allowed.leak:g} l/min. "
        "The bound is the smallest standard deviation that any method can reach with the readings up to that time."
    )
    alt = f"Opening, position, pressures and bound over time. {plan_line(plan)}"
    return [
        make_plot("plan", "The test on simulated axes", note, alt, lambda figure: paint_plan(figure, plan), 8.5, WIDE)
    ]


def paint_plan(figure: Figure, plan: Plan) -> None:
    """Draw opening, positions, pressures of one axis, and the bound over time."""
    best, period = plan.best, plan.task.control_period
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1, 1, 1, 1.2])
    openings = plan.commands
    axes[0].plot(period * np.arange(len(openings)), 100 * openings, color=COLOURS[1], linewidth=1.2)
    axes[0].set_ylabel("opening, %")
    time = period * np.arange(best.position.shape[1])
    for values in best.position:
        axes[1].plot(*thinned(time, 1e3 * values), color=GREY, linewidth=0.8, alpha=0.7)
    axes[1].set_ylabel("position, mm")
    for values, look, name in zip(
        best.pressures[0], looks_of(range(2)).values(), ("a (bore)", "b (rod)"), strict=False
    ):
        axes[2].plot(*thinned(time, 1e-5 * values), label=f"{name}, first axis", linewidth=1.0, **look.stroke)
    axes[2].set_ylabel("pressure, bar")
    axes[2].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, fontsize=8)
    for values in best.bound:
        axes[3].plot(best.lengths, values, color=GREY, linewidth=0.8, alpha=0.7)
    axes[3].plot(best.lengths, np.median(best.bound, axis=0), color=COLOURS[0], label="median")
    axes[3].set(yscale="log", ylabel="bound, l/min", xlabel="time, s")
    axes[3].legend(frameon=False, fontsize=8)
    for axis in axes:
        axis.margins(x=0.01)


@section("Steps", needs=("plan",))
def plan_steps(content: Content) -> list[Block]:
    """The steps of the valve."""
    plan = content.part("plan", Plan)
    rows, begin = [], 0.0
    for step in plan.best.steps:
        opening = f"{100 * step.opening:+.2f} %" if step.opening else "0"
        rows.append((f"{begin:.1f} s", opening, f"{step.seconds:.2f} s", step.what))
        begin += step.seconds
    note = f"The opening changes by {100 * RAMP:.0f} % of full stroke per second at most. Positive extends the axis."
    return [Table("", ("Begin", "Opening", "For", "What"), rows, folded=False), Text(note, "soft")]


@section("Why this test", needs=("plan",))
def plan_forms(content: Content) -> list[Block]:
    """The tests that were tried, and what this one finds."""
    plan = content.part("plan", Plan)
    rows = [
        (
            trial.form.name + (" (chosen)" if trial is plan.best else ""),
            number(trial.mean_bound(), digits=2),
            number(float(trial.bound[:, -1].max()), digits=2),
            "all within" if not trial.beyond else f"{trial.beyond} of {len(trial.position)} beyond",
        )
        for trial in plan.trials
    ]
    header = ("Test", "Bound, l/min", "On the worst axis", "Limits")
    lead = (
        "Each test was simulated on plants with worn valves (null shift, underlap, rated flow, edge ratio), a clogged "
        "return line and offsets of the sensors, all unknown. Chosen is the lowest bound within the limits."
    )
    finds = (
        f"An estimate at the bound of the worst axis finds {number(plan.smallest, digits=2)} l/min at 100 bar in 95 % "
        "of the tests at 1 % false alarms. Real axes differ from every model: count on several times this "
        "(docs/leak_test.md gives what was measured)."
    )
    return [Text(lead), Table("", header, rows, style="words"), Text(finds)]


@section("How to run it", needs=("plan",))
def plan_running(content: Content) -> list[Block]:
    """What to do at the machine."""
    leak = content.part("plan", Plan).allowed.leak
    return [Points([line.format(f"{leak:g}") if "{}" in line else line for line in RUNNING])]


# The reading --------------------------------------------------------------------------------------------------------


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
def test_quantities(content: Content) -> list[Block]:
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
def test_course(content: Content) -> list[Block]:
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
def test_judging(content: Content) -> list[Block]:
    """The method."""
    del content
    return [Points(JUDGING)]
