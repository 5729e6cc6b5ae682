"""How autodoc reads this project's docstrings.

A reference to something without an entry on the site leads to its source. The first line of a property or a constant is
a sentence, also where it holds a colon; napoleon would take what stands before it for a type.
"""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from repository_links import PACKAGES, ROOT
from sphinx.application import Sphinx
from sphinx.util.nodes import get_node_source

SENTENCES = ("property", "attribute", "data")
_as_written: dict[str, list[str]] = {}


def keep(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Remember a docstring before napoleon reads it."""
    _as_written[name] = list(lines)


def restore(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Put back the docstrings of properties and constants."""
    if what in SENTENCES:
        lines[:] = _as_written[name]


def address_of(module: Any, found: Any) -> str:
    """Address of the source of a module or of something that it defines; empty outside of the project."""
    if not hasattr(found, "__module__") and not inspect.ismodule(found):
        found = module  # a constant
    home = found if inspect.ismodule(found) else inspect.getmodule(found) or module
    path = Path(getattr(home, "__file__", None) or "/").resolve()
    if not any(path.is_relative_to(ROOT / package) for package in PACKAGES):  # a virtual environment may lie inside
        return ""
    try:
        line = "" if inspect.ismodule(found) else f"#line-{inspect.getsourcelines(found)[1]}"
    except (OSError, TypeError):  # made by a function: only its module has a place
        line = ""
    return f"../source/{path.relative_to(ROOT).as_posix()}.html{line}"


def source_of(name: str, context: list[str]) -> str | None:
    """Address, from a page in ``docs``, of the source of ``name``, which may be relative to one of the modules."""
    for place in ["", *context]:
        parts = f"{place}.{name}".strip(".").split(".")
        for count in range(len(parts), 0, -1):
            try:
                module = importlib.import_module(".".join(parts[:count]))
                found: Any = module
                for part in parts[count:]:
                    found = getattr(found, part)
            except (ImportError, AttributeError, ValueError):
                continue
            return address_of(module, found)
    return None


def link_to_source(app: Sphinx, env: Any, node: Any, content: nodes.TextElement) -> nodes.Node | None:
    """Resolve a reference that the site has no entry for; names of other packages stay plain text."""
    if node.get("refdomain") != "py":
        return None
    module = node.get("py:module") or ""
    owner = getattr(importlib.import_module(module), node.get("py:class") or "", None) if module else None
    docstring = re.search(r"docstring of ([\w.]+)\.\w+", get_node_source(node) or "")
    context = [module, getattr(owner, "__module__", ""), docstring[1] if docstring else ""]
    address = source_of(node["reftarget"], context)
    if address:
        return nodes.reference("", "", content, refuri=address, internal=True)
    return content if address == "" or node["reftarget"] in ANNOTATIONS else None


ANNOTATIONS = ("NDArray", "Array", "Floats", "Layers", "VecEnv", "AutoresetMode", "Any", "Path", "Trainer")
"""Names in annotations that stand for types of other packages, or of modules that are imported when they are needed."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep, priority=100)
    app.connect("autodoc-process-docstring", restore, priority=900)
    app.connect("missing-reference", link_to_source)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
