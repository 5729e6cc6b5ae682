"""``hydro reproduce``: every figure as picture and table, and the page that explains them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agents.console import ProgressDisplay
from agents.reproduction.bode import bode_figure
from agents.reproduction.displacement import displacement_figure
from agents.reproduction.drawing import ReproducedFigure, render
from agents.reproduction.energy import energy_figure
from agents.reproduction.equation_table import equation_table
from agents.reproduction.force_rate import force_rate_figure
from agents.reproduction.holding import holding_figure
from agents.reproduction.maps import map_figure
from agents.reproduction.page import PageFigure, render_page
from agents.reproduction.sensitivity import sensitivity_figure
from agents.reproduction.settling_figure import settling_figure
from hydro_env import ConfigurationError, PlantParameters
from hydro_env.plant.configuration import write_whole

PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"

Maker = Callable[[PlantParameters], ReproducedFigure]

PAPER_FIGURES: tuple[Maker, ...] = (displacement_figure, settling_figure, force_rate_figure)
FURTHER_FIGURES: tuple[Maker, ...] = (map_figure, bode_figure, holding_figure, energy_figure, sensitivity_figure)


def reproduce_to_folder(folder: Path, overwrite: bool, command: str = "hydro reproduce") -> Path:
    """Compute, draw and write everything; returns the page.

    Raises:
        ConfigurationError: the folder holds a page and ``overwrite`` is not asked for, or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; --output needs a folder")
    page = folder / PAGE_FILE
    if page.exists() and not overwrite:
        raise ConfigurationError(
            f"{folder}: holds results already; --overwrite begins anew, --output takes another folder"
        )
    equations = equation_table()
    write_whole(folder / EQUATIONS_FILE, equations.to_csv(index=False).encode())
    base, done = PlantParameters(), []
    makers = [(maker, True) for maker in PAPER_FIGURES] + [(maker, False) for maker in FURTHER_FIGURES]
    with ProgressDisplay() as display:
        display.update("figures", 0, len(makers))
        for number, (maker, in_paper) in enumerate(makers, 1):
            figure = maker(base)
            png, svg = render(figure)
            write_whole(folder / f"{figure.key}.png", png)
            write_whole(folder / f"{figure.key}.svg", svg.encode())
            write_whole(folder / f"{figure.key}.csv", figure.table.to_csv(index=False, float_format="%.9g").encode())
            done.append(PageFigure(figure, svg, in_paper))
            display.update("figures", number, len(makers), figure.title)
    write_whole(page, render_page(done, equations, command).encode())
    return page
