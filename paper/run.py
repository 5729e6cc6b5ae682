"""``hydro reproduce``: all figures as pictures and tables, and the page that explains them."""

from __future__ import annotations

from pathlib import Path

from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_env import HydroError
from hydro_env.files import write_text, write_whole
from paper.figures import FIGURES, Entry, draw, write_words
from paper.page import PageFigure, all_verdicts, equation_table, render_page
from paper.rig import Rig, rig_from
from paper.verdicts import verdict_table

PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"
VERDICTS_FILE = "verdicts.csv"
SUFFIXES = ("svg", "png", "csv")


def reproduce_to_folder(
    folder: Path, overwrite: bool, command: str = "hydro reproduce", rig_file: Path | None = None
) -> Path:
    """Compute, draw and write everything; returns the page.

    For each figure that does not apply to the rig, the page gives the reason.

    Args:
        folder: for the results.
        overwrite: whether to replace earlier results.
        command: the command line, quoted on the page.
        rig_file: YAML file of a rig; ``None`` is the paper's.

    Raises:
        ConfigurationError: the folder cannot be used (:func:`~hydro_agents.running.folders.output_folder`); the rig is
            wrong or cannot work.
    """
    rig = rig_from(rig_file)
    drawn = [f"{entry.key}.{suffix}" for entry in FIGURES for suffix in SUFFIXES]
    files = [PAGE_FILE, EQUATIONS_FILE, VERDICTS_FILE, *drawn]
    with output_folder(folder, "reproduce", files, overwrite=overwrite), ProgressDisplay() as display:
        write_text(folder / EQUATIONS_FILE, equation_table().to_csv(index=False))
        done = []
        display.update("figures", 0, len(FIGURES))
        for number, entry in enumerate(FIGURES, 1):
            done.append(_made(entry, rig, folder))
            display.update("figures", number, len(FIGURES), entry.title)
        verdicts = verdict_table(all_verdicts(done))
        write_text(folder / VERDICTS_FILE, verdicts.to_csv(index=False))
        render_page(done, Origin.now(command), rig).write(folder / PAGE_FILE)
    return folder / PAGE_FILE


def _made(entry: Entry, rig: Rig, folder: Path) -> PageFigure:
    """Compute, draw and write one figure; returns its part of the page."""
    try:
        table = entry.compute(rig)
        words = write_words(entry, table, rig)
    except (HydroError, ArithmeticError) as error:  # ArithmeticError: the axis does not oscillate
        return PageFigure(entry, reason=" ".join(str(error).split()))
    svg, png = draw(entry, table, rig)
    contents = (svg, png, table.to_csv(index=False, float_format="%.9g").encode())
    for suffix, content in zip(SUFFIXES, contents, strict=True):
        write_whole(folder / f"{entry.key}.{suffix}", content)
    return PageFigure(entry, words, svg)
