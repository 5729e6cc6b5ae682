"""The page that sets each figure beside what the paper says; one file, nothing fetched from elsewhere."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files

import jinja2
import pandas as pd
from markupsafe import Markup

from agents.reproduction.drawing import ReproducedFigure, inline_svg
from hydro_env import __version__


@dataclass(frozen=True)
class PageFigure:
    """A figure, its drawing, and whether the paper has one like it."""

    figure: ReproducedFigure
    svg: str
    in_paper: bool

    @property
    def inline(self) -> Markup:
        """The drawing as an element of the page, with its findings for who cannot see it."""
        alt = f"{self.figure.title}. {' '.join(self.figure.found)}"
        return Markup(inline_svg(self.svg, self.figure.key, alt))


def true_minus(text: str) -> str:
    """Hyphens before numbers as minus signs."""
    return re.sub(r"(?<![\w.\-])-(?=\d)", "−", text)


def render_page(figures: list[PageFigure], equations: pd.DataFrame, command: str) -> str:
    """The page as HTML."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["minus"] = true_minus
    source = files("agents.reproduction").joinpath("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(
        figures=figures, equations=equations, command=command, version=__version__
    )
