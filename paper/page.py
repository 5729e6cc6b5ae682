"""The page that compares each figure with the paper; one file without external parts."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from hydro_agents.report.canvas import Plot, as_plot
from hydro_agents.report.page import Page, make_page
from hydro_agents.report.text import Table
from hydro_agents.running.machine import Origin
from hydro_env import TaskConfig
from paper.figures import Entry, Words
from paper.rig import Rig
from paper.verdicts import Verdict

HERE = Path(__file__).parent


def equation_table() -> pd.DataFrame:
    """The function for each equation of the paper, and its corrections."""
    return pd.read_csv(HERE / "equations.csv")


class PageFigure(NamedTuple):
    """A figure of the page, or the reason for its absence."""

    entry: Entry
    words: Words | None = None
    drawing: bytes = b""  # SVG
    reason: str = ""

    @property
    def plot(self) -> Plot:
        """The drawing for the page, with its findings as alternative text."""
        found = " ".join(self.words.found if self.words else [])
        title = self.entry.title
        return as_plot(self.entry.key, title, "", f"{title}. {found}", self.drawing, wide=True)


def all_verdicts(figures: list[PageFigure]) -> list[Verdict]:
    """The verdicts on all conclusions of the paper, in the order of the page."""
    return [verdict for figure in figures if figure.words is not None for verdict in figure.words.verdicts]


def render_page(figures: list[PageFigure], origin: Origin, rig: Rig) -> Page:
    """The page; the files of its figures are beside it."""
    table = equation_table()
    equations = Table("Equations", tuple(table.columns), list(table.itertuples(index=False, name=None)))
    bounds = TaskConfig().leakage.class_bounds
    judged = all_verdicts(figures)
    rows = [(each.conclusion, each.verdict, each.finding, each.figure) for each in judged]
    return make_page(
        HERE / "page.html.j2",
        origin,
        figures=figures,
        equations=equations,
        verdicts=Table("Conclusions", ("conclusion", "verdict", "finding", "figure"), rows),
        counts=Counter(each.verdict for each in judged),
        rig=rig,
        bounds=bounds,
    )
