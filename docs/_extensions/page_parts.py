"""Parts of pages that are made while the site is built; an HTML comment marks the place, which other hosts do not show.

``<!-- docstring: MODULE:NAME -->`` puts in the docstring of a class that is written in Markdown;
``<!-- parameters: MODULE:NAME -->`` a table of the fields of a group of settings and its subgroups;
``<!-- playground -->`` the page with the slider, if ``docs/playground.html`` exists.
"""

from __future__ import annotations

import importlib
import inspect
import re
from enum import Enum
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parents[1]
MARK = re.compile(r"<!-- (\w+)(?:: ([\w.]+):(\w+))? -->")


def docstring(module: str, name: str) -> str:
    """The docstring below its first heading; the roles of its references in the syntax of MyST."""
    text = inspect.cleandoc(getattr(importlib.import_module(module), name).__doc__)
    return re.sub(r":(\w+):`([^`]+)`", r"{py:\1}`\2`", text)


def parameters(module: str, name: str) -> str:
    """A table of all fields: name, default, unit, allowed values, where the number comes from or what it means."""
    rows = ["{.settings}", "| setting | default | unit | allowed | origin or meaning |", "|---|---|---|---|---|"]
    return "\n".join(rows + field_rows(getattr(importlib.import_module(module), name)(), ""))


def field_rows(group: BaseModel, prefix: str) -> list[str]:
    """Rows of a group of settings and of its subgroups; one row for a field that is the same in all subgroups."""
    fields = type(group).model_fields
    inner = {name: getattr(group, name) for name in fields if isinstance(getattr(group, name), BaseModel)}
    inner.pop("plant", None)  # the rig has a table of its own
    rows = [row(f"{prefix}{name}", getattr(group, name), fields[name]) for name in fields if name not in inner]
    rows = [line for line in rows if line]
    everywhere: set[str] = set()
    if len(inner) > 2:
        blocks = [
            {line.split("`")[1].rsplit(".")[-1]: line for line in field_rows(each, "*.")} for each in inner.values()
        ]
        everywhere = {name for name, line in blocks[0].items() if all(block.get(name) == line for block in blocks)}
        rows += [line.replace("`*.", f"`{prefix}*.") for name, line in blocks[0].items() if name in everywhere]
    for name, each in inner.items():
        own = field_rows(each, f"{prefix}{name}.")
        rows += [line for line in own if last_name(line) not in everywhere]
    return rows


def last_name(line: str) -> str:
    """Name of the field of a row, without those of its groups."""
    return line.split("`")[1].rsplit(".")[-1]


def row(name: str, value: Any, field: FieldInfo) -> str:
    """One row of the table; empty for a group."""
    if isinstance(value, BaseModel):
        return ""
    extra: Any = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    meaning = (field.description or "").replace("|", "/")
    return f"| `{name}` | {shown(value)} | {extra.get('unit', '')} | {allowed_values(field)} | {meaning} |"


def allowed_values(field: FieldInfo) -> str:
    """The range of a number, or the choices of an enumeration or a literal."""
    kind = field.annotation
    if inspect.isclass(kind) and issubclass(kind, Enum):
        return ", ".join(str(choice.value) for choice in kind)
    if get_origin(kind) is Literal:
        return ", ".join(map(str, get_args(kind)))
    bounds = {key: getattr(m, key) for m in field.metadata for key in ("gt", "ge", "le") if hasattr(m, key)}
    low = f"above {bounds['gt']:g}" if "gt" in bounds else f"{bounds['ge']:g}" if "ge" in bounds else ""
    if "le" not in bounds:
        return f"from {low}" if low else ""
    return f"{low} to {bounds['le']:g}" if low else f"up to {bounds['le']:g}"


def shown(value: Any) -> str:
    """A default value as a short text."""
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple | list):
        return ", ".join(map(shown, value))
    return "–" if value is None else str(value) if isinstance(value, int | str) else "…"


def playground() -> str:
    """The page with the slider inside this page."""
    if not (DOCS / "playground.html").is_file():
        return ""
    return (
        '<iframe class="playground" src="playground.html" loading="lazy" title="The axis, with a slider for the leak">'
        "</iframe>\n\n[Open the playground alone](playground.html) · [what it computes](about_playground.md)\n"
    )


def fill(app: Sphinx, docname: str, content: list[str]) -> None:
    """Put the parts in place of their marks."""

    def made(match: re.Match[str]) -> str:
        kind, module, name = match.groups()
        makers = {"docstring": docstring, "parameters": parameters}
        if kind in makers and module:
            return makers[kind](module, name)
        return playground() if kind == "playground" else match[0]

    content[0] = MARK.sub(made, content[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
