"""``hydro reproduce``: all figures as pictures and tables, and the page that compares them with the paper."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from hydro_agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD
from hydro_agents.report.canvas import WIDE, Plot, as_plot, render
from hydro_agents.report.page import Page, make_page
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table
from hydro_env import HydroError, TaskConfig
from hydro_env.files import write_text, write_whole
from paper.figures import FIGURES, Entry
from paper.leaks import MODERATE, SEVERE, TIGHT, flow
from paper.loop import GAIN_MARGIN
from paper.rig import Rig, rig_from
from paper.verdicts import Shown

HERE = Path(__file__).parent
PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"
VERDICTS_FILE = "verdicts.csv"
SUFFIXES = ("svg", "png", "csv")


class PageFigure(NamedTuple):
    """A figure of the page, or the reason for its absence."""

    entry: Entry
    shown: Shown | None = None
    drawing: bytes = b""  # SVG
    reason: str = ""

    @property
    def plot(self) -> Plot:
        """The drawing for the page, with its findings as alternative text."""
        findings = " ".join(verdict.finding for verdict in self.shown.verdicts) if self.shown else ""
        title = self.entry.title
        return as_plot(self.entry.key, title, "", f"{title}. {findings}", self.drawing, wide=True)


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
        write_text(folder / VERDICTS_FILE, verdict_table(done).to_csv(index=False))
        render_page(done, Origin.now(command), rig).write(folder / PAGE_FILE)
    return folder / PAGE_FILE


def _made(entry: Entry, rig: Rig, folder: Path) -> PageFigure:
    """Compute, draw and write one figure; returns its part of the page."""
    try:
        table = entry.compute(rig)
        shown = entry.show(rig, table)
    except (HydroError, ArithmeticError) as error:  # ArithmeticError: the axis does not oscillate
        return PageFigure(entry, reason=" ".join(str(error).split()))
    svg, png = render(lambda figure: entry.paint(figure, table, rig), (WIDE, entry.height), "svg", "png")
    contents = (svg, png, table.to_csv(index=False, float_format="%.9g").encode())
    for suffix, content in zip(SUFFIXES, contents, strict=True):
        write_whole(folder / f"{entry.key}.{suffix}", content)
    return PageFigure(entry, shown, svg)


def equation_table() -> pd.DataFrame:
    """The function for each equation of the paper, and its corrections."""
    return pd.read_csv(HERE / EQUATIONS_FILE)


def verdict_table(figures: list[PageFigure]) -> pd.DataFrame:
    """The verdicts on all conclusions of the paper, in the order of the page."""
    rows = [
        (figure.entry.title.partition(":")[0], *verdict)
        for figure in figures
        if figure.shown is not None
        for verdict in figure.shown.verdicts
    ]
    return pd.DataFrame(rows, columns=["figure", "conclusion", "verdict", "finding"])


def render_page(figures: list[PageFigure], origin: Origin, rig: Rig) -> Page:
    """The page; the files of its figures are beside it."""
    verdicts = verdict_table(figures)
    return make_page(
        HERE / "page.html.j2",
        origin,
        figures={figure.entry.key: figure for figure in figures},
        equations=_words("Equations", equation_table()),
        verdicts=_words("Conclusions", verdicts[["conclusion", "verdict", "finding", "figure"]]),
        counts=Counter(verdicts["verdict"]),
        rig=rig,
        bounds=TaskConfig().leakage.class_bounds,
        tight=flow(TIGHT),
        moderate=flow(MODERATE),
        severe=flow(SEVERE),
        margin=GAIN_MARGIN,
        timing=f"position sampled every {1e3 * CONTROL_PERIOD:g} ms, command {1e3 * COMMAND_LATENCY:g} ms late",
    )


def _words(caption: str, table: pd.DataFrame) -> Table:
    return Table(caption, tuple(table.columns), list(table.itertuples(index=False, name=None)), style="words")
