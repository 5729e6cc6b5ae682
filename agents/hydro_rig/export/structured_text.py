"""Writes a controller as Structured Text (IEC 61131-3): one function block, its gains in one structure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydro_rig.export.c_files import render
from hydro_rig.export.c_writer import CWriter, in_rows
from hydro_rig.export.controller import ControllerGraph, element_names, field_names, inputs_of, written_step
from hydro_rig.export.graph import KINDS, Node
from hydro_rig.export.tracing import TraceError

TYPES = dict(zip(KINDS, ("LREAL", "REAL", "LINT", "BOOL"), strict=True))

_OPERATORS = {
    **{"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "and": "AND", "or": "OR"},
    **{"equal": "=", "not_equal": "<>", "greater": ">", "greater_equal": ">=", "less": "<", "less_equal": "<="},
}
_FUNCTIONS = {"absolute": "ABS({0})", "sqrt": "SQRT({0})", "exp": "EXP({0})", "log": "LN({0})"}
_FUNCTIONS |= {"power": "EXPT({0}, {1})"}
_FUNCTIONS |= {
    # MAX and MIN do not define what they make of a value that is not a number: here the first value stays.
    "maximum": "SEL({0} < {1}, {0}, {1})",
    "minimum": "SEL({0} > {1}, {0}, {1})",
    # The standard has no such functions; beyond 20 the hyperbolic tangent is 1 to the last digit.
    "tanh": "1.0 - 2.0 / (EXP(2.0 * LIMIT(-20.0, {0}, 20.0)) + 1.0)",
    "arcsinh": "SEL({0} < 0.0, 1.0, -1.0) * LN(ABS({0}) + SQRT({0} * {0} + 1.0))",
    "sign": "SEL({0} > 0.0, SEL({0} < 0.0, 0.0, -1.0), 1.0)",
    "copysign": "SEL({1} < 0.0, ABS({0}), -ABS({0}))",
    "negative": "-{0}",
    "not": "NOT {0}",
}
_RESERVED = frozenset((
    "abs", "acos", "action", "add", "any", "array", "asin", "at", "atan", "bool", "by", "byte", "case",
    "configuration", "constant", "cos", "d", "dint", "div", "do", "dword", "elsif", "exit", "exp", "expt", "false",
    "function", "i", "int", "j", "jmp", "k", "le", "limit", "lint", "ln", "log", "lreal", "lword", "max", "min",
    "mod", "mul", "mux", "n", "ne", "of", "on", "program", "r", "read", "real", "repeat", "resource", "retain", "rol",
    "ror", "s", "sel", "shl", "shr", "sin", "sint", "sqrt", "step", "string", "sub", "t", "tan", "task", "then",
    "time", "to", "transition", "true", "type", "udint", "uint", "until", "usint", "value", "var", "word", "write",
    "xor", "abstract", "extends", "final", "implements", "interface", "internal", "method", "persistent", "pointer",
    "private", "property", "protected", "public", "reference", "super", "this", "union",
))  # fmt: skip
"""Words of the language that a variable of Python may have as its name, and the indices of loops."""


@dataclass
class StructuredTextWriter(CWriter):
    """The statements of :class:`~hydro_rig.export.c_writer.CWriter` in Structured Text.

    Names differ in more than upper and lower case; all variables are declared before the statements.
    """

    declared: list[str] = field(default_factory=list)
    types: ClassVar[Mapping[Any, str]] = TYPES
    repeats: ClassVar[frozenset[str]] = frozenset({"arcsinh", "sign", "copysign", "maximum", "minimum"})
    reserved: ClassVar[frozenset[str]] = _RESERVED

    def _key(self, name: str) -> str:
        return name.lower()

    def comment(self, text: str) -> str:
        """A comment."""
        return f"(* {text.replace('*)', '* )').replace('(*', '( *')} *)"

    def number(self, value: Any) -> str:
        """An exact number."""
        if isinstance(value, np.bool_ | bool):
            return "TRUE" if value else "FALSE"
        return f"REAL#{literal(value)}" if isinstance(value, np.float32) and value >= 0 else literal(value)

    def assign(self, target: str, text: str) -> str:
        """A statement that gives a variable a value."""
        return f"{target} := {text};"

    def loop(self, index: str, count: int, statement: str) -> str:
        """A statement for each index."""
        return f"{_for(index, count)} {statement} END_FOR"

    def copied(self, target: str, variable: str, size: int) -> str:
        """A statement that copies a variable, or an array of a size."""
        return self.assign(target, variable)

    def declared_array(self, node: Node, name: str) -> list[str]:
        """What stands in front of the statements that fill an array."""
        self.declared.append(f"{name} : {declared_type(node.size, node.kind)};")
        return []

    def defined(self, node: Node, name: str, text: str) -> str:
        """A statement that defines a variable."""
        self.declared_array(node, name)
        return self.assign(name, text)

    def table(self, name: str, values: NDArray[Any]) -> str:
        """A constant table."""
        rows = in_rows(literal, values, 8)
        return f"{name} : ARRAY[0..{values.size - 1}] OF {TYPES[values.dtype]} := [\n        {rows}];"

    def _is_closed(self, node: Node) -> bool:
        call = node.operation in ("where", "cast") and node.kind != np.bool_
        return call or bool(re.fullmatch(r"[A-Z]+\([^()]*\)", _FUNCTIONS.get(node.operation, "")))

    def _expression(self, node: Node, operands: list[str]) -> str:
        operation, kind = node.operation, node.operands[0].kind
        if operation in _OPERATORS:
            return f" {_OPERATORS[operation]} ".join(operands)
        if operation == "where":
            return f"SEL({operands[0]}, {operands[2]}, {operands[1]})"
        if operation == "cast":
            to_truth = f"{operands[0]} <> {self.number(kind.type(0))}"
            return to_truth if node.kind == np.bool_ else f"{TYPES[kind]}_TO_{TYPES[node.kind]}({operands[0]})"
        return _FUNCTIONS[operation].format(*operands)

    def _multiplied(self, node: Node, name: str) -> list[str]:
        (left, right), (rows, inner, columns) = node.operands, node.sizes
        at, to = ("i", "j") if rows == 1 else (f"k * {inner} + i", f"k * {columns} + j")
        terms = [
            self.element(left, at),
            self.element(right, "i" if columns == 1 else f"i * {columns} + j"),
        ]
        return [_for("k", rows), _for("j", columns), *self._total(node, name, to, inner, " * ".join(terms))]

    def _summed(self, node: Node, name: str) -> list[str]:
        operand, (outer, length, inner) = node.operands[0], node.sizes
        term = self.element(operand, "i" if node.size == 1 else f"(k * {length} + i) * {inner} + j")
        head = f"{_for('k', outer)} {_for('j', inner)}"
        return [head, *self._total(node, name, f"k * {inner} + j", length, term)]

    def _total(self, node: Node, name: str, to: str, count: int, term: str) -> list[str]:
        """A sum of terms over ``i``, inside of loops over ``k`` and ``j``."""
        self.declared_array(node, name)
        into = name if node.size == 1 else f"{name}[{to}]"
        return [
            f"    {self.assign(into, self.number(node.kind.type(0)))}",
            f"    {self.loop('i', count, self.assign(into, f'{into} + {term}'))}",
            "END_FOR END_FOR",
        ]


def _for(index: str, count: int) -> str:
    return f"FOR {index} := 0 TO {count - 1} DO"


def declared_type(size: int, kind: np.dtype[Any]) -> str:
    """Type of a variable, or of an array of a size."""
    return TYPES[kind] if size == 1 else f"ARRAY[0..{size - 1}] OF {TYPES[kind]}"


def literal(value: Any) -> str:
    """A number in Structured Text: the shortest one that reads back exactly; infinity is the largest LREAL."""
    if isinstance(value, np.integer):
        return str(int(value))
    if np.isnan(value):
        raise TraceError("Structured Text has no constant that is not a number: cannot be exported")
    largest = np.finfo(np.float64).max
    plain = str(np.clip(value, -largest, largest) if np.isinf(value) else value)
    mantissa, mark, exponent = plain.partition("e")
    text = (mantissa if "." in mantissa else f"{mantissa}.0") + (f"E{int(exponent):+d}" if mark else "")
    return f"({text})" if text.startswith("-") else text


def structured_text(controller: ControllerGraph, name: str = "Controller") -> str:
    """A function block; without a call of another library, with the arithmetic of the C code.

    Args:
        controller: a graph whose gains are inputs.
        name: of the function block; ``NAMEGains`` is the structure of its gains.
    """
    fields = {part: f"{text}_before" for part, text in field_names(controller).items()}
    names = inputs_of(controller, ("Signals", "Valid", "Start", "LostLimit"), "Gains.")
    writer = StructuredTextWriter(names | fields, places=element_names(controller, "AT_"))
    writer.reserve("voltage", "signals", "valid", "start", "lostlimit", "gains", "holding", *fields.values())
    values = written_step(controller, writer, fields) | {
        "name": name,
        "gains": [gain._replace(value=literal(float(gain.value))) for gain in controller.gains],
        "parts": [(fields[part.name], declared_type(part.size, part.kind)) for part in controller.memory],
        "declared": writer.declared,
    }
    text = render("controller.st.j2", values)
    return re.sub(r"[ \t]+\n", "\n", text)
