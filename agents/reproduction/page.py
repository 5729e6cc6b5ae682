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


def render_page(figures: list[PageFigure], command: str, rig: Rig) -> str:
    """The page as HTML."""
    table = equation_table()
    equations = Table("", tuple(table.columns), list(table.itertuples(index=False, name=None)))
    template = templates(HERE).get_template("page.html.j2")
    bounds = TaskConfig().leakage.class_bounds
    return template.render(
        figures=figures, equations=equations, command=command, rig=rig, bounds=bounds, version=__version__
    )
