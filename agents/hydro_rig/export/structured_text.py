"""Writes a controller as Structured Text (IEC 61131-3): one function block, its gains in one structure."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from hydro_rig.export.c_files import render
from hydro_rig.export.c_writer import Language, Writer, declaration
from hydro_rig.export.controller import ControllerGraph, element_names, field_names, inputs_of, written_step
from hydro_rig.export.graph import KINDS
from hydro_rig.export.tracing import TraceError

TYPES = dict(zip(KINDS, ("LREAL", "REAL", "LINT", "BOOL"), strict=True))
OPERATIONS = {
    "add": "{0} + {1}", "subtract": "{0} - {1}", "multiply": "{0} * {1}", "divide": "{0} / {1}", "negative": "-{0}",
    "and": "{0} AND {1}", "or": "{0} OR {1}", "not": "NOT {0}", "equal": "{0} = {1}",
    "greater": "{0} > {1}", "greater_equal": "{0} >= {1}", "less": "{0} < {1}", "less_equal": "{0} <= {1}",
    "where": "SEL({a}, {c}, {b})", "cast": "{of}_TO_{to}({a})",
    "absolute": "ABS({a})", "sqrt": "SQRT({a})", "exp": "EXP({a})", "log": "LN({a})", "power": "EXPT({a}, {b})",
    # The standard has no such functions; beyond 20 the hyperbolic tangent is 1 to the last digit.
    "tanh": "1.0 - 2.0 / (EXP(2.0 * LIMIT(-20.0, {a}, 20.0)) + 1.0)",
    "arcsinh": "SEL({0} < 0.0, 1.0, -1.0) * LN(ABS({a}) + SQRT({0} * {0} + 1.0))",
}  # fmt: skip
_RESERVED = frozenset((
    "abs", "acos", "action", "add", "any", "array", "asin", "at", "atan", "bool", "by", "byte", "case",
    "configuration", "constant", "cos", "d", "dint", "div", "do", "dword", "elsif", "exit", "exp", "expt", "false",
    "function", "i", "int", "j", "jmp", "k", "le", "limit", "lint", "ln", "log", "lreal", "lword", "max", "min",
    "mod", "mul", "mux", "n", "ne", "of", "on", "program", "r", "read", "real", "repeat", "resource", "retain", "rol",
    "ror", "s", "sel", "shl", "shr", "sin", "sint", "sqrt", "step", "string", "sub", "t", "tan", "task", "then",
    "time", "to", "transition", "true", "type", "udint", "uint", "until", "usint", "value", "var", "word", "write",
    "xor", "abstract", "extends", "final", "implements", "interface", "internal", "method", "persistent", "pointer",
    "private", "property", "protected", "public", "reference", "super", "this", "union",
    # Function blocks of the standard and functions: some compilers take no variable of their names.
    "integral", "derivative", "pid", "ramp", "hysteresis", "delay", "average", "stack_int", "rtc", "sema", "sr", "rs",
    "r_trig", "f_trig", "ctu", "ctd", "ctud", "tp", "ton", "tof", "trunc", "move", "concat", "insert", "delete",
    "replace", "find", "left", "right", "len", "mid", "gt", "ge", "eq", "lt", "not", "and", "or", "sign", "en", "eno",
))  # fmt: skip
"""Words of the language that a variable of Python may have as its name, and the indices of loops."""


def literal(value: Any) -> str:
    """A number in Structured Text: the shortest one that reads back exactly; infinity is the largest REAL.

    Some compilers read no larger literal, of whichever type.
    """
    if isinstance(value, np.bool_ | bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, np.integer):
        return str(int(value))
    if np.isnan(value):
        raise TraceError("Structured Text has no constant that is not a number: cannot be exported")
    largest = float(np.finfo(np.float32).max)
    plain = str(np.clip(value, -largest, largest) if np.isinf(value) else value)
    mantissa, mark, exponent = plain.partition("e")
    text = mantissa if "." in mantissa else f"{mantissa}.0"
    if mark:
        text += f"E{int(exponent):+d}"
    return f"REAL#{text}" if isinstance(value, np.float32) and value >= 0 else text


LANGUAGE = Language(
    types=TYPES,
    operations=OPERATIONS,
    number=literal,
    assign="{} := {};",
    loop="FOR {0} := 0 TO {3} DO {2} END_FOR;",
    variable="{1} : {0};",
    array="{1} : ARRAY[0..{3}] OF {0};",
    table="{1} : ARRAY[0..{3}] OF {0} := [\n        {4}];",
    comment="(* {} *)",
    reserved=_RESERVED,
    declares_first=True,
    repeats=frozenset({"arcsinh"}),
)


def structured_text(controller: ControllerGraph, name: str = "Controller") -> str:
    """A function block; without a call of another library, with the arithmetic of the C code.

    Args:
        controller: a graph whose gains are inputs.
        name: of the function block; ``NAMEGains`` is the structure of its gains.
    """
    fields = {part: f"{text}_before" for part, text in field_names(controller).items()}
    inputs = inputs_of(controller, ("Signals", "Valid", "Start", "LostLimit"), "Gains.") | fields
    taken = ("voltage", "signals", "valid", "start", "lostlimit", "gains", "holding", *fields.values())
    writer = Writer(controller.graph, inputs, LANGUAGE, element_names(controller, "AT_"), taken)
    values = written_step(controller, writer, fields) | {
        "name": name,
        "gains": [gain._replace(value=literal(float(gain.value))) for gain in controller.gains],
        "parts": [declaration(LANGUAGE, fields[part.name], part.size, part.kind) for part in controller.memory],
        "declared": writer.declared,
    }
    text = render("controller.st.j2", values)
    return re.sub(r"[ \t]+\n", "\n", text)
