"""The page that sets each figure beside what the paper says; one file, nothing fetched from elsewhere."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files

import jinja2
import pandas as pd
from markupsafe import Markup

from agents.reproduction.drawing import ReproducedFigure, inline_svg
from agents.reproduction.rig import Rig
from hydro_env import __version__


@dataclass(frozen=True)
class PageFigure:
    """A figure with its drawing, or why there is none."""

    key: str
    title: str
    in_paper: bool
    headline: bool
    figure: ReproducedFigure | None
    svg: str
    reason: str

    @property
    def inline(self) -> Markup:
        """The drawing as an element of the page, with its findings for who cannot see it."""
        alt = f"{self.title}. {' '.join(self.figure.found) if self.figure else self.reason}"
        return Markup(inline_svg(self.svg, self.key, alt))


def true_minus(text: str) -> str:
    """Hyphens before numbers as minus signs; no sign before a zero."""
    unsigned = re.sub(r"(?<![\w.\-])[-+](?=0(?:\.0+)?(?![\d.]*[\d]))", "", text)
    return re.sub(r"(?<![\w.\-])-(?=\d)", "−", unsigned)


def render_page(figures: list[PageFigure], equations: pd.DataFrame, command: str, rig: Rig) -> str:
    """The page as HTML."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["minus"] = true_minus
    source = files("agents.reproduction").joinpath("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(
        figures=figures, equations=equations, command=command, rig=rig, version=__version__
    )
