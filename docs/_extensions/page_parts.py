"""``<!-- playground -->`` on a page becomes the page with the slider, if ``docs/playground.html`` exists."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parents[1]
MARK = "<!-- playground -->"
FRAME = """<iframe class="playground" src="playground.html" loading="lazy"
title="The axis, with a slider for the leak"></iframe>

[Open the playground alone](playground.html)
"""


def fill(app: Sphinx, docname: str, content: list[str]) -> None:
    """Put the frame in place of its mark."""
    content[0] = content[0].replace(MARK, FRAME if (DOCS / "playground.html").is_file() else "")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
