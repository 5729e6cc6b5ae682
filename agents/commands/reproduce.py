"""``hydro reproduce``: every figure as picture and table, and the page that explains them."""

from __future__ import annotations

import re
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
from hydro_env import ConfigurationError, HydroError
from hydro_env.files import write_whole

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
        ConfigurationError: the folder holds a page and ``overwrite`` is not asked for, or cannot be written; the rig
            is wrong or cannot work.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; --output needs a folder")
    page = folder / PAGE_FILE
    if page.exists() and not overwrite:
        raise ConfigurationError(
            f"{folder}: holds results already; --overwrite begins anew, --output takes another folder"
        )
    rig = rig_from(rig_file)
    _remove_earlier(folder)
    equations = equation_table()
    write_whole(folder / EQUATIONS_FILE, equations.to_csv(index=False).encode())
    done = []
    with ProgressDisplay() as display:
        display.update("figures", 0, len(FIGURES))
        for number, entry in enumerate(FIGURES, 1):
            done.append(_made(entry, rig, folder))
            display.update("figures", number, len(FIGURES), entry.title)
    write_whole(page, render_page(done, equations, command, rig).encode())
    return page


def _remove_earlier(folder: Path) -> None:
    """Remove what an earlier run left, figures that are no longer made as well: its page names them."""
    page = folder / PAGE_FILE
    if not page.exists():
        return
    try:
        keys = re.findall(r'<section id="(\w+)">', page.read_text(encoding="utf-8", errors="replace"))
        page.unlink()
        for key in keys:
            for suffix in SUFFIXES:
                (folder / f"{key}.{suffix}").unlink(missing_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{folder}: earlier results cannot be removed: {error.strerror}") from None


def _made(entry: Entry, rig: Rig, folder: Path) -> PageFigure:
    files = {suffix: folder / f"{entry.key}.{suffix}" for suffix in SUFFIXES}
    try:
        figure = entry.make(rig)
    except (HydroError, ArithmeticError) as error:  # ArithmeticError: the axis does not oscillate
        for file in files.values():
            file.unlink(missing_ok=True)  # of an earlier run
        return PageFigure(
            entry.key, entry.title, entry.in_paper, entry.headline, None, "", " ".join(str(error).split())
        )
    png, svg = render(figure, entry.key)
    write_whole(files["png"], png)
    write_whole(files["svg"], svg.encode())
    write_whole(files["csv"], figure.table.to_csv(index=False, float_format="%.9g").encode())
    return PageFigure(entry.key, entry.title, entry.in_paper, entry.headline, figure, svg, "")
