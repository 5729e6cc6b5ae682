"""Excerpts in the search results also where the site opens from disk.

Sphinx fetches each page that it has found, to show the words around a hit; a browser refuses that for files. The texts
of all pages therefore stand in one script, which the search page alone loads, and which answers in the browser's place.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

SCRIPT = "texts_of_pages.js"
ANSWER = """
if (location.protocol === "file:") {
  window.fetch = async (address) => {
    const page = Object.keys(TEXTS).find((name) => new URL(address, location).pathname.endsWith("/" + name));
    return { text: async () => (page ? `<div role="main">${TEXTS[page]}</div>` : "") };
  };
}
"""
_LEFT_OUT = re.compile(r"<(script|style)\b.*?</\1>|<!--.*?-->|<a class=\"headerlink\".*?</a>", re.DOTALL)
_TAG = re.compile(r"<(?!/?section\b)[^>]*>")


def text_of(page: str) -> str:
    """The article of an HTML page, without tags but those of its sections, whose anchors the search looks up."""
    article = page.partition('role="main"')[2].partition(">")[2].partition("</article>")[0]
    return re.sub(r"\s+", " ", _TAG.sub(" ", _LEFT_OUT.sub("", article))).strip()


def on_the_search_page(app: Sphinx, pagename: str, *_: Any) -> None:
    """Load the script there."""
    if pagename == "search":
        app.add_js_file(SCRIPT)


def write_texts(app: Sphinx, error: Exception | None) -> None:
    """Write the script."""
    if error is None and app.builder.name == "html":
        folder = Path(app.outdir)
        files = [folder / f"{name}.html" for name in sorted(app.env.found_docs)]
        texts = {file.relative_to(folder).as_posix(): text_of(file.read_text(encoding="utf-8")) for file in files}
        script = f"const TEXTS = {json.dumps(texts, ensure_ascii=False)};\n{ANSWER}"
        (folder / "_static" / SCRIPT).write_text(script, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("html-page-context", on_the_search_page)
    app.connect("build-finished", write_texts)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
