"""Writes a controller as Structured Text (IEC 61131-3): one function block, its gains in one structure."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydro_env import __version__
from hydro_rig.export.c_files import render
from hydro_rig.export.c_writer import CWriter, loop_place
from hydro_rig.export.controller import GAINS, ControllerGraph, element_names, field_names, written_step
from hydro_rig.export.graph import Node, runs_of_places

TYPES = {np.dtype(np.float64): "LREAL", np.dtype(np.float32): "REAL", np.dtype(np.bool_): "BOOL"}
TYPES[np.dtype(np.int64)] = "LINT"

_OPERATORS = {
    **{"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "and": "AND", "or": "OR"},
    **{"equal": "=", "not_equal": "<>", "greater": ">", "greater_equal": ">=", "less": "<", "less_equal": "<="},
}
_FUNCTIONS = {"absolute": "ABS({0})", "sqrt": "SQRT({0})", "exp": "EXP({0})", "log": "LN({0})"}
_FUNCTIONS |= {"maximum": "MAX({0}, {1})", "minimum": "MIN({0}, {1})", "power": "EXPT({0}, {1})"}
_FUNCTIONS |= {
    # The standard has no such functions; beyond 20 the hyperbolic tangent is 1 to the last digit.
    "tanh": "1.0 - 2.0 / (EXP(2.0 * LIMIT(-20.0, {0}, 20.0)) + 1.0)",
    "arcsinh": "SEL({0} < 0.0, 1.0, -1.0) * LN(ABS({0}) + SQRT({0} * {0} + 1.0))",
    "sign": "SEL({0} > 0.0, SEL({0} < 0.0, 0.0, -1.0), 1.0)",
    "copysign": "SEL({1} < 0.0, ABS({0}), -ABS({0}))",
    "negative": "-{0}",
    "not": "NOT {0}",
}
_RESERVED = (
    " abs acos action add and any array asin at atan bool by byte case configuration constant cos d dint "
    " div do dword else elsif exit exp expt false for function i if in int j jmp k le limit lint ln log "
    " lreal lword max min mod mul mux n ne not of on or program r read real repeat resource retain return "
    " rol ror s sel shl shr sin sint sqrt step string sub t tan task then time to transition true type "
    " udint uint until usint value var while with word write xor "
    "abstract extends final implements interface internal method persistent pointer private property protected "
    "public reference super this union "
)
"""Words of the language, and the indices of loops, with a space on each side."""


@dataclass
class StructuredTextWriter(CWriter):
    """The statements of :class:`~hydro_rig.export.c_writer.CWriter` in Structured Text.

    Names differ in more than upper and lower case; all variables are declared before the statements.
    """

    declared: list[str] = field(default_factory=list)
    repeats: ClassVar[frozenset[str]] = frozenset({"arcsinh", "sign", "copysign"})

    def comment(self, text: str) -> str:
        """A comment."""
        return f"(* {text.replace('*)', '* )').replace('(*', '( *')} *)"

    def assign(self, target: str, text: str) -> str:
        """A statement that gives a variable a value."""
        return f"{target} := {text};"

    def named_begins(self, text: str) -> str:
        """The variable ``begins`` for a condition that has another name."""
        self.declared.append("begins : BOOL;")
        return self.assign("begins", text)

    def copied(self, target: str, variable: str, size: int) -> str:
        """A statement that copies a variable, or an array of a size."""
        return self.assign(target, variable)

    def number(self, value: Any) -> str:
        """An exact number in Structured Text."""
        if isinstance(value, np.bool_ | bool):
            return "TRUE" if value else "FALSE"
        return f"REAL#{literal(value)}" if isinstance(value, np.float32) and value >= 0 else literal(value)

    def _for(self, index: str, count: int) -> str:
        return f"FOR {index} := 0 TO {count - 1} DO"

    def _assigned(self, kind: str, name: str, size: int, text: str) -> list[str]:
        del kind
        if size == 1:
            return [self.assign(name, text)]
        return [f"{self._for('i', size)} {self.assign(f'{name}[i]', text)} END_FOR"]

    def _is_closed(self, node: Node) -> bool:
        text = _FUNCTIONS.get(node.operation, "")
        call = node.operation in ("where", "cast") and node.kind != np.bool_
        return call or bool(re.fullmatch(r"[A-Z]+\([^()]*\)", text))

    def _variable(self, node: Node, name: str) -> None:
        self.declared.append(f"{name} : {declared_type(node.size, node.kind)};")

    def _statement(self, node: Node) -> list[str]:
        lines = super()._statement(node)
        if id(node) in self._names and lines:
            self._variable(node, self._names[id(node)])
        return lines

    def kept(self, name: str, node: Node) -> tuple[str, list[str]]:
        """A separate variable for a result, and the statements that define it."""
        variable, lines = super().kept(name, node)
        if lines:
            self._variable(node, variable)
        return variable, lines

    def _expression(self, node: Node, operands: list[str]) -> str:
        operation = node.operation
        if operation in _OPERATORS:
            return f" {_OPERATORS[operation]} ".join(operands)
        if operation in _FUNCTIONS:
            return _FUNCTIONS[operation].format(*operands)
        if operation == "where":
            return f"SEL({operands[0]}, {operands[2]}, {operands[1]})"
        if operation == "cast" and node.kind == np.bool_:
            return f"{operands[0]} <> {self.number(node.operands[0].kind.type(0))}"
        if operation == "cast":
            return f"{TYPES[node.operands[0].kind]}_TO_{TYPES[node.kind]}({operands[0]})"
        raise AssertionError(operation)

    def _collected(self, node: Node, kind: str, name: str) -> list[str]:
        lines = []
        for first, length, source, start, step in runs_of_places(node):
            if length == 1:
                lines.append(self.assign(f"{name}[{self._place(node.name, first)}]", self.element(source, start)))
            else:
                text = self.element(source, loop_place(start, step, "i") if source.size > 1 else 0)
                at = loop_place(first, 1, "i")
                lines.append(f"{self._for('i', length)} {self.assign(f'{name}[{at}]', text)} END_FOR")
        return lines

    def _multiplied(self, node: Node, kind: str, name: str) -> list[str]:
        (left, right), (rows, inner, columns) = node.operands, node.sizes
        at = loop_place(0, 1, "i") if rows == 1 else f"k * {inner} + i"
        to = "j" if rows == 1 else f"k * {columns} + j"
        into = name if node.size == 1 else f"{name}[{to}]"
        terms = [
            self.element(left, at if left.size > 1 else 0),
            self.element(right, ("i" if columns == 1 else f"i * {columns} + j") if right.size > 1 else 0),
        ]
        return [
            *(f"{self._for(index, count)}" for index, count in (("k", rows), ("j", columns))),
            f"    {self.assign(into, self.number(node.kind.type(0)))}",
            f"    {self._for('i', inner)} {self.assign(into, f'{into} + {terms[0]} * {terms[1]}')} END_FOR",
            "END_FOR END_FOR",
        ]

    def _summed(self, node: Node, kind: str, name: str) -> list[str]:
        operand, (outer, length, inner) = node.operands[0], node.sizes
        into = name if node.size == 1 else f"{name}[k * {inner} + j]"
        term = self.element(operand, "i" if node.size == 1 else f"(k * {length} + i) * {inner} + j")
        return [
            f"{self._for('k', outer)} {self._for('j', inner)}",
            f"    {self.assign(into, self.number(node.kind.type(0)))}",
            f"    {self._for('i', length)} {self.assign(into, f'{into} + {term}')} END_FOR",
            "END_FOR END_FOR",
        ]

    def _new_name(self, name: str) -> str:
        plain = f"{name}_value" if f" {name.lower()} " in _RESERVED else name
        names = (plain, *(f"{plain}_{n}" for n in range(2, 10_000)))
        unique = next(one for one in names if one.lower() not in self._used)
        self._used.add(unique.lower())
        return unique

    def _new_table(self, name: str, kind: str, values: NDArray[Any]) -> str:
        unique = self._new_name(self.prefix + (f"{name}_table" if name == "constant" else name))
        texts = [literal(value) for value in values]
        rows = [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]
        body = ",\n        ".join(rows)
        self.tables.append(f"{unique} : ARRAY[0..{len(texts) - 1}] OF {TYPES[values.dtype]} := [\n        {body}];")
        return unique


def declared_type(size: int, kind: np.dtype[Any]) -> str:
    """Type of a variable, or of an array of a size."""
    return TYPES[kind] if size == 1 else f"ARRAY[0..{size - 1}] OF {TYPES[kind]}"


def literal(value: Any) -> str:
    """A number in Structured Text: the shortest one that reads back exactly; infinity is the largest LREAL."""
    if isinstance(value, np.integer):
        return str(int(value))
    if np.isnan(value):
        raise AssertionError("not a number")
    plain = str(np.clip(value, -np.finfo(np.float64).max, np.finfo(np.float64).max)) if np.isinf(value) else str(value)
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
    inputs = {"signals": "Signals", "start": "Start"} | dict(fields)
    inputs |= {GAINS + gain.name: f"Gains.{gain.name}" for gain in controller.gains}
    writer = StructuredTextWriter(inputs, places=element_names(controller, "AT_"))
    writer.plan(controller.graph)
    writer.reserve("voltage", "signals", "start", "gains", "lost_signals", *(text.lower() for text in fields.values()))
    step = written_step(controller, writer, fields)
    lost = writer.element(controller.graph.outputs["lost"], 0)
    values = {
        "name": name,
        "title": controller.title,
        "version": __version__,
        "sample_time": controller.signals.config.control_period,
        "signals": controller.signals.signals,
        "gains": [gain._replace(value=literal(float(gain.value))) for gain in controller.gains],
        "parts": [
            (
                fields[part.name],
                TYPES[part.kind] if part.size == 1 else f"ARRAY[0..{part.size - 1}] OF {TYPES[part.kind]}",
            )
            for part in controller.memory
        ],
        "declared": writer.declared,
        "tables": writer.tables,
        "lost": lost,
        **step,
    }
    text = render("controller.st.j2", values)
    return re.sub(r"[ \t]+\n", "\n", text)
