"""The pages of a leak test: of its plan, for the person who runs it, and of its reading; and the files beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.recorded import Line, Mark, Signal, course_plot, recording_tables, rig_line
from hydro_agents.report.sections import Block, Points, Text, render_page, section
from hydro_agents.rigs.check import resting_place
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, number
from hydro_env.files import write_text
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.diagnosis.diagnosis_page import signals_of
from hydro_rig.diagnosis.leak_test_plan import SIMULATED_LEAK, Plan
from hydro_rig.diagnosis.leak_test_reading import WINDOW, LeakFit, LeakTest, Quantity
from hydro_rig.diagnosis.leak_test_steps import RAMP
from hydro_rig.diagnosis.verdict import EXIT_CODES
from hydro_rig.estimation.estimator import WEAR, healthy_range
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.common_fit import WELL_FITTED
from hydro_rig.recordings.simulated import recording_csv

PLAN_PAGE, COMMANDS_FILE, TRIAL_FILE = "plan.html", "commands.csv", "simulated.csv"
PLAN_FILES = (PLAN_PAGE, COMMANDS_FILE, TRIAL_FILE, FIGURE_FILES)
PLAN_SECTIONS = ("planned_test", "plan_course", "plan_steps", "plan_running")

LIMIT_BEFORE = (
    "The limits hold on the simulated axes. Clear the whole stroke, keep the emergency stop at hand, and run the test "
    "first with half the openings: what stands in the way, and a wrong sign of the command, no simulation knows."
)
RUNNING = (
    Markup(
        "Bring the axis to the start, at rest, with the oil at its working temperature. Then play <code>commands.csv"
        "</code> (one row per control period) to the valve in open loop."
    ),
    "Record position, both pressures, spool position and command in every control period, from a second before the "
    "first step to the end.",
    Markup("Read the recording with <code>hydro leak-test RECORDING --rig FILE</code>."),
    Markup(
        "<code>simulated.csv</code> is such a recording of one simulated axis with a leak of {:g} l/min: try the "
        "reading with it first."
    ).format(SIMULATED_LEAK),
)


def plan_to_folder(folder: Path, plan: Plan, overwrite: bool, command: str) -> list[str]:
    """Write the page, the commands as CSV and C, and a simulated recording; returns lines for the user."""
    signals = plan.best.signals
    with output_folder(folder, JOB, PLAN_FILES, overwrite=overwrite):
        write_text(folder / COMMANDS_FILE, commands_csv(plan))
        time = plan.task.control_period * np.arange(signals.shape[2], dtype=np.float64)
        note = f"{command}: simulated axis, leak {SIMULATED_LEAK:g} l/min at 100 bar"
        write_text(folder / TRIAL_FILE, recording_csv(time, signals[0], note))
        content = Content({}, plan.task, others={"plan": plan})
        sources = Markup("Numbers: <code>commands.csv</code> beside this page; <code>--json</code> prints the others.")
        page = render_page("Plan of a leak test", PLAN_SECTIONS, content, Origin.now(command), sources)
        page.write(folder / PLAN_PAGE)
    files = [str(folder / name) for name in (PLAN_PAGE, COMMANDS_FILE, TRIAL_FILE)]
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


def plan_line(plan: Plan) -> str:
    """The plan in one sentence."""
    largest = max(abs(step.opening) for step in plan.best.steps)
    return (
        f"a test of {sum(step.seconds for step in plan.best.steps):.0f} s, the valve at most {100 * largest:.2g} % "
        f"open: {plan.best.form.name}; 90 % interval of the leak at the bound "
        f"±{number(HALF_WIDTH * plan.best.largest_bound, digits=2)} l/min at 100 bar"
    )


def plan_facts(plan: Plan) -> dict[str, Any]:
    """The plan as numbers, for ``--json``."""
    return {
        "steps": [step._asdict() for step in plan.best.steps],
        "form": plan.best.form.name,
        "bound_lpm": plan.best.mean_bound,
        "largest_bound_lpm": plan.best.largest_bound,
        "smallest_leak_lpm": plan.smallest,
        "largest_speed": plan.best.speed,
        "positions": [float(plan.best.position.min()), float(plan.best.position.max())],
        "largest_pressure": float(plan.best.pressures.max()),
    }


@section("", needs=("plan",))
def planned_test(content: Content) -> list[Block]:
    """The test in one sentence, the rig and its limits."""
    plan = content.part("plan", Plan)
    return [
        Text(capitalised(plan_line(plan)) + ".", "verdict"),
        Text(f"Rig: {rig_line(plan.task.plant)}.", "soft"),
        _limits(plan),
        Text(LIMIT_BEFORE, "caution"),
    ]


def _limits(plan: Plan) -> Table:
    """What the simulated axes reach, and the limits."""
    limits, best = plan.settings, plan.best
    low, high = (f"{1e3 * end:.0f}" for end in (best.position.min(), best.position.max()))
    ends = ("the stop" if np.isinf(end) else f"{1e3 * end:.0f}" for end in (limits.low, limits.high))
    rows = [
        ("Speed, also against a stop, mm/s", f"{1e3 * best.speed:.0f}", f"{1e3 * limits.speed:.0f}"),
        ("Pressure, bar", f"{1e-5 * best.pressures.max():.0f}", f"{1e-5 * limits.pressure:.0f}"),
        ("Positions, mm", f"{low} to {high}", " to ".join(ends)),
        ("Start, mm", f"{1e3 * resting_place(plan.task.plant):.0f}", ""),
    ]
    title = f"{len(best.position)} simulated axes with worn valves"
    return Table(title, ("", "Reached", "Limit"), rows, folded=False)


@section("What happens", needs=("plan",))
def plan_course(content: Content) -> list[Block]:
    """Commands, positions and pressures."""
    plan = content.part("plan", Plan)
    best, commands = plan.best, plan.commands
    time = plan.task.control_period * np.arange(max(len(commands), best.position.shape[1]))

    def line(values: Floats) -> Line:
        return Line(time[: len(values)], values)

    pressures = {"a (bore), first axis": best.pressures[0, 0], "b (rod), first axis": best.pressures[0, 1]}
    rows = [
        Signal("opening, %", {"opening": line(100 * commands)}),
        Signal("position, mm", {}, [line(1e3 * values) for values in best.position]),
        Signal("pressure, bar", {name: line(1e-5 * values) for name, values in pressures.items()}),
    ]
    note = f"{len(best.position)} simulated axes, with worn valves and a leak of {SIMULATED_LEAK:g} l/min."
    alt = f"Opening, position and pressures over time. {plan_line(plan)}"
    return [course_plot("plan", "The test on simulated axes", note, alt, rows)]


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


@section("How to run it", needs=("plan",))
def plan_running(content: Content) -> list[Block]:
    """What to do at the machine."""
    del content
    return [Points(RUNNING)]


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
    header = ("", "Value", "90 % interval", "Bound (±)", "Healthy", "Unit")
    return [Table("", header, rows, folded=False)]


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
