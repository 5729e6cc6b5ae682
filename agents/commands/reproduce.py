"""``hydro reproduce``: every figure as picture and table, and the page that explains them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from agents.reproduction.bode import bode_figure
from agents.reproduction.closed_bode import closed_bode_figure
from agents.reproduction.closed_moves import closed_moves_figure
from agents.reproduction.displacement import displacement_figure
from agents.reproduction.drawing import ReproducedFigure, render
from agents.reproduction.energy import energy_figure
from agents.reproduction.equation_table import equation_table
from agents.reproduction.force_rate import laminar_force_rate_figure, throttle_force_rate_figure
from agents.reproduction.friction_scan import friction_scan_figure
from agents.reproduction.holding import holding_figure
from agents.reproduction.leakage_share import leakage_share_figure
from agents.reproduction.maps import map_figure
from agents.reproduction.page import PageFigure, render_page
from agents.reproduction.rig import Rig, rig_from
from agents.reproduction.sensitivity import sensitivity_figure
from agents.reproduction.settling_figure import settling_figure
from agents.reproduction.stability import stability_figure
from agents.running.console import ProgressDisplay
from agents.running.folders import output_folder
from hydro_env import HydroError
from hydro_env.files import write_text, write_whole

PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"
SUFFIXES = ("png", "svg", "csv")


class Entry(NamedTuple):
    """One figure of the page: name of its files, heading, who makes it, and whether the paper has it."""

    key: str
    title: str
    make: Callable[[Rig], ReproducedFigure]
    in_paper: bool
    headline: bool = False  # stands in the summary although the paper does not have it


FIGURES = (
    Entry("fig12_displacement", "Fig. 12: displacement in start–stop moves", displacement_figure, True),
    Entry("fig12_closed_loop", "Fig. 12 in a closed position loop", closed_moves_figure, True),
    Entry("fig13_settling_time", "Fig. 13: settling time against leakage resistance", settling_figure, True),
    Entry("section4_force_rate", "Section 4: what changes the force, laminar leak", laminar_force_rate_figure, True),
    Entry("section4_throttle", "Section 4: the same with a throttle", throttle_force_rate_figure, True),
    Entry("section4_share", "Section 4: leakage’s share against the pressure difference", leakage_share_figure, True),
    Entry("maps_frequency_damping", "Further: natural frequency and damping over the stroke", map_figure, False),
    Entry("bode_position", "Further: frequency response at several leaks", bode_figure, False),
    Entry("bode_closed_loop", "Further: frequency response of the closed position loop", closed_bode_figure, False),
    Entry(
        "stability_limit",
        "Further: how much gain the loop bears, in speed too",
        stability_figure,
        False,
        True,
    ),
    Entry("holding_error", "Further: error while holding", holding_figure, False),
    Entry("supply_energy", "Further: what the leak costs", energy_figure, False),
    Entry("sensitivity", "Further: which assumed parameter changes which result", sensitivity_figure, False),
    Entry("friction_scan", "Further: how much friction the trend of Fig. 13 bears", friction_scan_figure, False),
)


def reproduce_to_folder(
    folder: Path, overwrite: bool, command: str = "hydro reproduce", rig_file: Path | None = None
) -> Path:
    """Compute, draw and write everything; returns the page.

    A figure that the rig cannot do is left out, and the page says why in its place.

    Args:
        folder: for the results.
        overwrite: replace results that are there.
        command: as the page quotes it.
        rig_file: YAML file of a rig; ``None`` is the paper's.

    Raises:
        ConfigurationError: the folder cannot be used (:func:`~agents.running.folders.output_folder`); the rig
            is wrong or cannot work.
    """
    rig = rig_from(rig_file)
    files = [PAGE_FILE, EQUATIONS_FILE, *(f"{entry.key}.{suffix}" for entry in FIGURES for suffix in SUFFIXES)]
    with output_folder(folder, "reproduce", files, overwrite=overwrite), ProgressDisplay() as display:
        equations = equation_table()
        write_text(folder / EQUATIONS_FILE, equations.to_csv(index=False))
        done = []
        display.update("figures", 0, len(FIGURES))
        for number, entry in enumerate(FIGURES, 1):
            done.append(_made(entry, rig, folder))
            display.update("figures", number, len(FIGURES), entry.title)
        write_text(folder / PAGE_FILE, render_page(done, equations, command, rig))
    return folder / PAGE_FILE


def _made(entry: Entry, rig: Rig, folder: Path) -> PageFigure:
    files = {suffix: folder / f"{entry.key}.{suffix}" for suffix in SUFFIXES}
    try:
        figure = entry.make(rig)
    except (HydroError, ArithmeticError) as error:  # ArithmeticError: the axis does not oscillate
        return PageFigure(
            entry.key, entry.title, entry.in_paper, entry.headline, None, "", " ".join(str(error).split())
        )
    png, svg = render(figure, entry.key)
    write_whole(files["png"], png)
    write_whole(files["svg"], svg.encode())
    write_whole(files["csv"], figure.table.to_csv(index=False, float_format="%.9g").encode())
    return PageFigure(entry.key, entry.title, entry.in_paper, entry.headline, figure, svg, "")
