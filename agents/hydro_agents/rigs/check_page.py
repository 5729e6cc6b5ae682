"""The page of ``hydro check-rig``: the figures of a rig, and its position loop as Bode and step plots."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.controllers.sampled_loop import SampledLoop, sampled_loop
from hydro_agents.learning.stable_gain import beyond_dead_band, leaking
from hydro_agents.report.kit import NARROW, Page, drawn, panel, panels, signal
from hydro_agents.rigs.check import EXAMINED_LEAKS, RigFigure, leak_text, resting_place
from hydro_env import HydroError, TaskConfig

FREQUENCIES = np.geomspace(5e-4, 0.4995, 600)  # of a Bode plot, in parts of the sampling frequency
SETTLED = 2.0  # periods of the crossover frequency that the plot of a step shows


@drawn
def check_page(title: str, facts: Sequence[tuple[str, str]], rows: Sequence[RigFigure], task: TaskConfig) -> Page:
    """The page.

    Args:
        title: the name of the rig.
        facts: what :func:`~hydro_agents.rigs.check_table.brief` says, the verdict last.
        rows: all figures.
        task: gives plant, control period and latency.
    """
    page = Page(title)
    *others, (_, verdict) = facts
    page.verdict(verdict, "good" if verdict == "it works" else "doubtful")
    page.facts(dict(others))
    gain: Any = next((row.value for row in rows if row.key == "recommended gain"), None)
    try:
        loops = _loops(task)
    except HydroError as error:
        page.text(f"No plots: {error}", "caution")
    else:
        if gain is not None:
            _plots(page, loops, gain)
    page.heading("All figures")
    for group in dict.fromkeys(row.group for row in rows):
        own = [row for row in rows if row.group == group]
        table = pd.DataFrame({"at": [row.at for row in own], "value": [row.text(4) for row in own]})
        table.index = pd.Index([f"{row.quantity}, {row.unit}" for row in own])
        page.table(table, group)
    return page


def _loops(task: TaskConfig) -> dict[str, SampledLoop]:
    """The position loops of a healthy and of a leaking seal, where the axis is examined, by the leak as text."""
    place = resting_place(task.plant)
    return {
        leak_text(leak): sampled_loop(
            beyond_dead_band(leaking(task.plant, leak)), place, task.control_period, task.command_latency
        )
        for leak in (EXAMINED_LEAKS[0], EXAMINED_LEAKS[-1])
    }


def _plots(page: Page, loops: Mapping[str, SampledLoop], gain: float) -> None:
    page.heading("Position loop with the recommended gain")
    sizes, phases = axes = panels(2, NARROW, 5.0)
    steps = panel(xlabel="time, s", ylabel="position, parts of the step")
    for name, loop in loops.items():
        frequencies = FREQUENCIES / loop.control_period
        response = gain * loop.frequency_response(frequencies)
        sizes.plot(frequencies, 20.0 * np.log10(np.abs(response)), marker="", label=name)
        phases.plot(frequencies, np.degrees(np.unwrap(np.angle(response))), marker="", label="_none")
        crossover = FREQUENCIES[np.argmax(np.abs(response) < 1.0)]  # per sample
        step = loop.step_response(gain, round(SETTLED / crossover))
        times = np.linspace(0.0, loop.control_period * (len(step) - 1), len(step))
        signal(steps, times, step, label=name)
    sizes.set(xscale="log", ylabel="amplitude, dB")
    phases.set(xlabel="frequency, Hz", ylabel="phase, °")
    sizes.axhline(0.0, linewidth=0.8, linestyle="--", color="gray")
    phases.axhline(-180.0, linewidth=0.8, linestyle="--", color="gray")
    note = (
        "Linearised at rest without friction; sampled, with hold and latency, up to half of the sampling frequency. "
        "The loop is stable if the amplitude is below 0 dB where the phase passes −180°, −540° and so on."
    )
    page.figure(axes, "Open loop, from the error of the position to the position", note)
    page.figure(steps, "Closed loop, a small step of the reference", "P controller; the valve does not saturate.")
