"""Structured Text as PLCopen XML (TC6, version 2.01), which CODESYS, TwinCAT 3 and Beremiz import."""

from __future__ import annotations

import re
from typing import Any

from hydro_env import __version__
from hydro_rig.export.c_files import render

_TYPE = re.compile(r"^TYPE\b(.*?)^END_TYPE", re.MULTILINE | re.DOTALL)
_UNIT = re.compile(r"^(FUNCTION|FUNCTION_BLOCK|PROGRAM) (\w+)(?: : (\w+))?\n(.*?)^END_\1", re.MULTILINE | re.DOTALL)
_SECTION = re.compile(r"^VAR(?:_(\w+))?( CONSTANT)?\b[^\n]*\n(.*?)^END_VAR\n", re.MULTILINE | re.DOTALL)
_DECLARED = re.compile(
    r"^    ([\w, ]+) : (?:ARRAY\[0\.\.(\d+)\] OF )?(\w+)(?: := \[?([^;\]]*)\]?)?;(?: \(\* (.*?) \*\))?$", re.MULTILINE
)
SECTIONS = {"": "localVars", "INPUT": "inputVars", "OUTPUT": "outputVars", "IN_OUT": "inOutVars"}
UNITS = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


def plcopen_xml(text: str, name: str) -> str:
    """A project called ``name`` of the types, functions, blocks and programs of a text of ``structured_text.py``."""
    units = []
    for kind, unit, answer, inside in _UNIT.findall(text):
        sections = [
            (SECTIONS[section], bool(constant), _declared(variables))
            for section, constant, variables in _SECTION.findall(inside)
        ]
        body = inside.rpartition("END_VAR\n")[2].strip("\n")
        units.append({"name": unit, "kind": UNITS[kind], "answer": answer, "sections": sections, "body": body})
    types = []
    for inside in _TYPE.findall(text):
        fields = _declared(inside)
        types += [(inside.split()[0], fields)] if "END_STRUCT" in inside else [(one["name"], [one]) for one in fields]
    return render("plcopen.xml.j2", {"name": name, "version": __version__, "types": types, "units": units}) + "\n"


def _declared(text: str) -> list[dict[str, Any]]:
    """The declarations of a section: name, kind, last index or "", initial values, comment."""
    return [
        {"name": name, "kind": kind, "last": last, "numbers": re.findall(r"[^\s,]+", values), "comment": comment}
        for names, last, kind, values, comment in _DECLARED.findall(text)
        for name in names.split(", ")
    ]
