"""Writes a graph of array operations as C99 statements: plain loops over arrays of fixed size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydro_rig.export.c_files import c_operand
from hydro_rig.export.graph import KINDS, SCALED, Graph, Node, regular, runs_of_places, source_of

C_TYPES = dict(zip(KINDS, ("double", "float", "long", "int"), strict=True))
_INFIX = {
    **{"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "and": "&&", "or": "||"},
    **{"equal": "==", "not_equal": "!="},
}
_COMPARED = {"greater": ">", "greater_equal": ">=", "less": "<", "less_equal": "<="}
_PREFIX = {"negative": "-", "not": "!"}
_FUNCTIONS = {name: name for name in ("sqrt", "exp", "log", "tanh", "copysign")}
_FUNCTIONS |= {"absolute": "fabs", "power": "pow", "arcsinh": "asinh"}
_HELPERS = {
    # As in NumPy: the first value unless the other one is larger (smaller); NaN stays NaN.
    "maximum": "static {type} {name}({type} a, {type} b) {{ return isless(a, b) ? b : a; }}",
    "minimum": "static {type} {name}({type} a, {type} b) {{ return isgreater(a, b) ? b : a; }}",
    "sign": "static {type} {name}({type} a) {{ return isgreater(a, 0) ? 1 : isless(a, 0) ? -1 : a; }}",
}
_EXACT = {"where", "cast", "maximum", "minimum", "absolute", "sign", "copysign", "negative"}
LONGEST = 120  # characters of the longest number that is written into the statement of another one


@dataclass
class CWriter:
    """Collects constant tables and helper functions of one C file, and writes statements that use them.

    Args:
        inputs: C text of each input of the graph, by name; for an array without index.
        prefix: of the names of helper functions, for a file that contains others.
        places: names of the elements of arrays, by the name of the array.
    """

    inputs: Mapping[str, str]
    prefix: str = ""
    places: Mapping[str, Sequence[str]] = field(default_factory=dict)
    tables: list[str] = field(default_factory=list)
    helpers: list[str] = field(default_factory=list)
    _names: dict[Node, str] = field(default_factory=dict)
    _used: set[str] = field(default_factory=set)
    _single: set[Node] = field(default_factory=set)
    _inside: set[Node] = field(default_factory=set)
    types: ClassVar[Mapping[Any, str]] = C_TYPES
    repeats: ClassVar[frozenset[str]] = frozenset()  # operations whose text holds an operand more than once
    reserved: ClassVar[frozenset[str]] = frozenset((
        "short", "long", "signed", "unsigned", "register", "auto", "static", "const", "union", "double", "float",
        "i", "j", "k", "factor",
    ))  # fmt: skip

    def reserve(self, *names: str) -> None:
        """Reserve names that no variable may have."""
        self._used.update(map(self._key, names))

    def plan(self, graph: Graph) -> None:
        """Let a statement be a whole line of Python: it takes up the numbers that only this line needs.

        Arithmetic in single precision stays in statements of its own, because a processor may compute an expression
        more exactly. The results are the same, bit by bit.
        """
        outputs = {source_of(node) for node in graph.outputs.values()}
        readers: dict[Node, list[Node]] = {}
        for node in graph.nodes():
            if regular(node) is None:
                for operand in node.operands:
                    readers.setdefault(source_of(operand), []).append(node)
        for node, readers_of_node in readers.items():
            if len(readers_of_node) == 1 and node not in outputs and self._may_be_inside(node, readers_of_node[0]):
                self._single.add(node)

    def _may_be_inside(self, node: Node, reader: Node) -> bool:
        exact = node.kind != np.float32 or node.operation in _EXACT
        same_size = node.size == reader.size or reader.operation in ("collect", "sum")
        own_line = node.origin == reader.origin or (node.operation == "cast" and not node.name.endswith(SCALED))
        return (
            exact and same_size and own_line and node.operation not in ("matmul", "sum", "collect")
            and reader.operation != "matmul" and reader.operation not in self.repeats
        )  # fmt: skip

    def statements(self, nodes: Sequence[Node], indent: str = "    ") -> list[str]:
        """Statements that compute nodes, operands first; each result gets a variable."""
        lines: list[str] = []
        origin = ""
        for node in nodes:
            written = self._statement(node)
            if written and node.origin and node.origin != origin:
                origin = node.origin
                lines.append(self.comment(origin))
            lines += written
        return [f"{indent}{line}" for line in lines]

    def kept(self, name: str, node: Node, lines: list[str], indent: str = "    ") -> str:
        """A separate variable for a result; statements that define it go to ``lines``."""
        if node in self._names and node.operation not in ("input", "constant"):
            return self._names[node]
        variable = self._new_name(name)
        lines += [f"{indent}{line}" for line in self._assigned(node, variable, self.element(node, "i"))]
        return variable

    def stored(self, target: str, name: str, node: Node, lines: list[str], indent: str = "    ") -> str:
        """A statement that stores a result; statements before it go to ``lines``."""
        return indent + self.copied(target, self.kept(name, node, lines, indent), node.size)

    def element(self, node: Node, index: int | str) -> str:
        """Text of one element; ``index`` is a number, or the text of an index in a loop; of one element always that."""
        index = 0 if node.size == 1 else index
        if node.operation == "constant":
            assert node.table is not None
            if isinstance(index, int):
                return self.number(node.table[index])
            if node not in self._names:
                kind = "constant_table" if node.name == "constant" else node.name
                name = self._names[node] = self._new_name(self.prefix + kind)
                self.tables.append(self.table(name, node.table))
            return f"{self._names[node]}[{index}]"
        if run := regular(node):
            return self.element(run.source, loop_place(run.start, run.step, index))
        if node in self._inside:
            text = self._elementwise(node, index)
            return text if self._is_closed(node) else f"({text})"
        text = self.inputs[node.name] if node.operation == "input" else self._names[node]
        return text if node.size == 1 else f"{text}[{self._place(node, index)}]"

    def _place(self, node: Node, index: int | str) -> int | str:
        """An index, by its name where it has one."""
        names = self.places.get(node.name, ())
        return names[index] if isinstance(index, int) and len(names) == node.size else index

    def _elementwise(self, node: Node, index: int | str) -> str:
        return self._expression(node, [self.element(part, index) for part in node.operands])

    def _statement(self, node: Node) -> list[str]:
        if regular(node) is not None:
            return []
        if node in self._single and len(self._elementwise(node, "i")) <= LONGEST:
            self._inside.add(node)
            return []
        name = self._names[node] = self._new_name(node.name or node.operation)
        special = {"collect": self._collected, "matmul": self._multiplied, "sum": self._summed}.get(node.operation)
        if special is not None:
            return special(node, name)
        return self._assigned(node, name, self._elementwise(node, "i"))

    def _assigned(self, node: Node, name: str, text: str) -> list[str]:
        if node.size == 1:
            return [self.defined(node, name, text)]
        return [*self.declared_array(node, name), self.loop("i", node.size, self.assign(f"{name}[i]", text))]

    def _collected(self, node: Node, name: str) -> list[str]:
        lines = self.declared_array(node, name)
        for run in runs_of_places(node):
            if run.length == 1:
                target = f"{name}[{self._place(node, run.first)}]"
                lines.append(self.assign(target, self.element(run.source, run.start)))
            else:
                text = self.element(run.source, loop_place(run.start, run.step, "i"))
                target = f"{name}[{loop_place(run.first, 1, 'i')}]"
                lines.append(self.loop("i", run.length, self.assign(target, text)))
        return lines

    def _new_name(self, name: str) -> str:
        plain = f"{name}_value" if self._key(name) in self.reserved else name
        unique, number = plain, 1
        while self._key(unique) in self._used:
            number += 1
            unique = f"{plain}_{number}"
        self._used.add(self._key(unique))
        return unique

    # The language -------------------------------------------------------------------------------------------------

    def _key(self, name: str) -> str:
        """By what names differ."""
        return name

    def comment(self, text: str) -> str:
        """A comment."""
        return f"/* {text.replace('*/', '* /').replace('/*', '/ *')} */"

    def number(self, value: Any) -> str:
        """An exact number."""
        return c_operand(value)

    def assign(self, target: str, text: str) -> str:
        """A statement that gives a variable a value."""
        return f"{target} = {text};"

    def loop(self, index: str, count: int, statement: str) -> str:
        """A statement for each index."""
        return f"for (int {index} = 0; {index} < {count}; ++{index}) {statement}"

    def copied(self, target: str, variable: str, size: int) -> str:
        """A statement that copies a variable, or an array of a size."""
        if size == 1:
            return self.assign(target, variable)
        return self.loop("i", size, self.assign(f"{target}[i]", f"{variable}[i]"))

    def declared_array(self, node: Node, name: str) -> list[str]:
        """What stands in front of the statements that fill an array."""
        return [f"{self.types[node.kind]} {name}[{node.size}];"]

    def defined(self, node: Node, name: str, text: str) -> str:
        """A statement that defines a variable."""
        return f"const {self.types[node.kind]} {name} = {text};"

    def table(self, name: str, values: NDArray[Any]) -> str:
        """A constant table."""
        rows = in_rows(self.number, values, 4)
        return f"static const {self.types[values.dtype]} {name}[{values.size}] = {{\n    {rows}\n}};"

    def _is_closed(self, node: Node) -> bool:
        """Whether the text of an operation needs no brackets inside another one."""
        if node.operation in _COMPARED:
            return node.operands[0].kind.kind == "f"
        return node.operation in (*_FUNCTIONS, *_HELPERS) or (node.operation == "cast" and node.kind != np.bool_)

    def _expression(self, node: Node, operands: list[str]) -> str:
        operation, kind = node.operation, node.operands[-1].kind
        suffix = "f" if kind == np.float32 else ""
        if operation in _INFIX:
            return f" {_INFIX[operation]} ".join(operands)
        if operation in _COMPARED:
            if kind.kind == "f":  # the macros of C99 raise no exception for what is not a number
                return f"is{operation.replace('_', '')}({', '.join(map(bare, operands))})"
            return f" {_COMPARED[operation]} ".join(operands)
        if operation in _PREFIX:
            return f"{_PREFIX[operation]}{operands[0]}"
        if operation == "where":
            return f"{operands[0]} ? {operands[1]} : {operands[2]}"
        if operation == "cast":
            return f"{operands[0]} != 0" if node.kind == np.bool_ else f"({C_TYPES[node.kind]}){operands[0]}"
        name = f"{_FUNCTIONS.get(operation, self.prefix + operation)}{suffix}"
        if operation in _HELPERS:
            text = _HELPERS[operation].format(type=C_TYPES[kind], name=name)
            if text not in self.helpers:
                self.helpers.append(text)
        return f"{name}({', '.join(map(bare, operands))})"

    def _multiplied(self, node: Node, name: str) -> list[str]:
        """Sums in the order of the inner index; the innermost loop runs over the columns for vectorisation."""
        (left, right), (rows, inner, columns) = node.operands, node.sizes
        kind = self.types[node.kind]
        if node.size == 1:
            term = f"{self.element(left, 'i')} * {self.element(right, 'i')}"
            return [f"{kind} {name} = 0;", self.loop("i", inner, f"{name} += {term};")]
        at, to = ("i", "j") if rows == 1 else (f"k * {inner} + i", f"k * {columns} + j")
        from_right = "i" if columns == 1 else f"i * {columns} + j"
        # A zero adds nothing if the weights are finite, and half of the outputs of a ReLU layer are zero.
        finite = right.operation == "constant" and right.table is not None and np.isfinite(right.table).all()
        skip = "if (factor != 0) " if finite and columns >= 16 else ""
        term = self.loop("j", columns, f"{name}[{to}] += factor * {self.element(right, from_right)};")
        return [
            *self.declared_array(node, name),
            self.loop("i", node.size, f"{name}[i] = 0;"),
            *([self.loop("k", rows, "").rstrip()] if rows > 1 else []),
            self.loop("i", inner, "{"),
            f"    const {kind} factor = {self.element(left, at)};",
            f"    {skip}{term}",
            "}",
        ]

    def _summed(self, node: Node, name: str) -> list[str]:
        operand, (outer, length, inner) = node.operands[0], node.sizes
        if node.size == 1:
            term = f"{name} += {self.element(operand, 'i')};"
            return [f"{self.types[node.kind]} {name} = 0;", self.loop("i", length, term)]
        term = self.element(operand, f"(k * {length} + i) * {inner} + j")
        return [
            *self.declared_array(node, name),
            self.loop("i", node.size, f"{name}[i] = 0;"),
            self.loop("k", outer, self.loop("i", length, self.loop("j", inner, "").rstrip())),
            f"    {name}[k * {inner} + j] += {term};",
        ]


def bare(text: str) -> str:
    """A text without brackets around all of it."""
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if text[0] == "(" and place == len(text) - 1 else text
    return text


def in_rows(written: Callable[[Any], str], values: NDArray[Any], indent: int) -> str:
    """Values with commas, eight in a line."""
    rows = (", ".join(map(written, values[first : first + 8])) for first in range(0, values.size, 8))
    return f",\n{' ' * indent}".join(rows)


def loop_place(start: int, step: int, index: int | str) -> int | str:
    """The place ``start + step * index``, as a number or as a text."""
    if isinstance(index, int):
        return start + step * index
    if step == 0:
        return start
    if step != 1:
        plain = index.isidentifier() or index.endswith("]")
        index = f"{step} * {index}" if plain else f"{step} * ({index})"
    return index if start == 0 else f"{start} + {index}"
