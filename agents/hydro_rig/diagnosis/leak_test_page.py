"""The pages of a leak test: of its plan, for the person who runs it, and of its reading; and the files beside them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_agents.report.kit import Page, drawn, time_panels
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import capitalised
from hydro_env.files import write_text
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.diagnosis.diagnose import Diagnosis, in_json
from hydro_rig.diagnosis.diagnosis_page import PANELS, diagnosis_page, draw_signals
from hydro_rig.diagnosis.leak_test import SIMULATED_LEAK, Plan, Quantities
from hydro_rig.recordings.simulated import recording_csv

JOB = "leak-test"
PLAN_FILES = ("plan.html", "commands.csv", "simulated.csv")
READING_FILES = ("leak_test.html", "leak_test.json")
CAUTION = (
    "The limits hold on the simulated axes. Clear the whole stroke, keep the emergency stop at hand, and run the test "
    "first with half the openings: what stands in the way, and a wrong sign of the command, no simulation knows."
)
RUNNING = (
    "Bring the axis to rest, with the oil at its working temperature. Then play commands.csv (one row per control "
    "period) to the valve in open loop.",
    "Record position, both pressures, spool position and command in every control period, from a second before the "
    "first step to the end.",
    "Read the recording with hydro leak-test RECORDING --rig FILE.",
    f"simulated.csv is such a recording of a simulated axis with a leak of {SIMULATED_LEAK:g} l/min: try it first.",
)


def write_plan(folder: Path, plan: Plan, command: str) -> None:
    """Write the page, the commands, and a simulated recording."""
    openings, period = plan.commands, plan.task.control_period
    columns = {"time [s]": np.round(period * np.arange(len(openings)), 6), "opening [1]": openings}
    table = pd.DataFrame(columns | {"voltage [V]": FULL_VOLTAGE * openings})
    write_text(folder / "commands.csv", table.to_csv(index=False, float_format="%.6g"))
    time = period * np.arange(plan.signals.shape[2])
    write_text(folder / "simulated.csv", recording_csv(time, plan.signals[0], f"{command}: leak {SIMULATED_LEAK:g}"))
    plan_page(plan).write(folder / "plan.html", Origin.now(command))


@drawn
def plan_page(plan: Plan) -> Page:
    """The steps, what the simulated axes do, and how to run the test."""
    page = Page("Plan of a leak test", "Numbers: commands.csv beside this page.")
    page.verdict(capitalised(plan.line()) + ".")
    page.text(CAUTION, "caution")
    page.points(RUNNING)
    rows = [(100.0 * step.opening, step.seconds, step.what) for step in plan.steps]
    begin = np.cumsum([0.0, *(step.seconds for step in plan.steps[:-1])])
    page.table(pd.DataFrame(rows, begin, ["opening, %", "for, s", "what"]), "Steps, by their begin in s")
    time = plan.task.control_period * np.arange(plan.signals.shape[2])
    axes = time_panels(tuple(PANELS), 5.0)
    draw_signals(axes, time, plan.signals[0])
    page.figure(axes, f"A simulated axis with a worn valve, leak {SIMULATED_LEAK:g} l/min")
    return page


def write_reading(folder: Path, found: Diagnosis, quantities: Quantities, command: str) -> None:
    """Write the page and the numbers."""
    sizes = {name: interval._asdict() for name, interval in quantities.items()}
    write_text(folder / "leak_test.json", json.dumps(in_json(found) | {"quantities": sizes}, indent=1) + "\n")
    page = diagnosis_page(found, "Leak test of the axis", "leak_test.json")
    page.write(folder / "leak_test.html", Origin.now(command))
