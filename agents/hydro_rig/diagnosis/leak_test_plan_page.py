"""The page of the plan of a leak test, for the person who runs it, and the files beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.report.content import Content
from hydro_agents.report.page import FIGURE_FILES, Page
from hydro_agents.report.recorded import Line, Signal, course_plot, rig_line
from hydro_agents.report.sections import Block, Points, Text, render_page, section
from hydro_agents.rigs.check import resting_place
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table, capitalised, number
from hydro_env import __version__
from hydro_env.files import write_text
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.diagnosis.leak_test_plan import SIMULATED_LEAK, Plan
from hydro_rig.diagnosis.leak_test_steps import RAMP
from hydro_rig.export.c_files import render as render_code
from hydro_rig.recordings.simulated import recording_csv

JOB = "leak-test"
PLAN_PAGE, COMMANDS_FILE, HEADER_FILE, TRIAL_FILE = "plan.html", "commands.csv", "leak_test.h", "simulated.csv"
PLAN_FILES = (PLAN_PAGE, COMMANDS_FILE, HEADER_FILE, TRIAL_FILE, FIGURE_FILES)
PLAN_SECTIONS = ("planned_test", "plan_course", "plan_steps", "plan_forms", "plan_running")

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
        "<code>simulated.csv</code> is such a recording of one simulated axis with a leak of {:g} l/min: try the "
        "reading with it first."
    ).format(SIMULATED_LEAK),
)


def plan_to_folder(folder: Path, plan: Plan, overwrite: bool, command: str) -> list[str]:
    """Write the page, the commands as CSV and C, and a simulated recording; returns lines for the user."""
    signals = plan.best.signals
    with output_folder(folder, JOB, PLAN_FILES, overwrite=overwrite):
        write_text(folder / COMMANDS_FILE, commands_csv(plan))
        write_text(folder / HEADER_FILE, header_code(plan, command))
        time = plan.task.control_period * np.arange(signals.shape[2], dtype=np.float64)
        note = f"{command}: simulated axis, leak {SIMULATED_LEAK:g} l/min at 100 bar"
        write_text(folder / TRIAL_FILE, recording_csv(time, signals[0], note))
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


def render_plan(plan: Plan, origin: Origin) -> Page:
    """The page of a plan."""
    content = Content({}, plan.task, others={"plan": plan})
    sources = Markup("Numbers: <code>commands.csv</code> beside this page; <code>--json</code> prints the others.")
    return render_page("Plan of a leak test", PLAN_SECTIONS, content, origin, sources)


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


@section("Why this test", needs=("plan",))
def plan_forms(content: Content) -> list[Block]:
    """The tests that were tried, and what this one finds."""
    plan = content.part("plan", Plan)
    rows = [
        (
            trial.form.name + (" (chosen)" if trial is plan.best else ""),
            number(trial.mean_bound, digits=2),
            number(trial.largest_bound, digits=2),
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
    del content
    return [Points(RUNNING)]
