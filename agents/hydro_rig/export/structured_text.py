"""Writes a controller as Structured Text (IEC 61131-3): one function block, its gains in one structure.

The same text as PLCopen XML (TC6, version 2.01) is what CODESYS, TwinCAT 3 and Beremiz import.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from hydro_env import __version__
from hydro_env.types import ByName
from hydro_rig.export.c_files import TEMPLATES, render
from hydro_rig.export.c_writer import ARITHMETIC, Language, Writer
from hydro_rig.export.controller import GAINS, ControllerGraph, facts_of, field, written_step
from hydro_rig.export.graph import KINDS, Graph, Node
from hydro_rig.export.tracing import TraceError

OPERATIONS = ARITHMETIC | {
    "and": "{0} AND {1}", "or": "{0} OR {1}", "not": "NOT {0}", "equal": "{0} = {1}",
    "greater": "{0} > {1}", "greater_equal": "{0} >= {1}", "less": "{0} < {1}", "less_equal": "{0} <= {1}",
    "where": "SEL({a}, {c}, {b})", "cast": "{of}_TO_{to}({a})",
    "absolute": "ABS({a})", "sqrt": "SQRT({a})", "exp": "EXP({a})", "log": "LN({a})", "power": "EXPT({a}, {b})",
    # The standard has no such functions; beyond 20 the hyperbolic tangent is 1 to the last digit.
    "tanh": "1.0 - 2.0 / (EXP(2.0 * LIMIT(-20.0, {a}, 20.0)) + 1.0)",
    "arcsinh": "SEL({0} < 0.0, 1.0, -1.0) * LN(ABS({a}) + SQRT({0} * {0} + 1.0))",
}  # fmt: skip
RESERVED = frozenset((TEMPLATES / "reserved_words.txt").read_text(encoding="utf-8").split())
"""Words of the language, its standard functions and blocks, and of C; indices of loops. No variable has such a name."""

ABREAST = 8  # columns that a product adds up together, at most: compilers check or wrap each access to an array
LARGEST_TABLE = 1000  # numbers in single precision, 4 kB: of a matrix in an instance, or in one function
ASCII = {"±": "+/-", "…": "...", "−": "-", "→": "->", "²": "2", "°": "deg", "√": "root of "}
_TYPE = re.compile(r"^TYPE\b(.*?)^END_TYPE", re.MULTILINE | re.DOTALL)
_UNIT = re.compile(r"^(FUNCTION|FUNCTION_BLOCK|PROGRAM) (\w+)(?: : (\w+))?\n(.*?)^END_\1", re.MULTILINE | re.DOTALL)
_SECTION = re.compile(r"^VAR(?:_(\w+))?( CONSTANT)?\b[^\n]*\n(.*?)^END_VAR\n", re.MULTILINE | re.DOTALL)
_DECLARED = re.compile(
    r"^    ([\w, ]+) : (?:ARRAY\[0\.\.(\d+)\] OF )?(\w+)(?: := \[?([^;\]]*)\]?)?;(?: \(\* (.*?) \*\))?$", re.MULTILINE
)
SECTIONS = {"": "localVars", "INPUT": "inputVars", "OUTPUT": "outputVars", "IN_OUT": "inOutVars"}
UNITS = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


def literal(value: Any) -> str:
    """A number in Structured Text: the shortest one that reads back exactly; infinity is the largest REAL.

    Some compilers read no larger literal, of whichever type.
    """
    if isinstance(value, np.bool_ | bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, np.integer | int):
        return str(int(value))
    if np.isnan(value):
        raise TraceError("Structured Text has no constant that is not a number: cannot be exported")
    largest = float(np.finfo(np.float32).max)
    plain = str(np.clip(value, -largest, largest))
    mantissa, mark, exponent = plain.partition("e")
    text = mantissa if "." in mantissa else f"{mantissa}.0"
    if mark:
        text += f"E{int(exponent):+d}"
    return f"REAL#{text}" if isinstance(value, np.float32) and value >= 0 else text


LANGUAGE = Language(
    types=dict(zip(KINDS, ("LREAL", "REAL", "DINT", "BOOL"), strict=True)),
    operations=OPERATIONS,
    number=literal,
    assign="{} := {};",
    loop="FOR {0} := 0 TO {3} DO {2} END_FOR;",
    variable="{1} : {0};",
    array="{1} : ARRAY[0..{3}] OF {0};",
    table="{1} : ARRAY[0..{3}] OF {0} := [\n        {4}];",
    comment="(* {} *)",
    reserved=RESERVED,
    declares_first=True,
    repeats=frozenset({"arcsinh"}),
)


class TextWriter(Writer):
    """Writes the product with a large matrix as calls of functions that hold some of its columns each.

    So no instance holds the weights of a policy: every instance would hold a copy of its own constants. Functions need
    no declaration by the user, unlike global variables, for which some compilers take no initial values of arrays.
    """

    def __init__(self, graph: Graph, taken: Sequence[str], name: str) -> None:
        super().__init__(graph, {}, LANGUAGE, taken)
        self.functions: list[str] = []
        self.longest = 0  # vector of the products
        self._name = name  # of the function block
        self._calls: dict[Node, list[str]] = {}  # of the functions of each matrix

    def _total(self, node: Node, name: str) -> list[str]:
        matrix = node.operands[-1]
        large = matrix.operation == "constant" and matrix.kind == np.float32 and matrix.size > LARGEST_TABLE
        if node.operation != "matmul" or node.sizes[0] > 1 or not large:
            return super()._total(node, name)
        _, rows, columns = node.sizes
        if matrix not in self._calls:
            self._calls[matrix] = self._functions(matrix, rows, columns)
        self.longest = max(self.longest, rows, columns + ABREAST)
        return [
            *self._declaration(node, name),
            self._loop("i", rows, f"factors[i] := {self.element(node.operands[0], 'i')};"),
            *self._calls[matrix],
            self.stored(name, "totals", columns),
        ]

    def _functions(self, matrix: Node, rows: int, columns: int) -> list[str]:
        """Writes the functions of a matrix; returns their calls."""
        assert matrix.table is not None
        calls = []
        fitting = max(LARGEST_TABLE // rows, 1)  # columns in a function
        abreast = min(fitting, ABREAST)
        step = fitting // abreast * abreast
        weights = np.pad(matrix.table.reshape(rows, columns), ((0, 0), (0, -columns % abreast)))
        for first in range(0, weights.shape[1], step):
            groups = weights[:, first : first + step].reshape(rows, -1, abreast).swapaxes(0, 1)
            name = f"{self._name}Product{len(self.functions) + 1}"
            table = self.table("weights", matrix.kind, groups.ravel())
            place = {"first": first, "groups": len(groups), "abreast": abreast, "rows": rows}
            values = {"name": name, "prefix": self._name, "weights": table, **place}
            self.functions.append(render("product.st.j2", values))
            calls.append(f"done := {name}(factors, totals);")
        return calls


def st_name(name: str) -> str:
    """Name of an input or output: ``pressure_a`` → ``PressureA``; ``Reference`` is a word of some dialects."""
    if name == "reference":
        return "ReferencePosition"
    return "".join(word[:1].upper() + word[1:] for word in name.split("_"))


def structured_text(controller: ControllerGraph, name: str = "Controller") -> str:
    """A function block; without a call of another library, with the arithmetic of the C code.

    ``name``: of the function block; ``NAMEGains`` is the structure of its gains, ``NAMEProduct1`` … hold the weights of
    a policy.
    """
    outputs = {output: st_name(output) for output in controller.outputs}
    fields = {part.name: field(part.name) for part in controller.memory}
    inputs = {row.name: st_name(row.name) for row in controller.block.inputs}
    gains = {GAINS + gain.name: f"Gains.{gain.name}" for gain in controller.gains}
    own = ("wanted", "gains", "factors", "totals", "done", name)
    writer = TextWriter(controller.graph, (*own, *inputs.values(), *outputs.values(), *fields.values()), name)
    values = written_step(controller, writer, {**fields, **inputs, **gains}, outputs)
    return _rendered("controller", controller, name, {**values, "writer": writer})


def call_example(controller: ControllerGraph, name: str) -> str:
    """A program that calls the function block with the counts of 16-bit terminals."""
    return _rendered("controller_call", controller, name, {})


def _rendered(template: str, controller: ControllerGraph, name: str, values: ByName) -> str:
    """A template with its values."""
    own = {"st_name": st_name, "literal": literal, "language": LANGUAGE, "real": LANGUAGE.types[controller.real]}
    values = {**facts_of(controller, name), **own, **values}
    return plain(render(f"{template}.st.j2", values))


def plain(text: str) -> str:
    """A text for editors of old: no letter beyond ASCII, no space at the end of a line."""
    for letter, other in ASCII.items():
        text = text.replace(letter, other)
    return re.sub(r"[ \t]+\n", "\n", text) + "\n"


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


def _declared(text: str) -> list[ByName]:
    """The declarations of a section: name, kind, last index or "", initial values, comment."""
    return [
        {"name": name, "kind": kind, "last": last, "numbers": re.findall(r"[^\s,]+", values), "comment": comment}
        for names, last, kind, values, comment in _DECLARED.findall(text)
        for name in names.split(", ")
    ]
