"""The page that compares each figure with the paper; one file without external parts."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pandas as pd
from markupsafe import Markup

from agents.report.canvas import inline
from agents.report.text import Table, templates
from agents.reproduction.figures import Entry, Words
from agents.reproduction.rig import Rig
from agents.reproduction.verdicts import Verdict
from hydro_env import TaskConfig, __version__

HERE = Path(__file__).parent


def equation_table() -> pd.DataFrame:
    """Where each equation of the paper is computed, and what was corrected in it."""
    return pd.read_csv(HERE / "equations.csv")


class PageFigure(NamedTuple):
    """A figure of the page, or the reason why there is none."""

    entry: Entry
    words: Words | None = None
    drawing: bytes = b""  # SVG
    reason: str = ""

    @property
    def svg(self) -> Markup:
        """The drawing as an element of the page, with its findings for those who cannot see it."""
        found = " ".join(self.words.found if self.words else [])
        return Markup(inline(self.drawing, self.entry.key, f"{self.entry.title}. {found}"))


def all_verdicts(figures: list[PageFigure]) -> list[Verdict]:
    """The verdicts on all conclusions of the paper, in the order of the page."""
    return [verdict for figure in figures if figure.words is not None for verdict in figure.words.verdicts]


def render_page(figures: list[PageFigure], command: str, rig: Rig) -> str:
    """The page as HTML."""
    table = equation_table()
    equations = Table("", tuple(table.columns), list(table.itertuples(index=False, name=None)))
    template = templates(HERE).get_template("page.html.j2")
    bounds = TaskConfig().leakage.class_bounds
    verdicts = Table("", ("conclusion", "verdict", "finding", "figure"), [_row(v) for v in all_verdicts(figures)])
    return template.render(
        figures=figures,
        equations=equations,
        verdicts=verdicts,
        command=command,
        rig=rig,
        bounds=bounds,
        version=__version__,
    )


def _row(verdict: Verdict) -> tuple[str, ...]:
    return verdict.conclusion, verdict.verdict, verdict.finding, verdict.figure
