"""Names of the numbers of a traced function: what its lines of Python call them."""

from __future__ import annotations

import inspect
import linecache
import re
from collections.abc import Collection
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

SCALED = "_scaled"
"""End of the name of an entry of the observation, which has no unit; the same number in SI units has none."""

_ENTRY = re.compile(r"\s*\w+\[[\"'](\w+)[\"']\] = ")
_ASSIGNED = re.compile(r"\s*(?:self\.)?([A-Za-z_]\w*)(?:\[[^\]=]*\])?(?:: [^=]+)? [-+*/@]?= ")
_SEVERAL = re.compile(r"\s*(\w+(?:, \w+)+) = ")
_KEYWORD = re.compile(r"\s*(\w+)=[^=]")
_SAY_LITTLE = ("values", "result", "entries")
_OWN = (str(Path(__file__).parent / "tracing.py"), __file__, str(Path(np.__file__).parent))


def caller() -> FrameType | None:
    """The traced function that runs."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code.co_filename.startswith(_OWN):
        frame = frame.f_back
    return frame


def where() -> dict[str, str]:
    """Name and origin of a node: the variable to which the traced line assigns, or the function; and the line.

    The name is empty if the line calls the number ``values`` or the like: then it has the name of its operand.
    """
    frame = caller()
    if frame is None:
        return {}
    line = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    function = frame.f_code.co_name
    return {"name": _assigned(line, function), "origin": f"{Path(frame.f_code.co_filename).name}, {function}: {line}"}


def _assigned(line: str, function: str) -> str:
    if several := _SEVERAL.match(line):
        return several.group(1).replace(", ", "_")
    found = next((match for match in (kind.match(line) for kind in (_ENTRY, _ASSIGNED, _KEYWORD)) if match), None)
    if found is not None and found.group(1) in _SAY_LITTLE:
        return ""
    return re.sub(r"\W", "", found.group(1) if found else function).strip("_") or "value"


def inherited(operands: Collection[Any], origin: str) -> str:
    """Name of a number whose line of Python gives it none: that of its only operand, or its function."""
    names = {one.name.removesuffix(SCALED) for one in operands if one.operation not in ("constant", "input")}
    return names.pop() if len(names) == 1 else re.sub(r"\W", "", origin.split(": ")[0].split(", ")[-1]).strip("_")


def constant_name(value: Any) -> str:
    """The name by which the traced function or its object knows a constant array; empty if by none."""
    frame = caller()
    if frame is None:
        return ""
    known = dict(frame.f_locals)
    known = {**getattr(known.get("self"), "__dict__", {}), **known}
    return next((name.strip("_") for name, one in known.items() if one is value and name != "self"), "")
