"""A page and its figures: the common way from results to files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

from hydro_agents.report.palette import css_rules
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import number, setting
from hydro_env.files import write_whole

LETTER = re.compile(r'<path id="DejaVuSans[^"]*"[^>]*/>')
"""Outline of a letter in a drawing."""

FIGURE_FILES = "figures/*.svg"
"""Pattern of the figure files beside a page."""


@dataclass(frozen=True)
class Page:
    """One HTML file without external parts, and its figures as files."""

    html: str
    figures: Mapping[str, bytes]  # by the name of the file

    def write(self, path: Path) -> None:
        """Write the page, and its figures into the folder ``figures`` beside it.

        Raises:
            ConfigurationError: a file cannot be written.
        """
        for name, file in self.figures.items():
            write_whole(path.parent / "figures" / name, file)
        write_whole(path, self.html.encode())


def make_page(template: Path, origin: Origin, **values: Any) -> Page:
    """Fill a template, which extends ``base.html.j2``.

    Args:
        template: file of the template; its filters ``n`` and ``s`` are :func:`~hydro_agents.running.text.number` and
            :func:`~hydro_agents.running.text.setting`.
        origin: command, date and version of the page.
        values: for the template; the figures (:class:`~hydro_agents.report.canvas.Plot`) in ``plots`` become files.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["css_rules"] = css_rules
    environment.filters.update({"n": number, "s": setting})
    html = environment.get_template(template.name).render(origin=origin, **values)
    return Page(_shared_letters(html), {f"{plot.key}.svg": plot.file for plot in values.get("plots", ())})


def _shared_letters(html: str) -> str:
    """The page with one outline of each letter for all its figures."""
    letters = dict.fromkeys(LETTER.findall(html))
    store = (
        f'<svg width="0" height="0" aria-hidden="true" style="position:absolute"><defs>{"".join(letters)}</defs></svg>'
    )
    return LETTER.sub("", html).replace("<body>", f"<body>\n{store}", 1) if letters else html
