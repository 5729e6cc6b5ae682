"""The page of ``hydro check-rig``: the figures of a rig, and its position loop as Bode and step plots."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from hydro_agents.controllers.sampled_loop import SampledLoop, sampled_loop
from hydro_agents.learning.stable_gain import beyond_dead_band, leaking
from hydro_agents.report.kit import NARROW, Page, drawn, panel, panels, signal
from hydro_agents.rigs.check import EXAMINED_LEAKS, RigFigure, leak_text, place_text, resting_place
from hydro_env import HydroError, TaskConfig
from hydro_env.types import Floats

LOWEST, HIGHEST = 0.03, 0.4995  # frequencies of a Bode plot: Hz, and part of the sampling frequency
LEAST_AMPLITUDE, LEAST_PHASE = -60.0, -720.0  # dB, °; lower ones tell nothing about the margins
SETTLED = 1.0  # periods of the lowest crossover frequency that the plot of a step shows


@drawn
def check_page(
    title: str, facts: Sequence[tuple[str, str]], warnings: Sequence[str], rows: Sequence[RigFigure], task: TaskConfig
) -> Page:
    """The page.

    Args:
        title: the name of the rig.
        facts: what :func:`~hydro_agents.rigs.check_table.brief` says, the verdict last.
        warnings: of values that can hardly be meant.
        rows: all figures.
        task: gives plant, control period and latency.
    """
    page = Page(title)
    *others, (_, verdict) = facts
    page.verdict(verdict, "good" if verdict == "it works" and not warnings else "doubtful")
    for warning in warnings:
        page.text(warning, "caution")
    page.facts(dict(others))
    figures = {row.key: row for row in rows}
    if "no gain" in figures:
        page.text(f"No plots: {figures['no gain'].at}", "caution")
    else:
        try:
            _plots(page, task, figures["recommended gain"].value)
        except HydroError as error:
            page.text(f"No plots: {error}", "caution")
    page.heading("All figures")
    for group in dict.fromkeys(row.group for row in rows):
        own = [row for row in rows if row.group == group]
        cells = [(row.at, f"{row:.4g}") for row in own]
        page.table(pd.DataFrame(cells, [f"{row.quantity}, {row.unit}" for row in own], ["at", "value"]), group)
    return page


def _plots(page: Page, task: TaskConfig, gain: float) -> None:
    """Bode and step plots of a healthy and of a leaking seal, where the axis is examined.

    Raises:
        HydroError: it cannot be held there.
    """
    place, period = resting_place(task.plant), task.control_period
    loops = {
        f"leak {leak_text(leak)}": sampled_loop(
            beyond_dead_band(leaking(task.plant, leak)), place, period, task.command_latency
        )
        for leak in (EXAMINED_LEAKS[0], EXAMINED_LEAKS[-1])
    }
    sizes, phases = axes = panels(2, NARROW, 5.0)
    steps = panel(xlabel="time, s", ylabel="position, parts of the step")
    shown = 0.0  # s
    for name, loop in loops.items():
        frequencies = bode_frequencies(loop)
        response = gain * loop.frequency_response(frequencies)
        sizes.plot(frequencies, 20.0 * np.log10(np.abs(response)), marker="", label=name)
        phases.plot(frequencies, np.degrees(np.unwrap(np.angle(response))), marker="", label="_none")
        shown = max(shown, SETTLED / frequencies[np.argmax(np.abs(response) < 1.0)])
    for name, loop in loops.items():
        step = loop.step_response(gain, round(shown / period))
        signal(steps, np.linspace(0.0, period * (len(step) - 1), len(step)), step, label=name)
    sizes.set(xscale="log", ylabel="amplitude, dB")
    phases.set(xlabel="frequency, Hz", ylabel="phase, °")
    for plot, crossed, least in ((sizes, 0.0, LEAST_AMPLITUDE), (phases, -180.0, LEAST_PHASE)):
        plot.axhline(crossed, linewidth=0.8, linestyle="--", color="gray")
        plot.set_ylim(bottom=max(plot.get_ylim()[0], least))
    at = f"At {place_text(place)}, sampled every {1e3 * period:g} ms, command {1e3 * task.command_latency:g} ms late. "
    note = (
        "Linearised at rest without friction, with hold, up to half of the sampling frequency. The loop is stable if "
        "the amplitude is below 0 dB where the phase passes −180°, −540° and so on. The margins above are those of "
        "the worst place over the reach, and of the worst plant in the ranges."
    )
    page.heading("Position loop with the recommended gain")
    page.figure(axes, "Open loop, from the error of the position to the position", at + note)
    page.figure(steps, "Closed loop, a small step of the reference", at + "P controller; the valve does not saturate.")


def bode_frequencies(loop: SampledLoop) -> Floats:
    """Frequencies of a Bode plot in Hz, rising, and dense around each oscillation of the loop without feedback."""
    values, highest = np.linalg.eigvals(loop.transition), HIGHEST / loop.control_period
    poles = np.log(values[values.imag > 0.0])[:, None] / (2.0 * np.pi * loop.control_period)
    near = poles.imag - poles.real * np.sinh(np.linspace(-6.0, 6.0, 60))  # from a tenth of its half width on
    return np.sort([*np.geomspace(LOWEST, highest, 600), *near[(near > LOWEST) & (near < highest)]])
