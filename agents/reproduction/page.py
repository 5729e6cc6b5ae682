"""The page that compares each figure with the paper; one file without external parts."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from markupsafe import Markup

from agents.report.canvas import inline
from agents.report.text import Table, templates
from agents.reproduction.equation_table import equation_table
from agents.reproduction.figures import Words
from agents.reproduction.rig import Rig
from hydro_env import TaskConfig, __version__


class PageFigure(NamedTuple):
    """A figure of the page, or the reason why there is none."""

    key: str
    title: str
    in_paper: bool
    headline: bool
    equations: str
    words: Words | None = None
    drawing: bytes = b""  # SVG
    reason: str = ""

    @property
    def svg(self) -> Markup:
        """The drawing as an element of the page, with its findings for readers who cannot see it."""
        return Markup(
            inline(self.drawing, self.key, f"{self.title}. {' '.join(self.words.found if self.words else [])}")
        )


def render_page(figures: list[PageFigure], command: str, rig: Rig) -> str:
    """The page as HTML."""
    table = equation_table()
    equations = Table("", tuple(table.columns), list(table.itertuples(index=False, name=None)))
    template = templates(Path(__file__).parent).get_template("page.html.j2")
    bounds = TaskConfig().leakage.class_bounds
    return template.render(
        figures=figures, equations=equations, command=command, rig=rig, bounds=bounds, version=__version__
    )
