"""The tables of all fields of a task and of a rig in docs/tasks.md, from the models that check them.

Run: python docs/fields.py
"""

from __future__ import annotations

import re
from enum import Enum
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from hydro_env import PlantParameters, TaskConfig

PAGE = Path(__file__).with_name("tasks.md")
HEADINGS = {"Every field of the task": TaskConfig, "Every field of the rig": PlantParameters}


def table(model: type[BaseModel]) -> str:
    """One row per field: name, default, unit, meaning; what is the same in all of several groups stands once."""
    lines = ["| field | default | unit | meaning or origin |", "|---|---|---|---|", *rows(model(), "")]
    return "\n".join(lines)


def rows(group: BaseModel, prefix: str) -> list[str]:
    """The rows of a group and of the groups in it."""
    lines, inner = [], {}
    for name, field in type(group).model_fields.items():
        value = getattr(group, name)
        if isinstance(value, PlantParameters):
            continue  # it has a table of its own
        if isinstance(value, BaseModel):
            inner[name] = value
            continue
        extra = field.json_schema_extra
        unit = extra.get("unit", "") if isinstance(extra, dict) else ""
        meaning = (field.description or "").replace("|", "/")
        choices = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
        if isinstance(value, Enum):
            choices = tuple(each.value for each in type(value))
        if choices:
            meaning += f" ({', '.join(choices)})"
        lines.append(f"| `{prefix}{name}` | {shown(value)} | {unit} | {meaning} |")
    common: set[str] = set()
    if len(inner) > 2:
        common = set.intersection(*(set(rows(each, f"{prefix}*.")) for each in inner.values()))
        first = next(iter(inner.values()))
        lines += [line for line in rows(first, f"{prefix}*.") if line in common]
    for name, each in inner.items():
        for line in rows(each, f"{prefix}{name}."):
            if line.replace(f"`{prefix}{name}.", f"`{prefix}*.") not in common:
                lines.append(line)
    return lines


def shown(value: Any) -> str:
    """A default value as a short text."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple | list):
        return ", ".join(shown(each) for each in value)
    if isinstance(value, Enum):
        return str(value.value)
    return str(value) if isinstance(value, int | str) else "…"


def filled(page: str) -> str:
    """The page with the tables of now."""
    for heading, model in HEADINGS.items():
        pattern = rf"(## {heading}\n.*?\n\n)\|.*?(?=\n\n|\n\Z)"
        made = table(model)
        page = re.sub(pattern, lambda found, made=made: found[1] + made, page, count=1, flags=re.DOTALL)
    return page


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
