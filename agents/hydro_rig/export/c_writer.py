"""Writes a graph of array operations as C99 statements: plain loops over arrays of fixed size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydro_rig.export.graph import Graph, Node, regular, runs_of_places, source_of
from hydro_rig.export.origin import SCALED

C_TYPES = {np.dtype(np.float64): "double", np.dtype(np.float32): "float", np.dtype(np.bool_): "int"}
C_TYPES[np.dtype(np.int64)] = "long"
_INFIX = {
    "add": "+",
    "subtract": "-",
    "multiply": "*",
    "divide": "/",
    "equal": "==",
    "greater": ">",
    "greater_equal": ">=",
    "less": "<",
    "less_equal": "<=",
    "not_equal": "!=",
    "and": "&&",
    "or": "||",
}
_PREFIX = {"negative": "-", "not": "!"}
_FUNCTIONS = {
    "absolute": "fabs",
    "sqrt": "sqrt",
    "exp": "exp",
    "log": "log",
    "power": "pow",
    "tanh": "tanh",
    "arcsinh": "asinh",
    "copysign": "copysign",
}
_HELPERS = {
    # As in NumPy: the first value unless the other one is larger (smaller); NaN stays NaN.
    "maximum": "static {type} {name}({type} a, {type} b) {{ return a >= b || a != a ? a : b; }}",
    "minimum": "static {type} {name}({type} a, {type} b) {{ return a <= b || a != a ? a : b; }}",
    "sign": "static {type} {name}({type} a) {{ return a > 0 ? 1 : a < 0 ? -1 : a; }}",
}
_RESERVED = {"short", "long", "signed", "unsigned", "register", "auto", "static", "const", "union", "double", "float"}
_INDICES = ("i", "j", "k")
_EXACT = {"where", "cast", "maximum", "minimum", "absolute", "sign", "copysign", "negative"}
LONGEST = 120
"""Characters of the longest number that is written into the statement of another one."""


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
    _names: dict[int, str] = field(default_factory=dict)
    _used: set[str] = field(default_factory=set)
    _single: set[int] = field(default_factory=set)
    _inside: set[int] = field(default_factory=set)
    repeats: ClassVar[frozenset[str]] = frozenset()  # operations whose text holds an operand more than once

    def reserve(self, *names: str) -> None:
        """Reserve names that no variable may have."""
        self._used.update(names)

    def plan(self, graph: Graph) -> None:
        """Let a statement be a whole line of Python: it takes up the numbers that only this line needs.

        Arithmetic in single precision stays in statements of its own, because a processor may compute an expression
        more exactly. The results are the same, bit by bit.
        """
        outputs = {id(source_of(node)) for node in graph.outputs.values()}
        readers: dict[int, list[Node]] = {}
        for node in graph.nodes():
            if node.operation != "collect" or regular(node) is None:
                for one in node.operands:
                    readers.setdefault(id(source_of(one)), []).append(node)
        for node in graph.nodes():
            mine = readers.get(id(node), [])
            if len(mine) == 1 and id(node) not in outputs and self._may_be_inside(node, mine[0]):
                self._single.add(id(node))

    def _may_be_inside(self, node: Node, reader: Node) -> bool:
        exact = node.kind != np.float32 or node.operation in _EXACT
        same_size = node.size == reader.size or reader.operation in ("collect", "sum")
        own_line = node.origin == reader.origin or (node.operation == "cast" and not node.name.endswith(SCALED))
        return (
            exact and same_size and own_line and node.operation not in ("matmul", "sum", "collect")
            and reader.operation != "matmul" and reader.operation not in self.repeats
        )  # fmt: skip

    def statements(self, nodes: Sequence[Node], indent: str = "    ") -> list[str]:
        """C statements that compute nodes, operands first; each result gets a variable."""
        lines: list[str] = []
        origin = ""
        for node in nodes:
            written = self._statement(node)
            if written and node.origin and node.origin != origin:
                origin = node.origin
                lines.append(self.comment(origin))
            lines += written
        return [f"{indent}{line}" for line in lines]

    def comment(self, text: str) -> str:
        """A comment."""
        return f"/* {text.replace('*/', '* /').replace('/*', '/ *')} */"

    def number(self, value: Any) -> str:
        """An exact number."""
        return number(value)

    def named_begins(self, text: str) -> str:
        """The variable ``begins`` for a condition that has another name."""
        return f"const int begins = {text};"

    def assign(self, target: str, text: str) -> str:
        """A statement that gives a variable a value."""
        return f"{target} = {text};"

    def copied(self, target: str, variable: str, size: int) -> str:
        """A statement that copies a variable, or an array of a size."""
        if size == 1:
            return self.assign(target, variable)
        return f"{_loop('i', size)} {target}[i] = {variable}[i];"

    def kept(self, name: str, node: Node) -> tuple[str, list[str]]:
        """A separate variable for a result, and the statements that define it."""
        if id(node) in self._names and node.operation not in ("input", "constant"):
            return self._names[id(node)], []
        variable = self._new_name(name)
        copied = f"{self.element(node, 'i' if node.size > 1 else 0)}"
        return variable, self._assigned(C_TYPES[node.kind], variable, node.size, copied)

    def element(self, node: Node, index: int | str) -> str:
        """Text of one element; ``index`` is a number, or the text of an index in a loop."""
        if node.operation == "input":
            text = self.inputs[node.name]
            return text if node.size == 1 else f"{text}[{self._place(node.name, index)}]"
        if node.operation == "constant":
            assert node.table is not None
            if node.size == 1 or isinstance(index, int):
                return self.number(node.table[index if isinstance(index, int) else 0])
            return f"{self._table(node)}[{index}]"
        if node.operation == "collect":
            taken = regular(node)
            if taken is not None:
                source, start, step = taken
                return self.element(source, loop_place(start, step, index))
            if isinstance(index, int):
                return self.element(*node.piece(index))
        if id(node) in self._inside:
            text = self._elementwise(node, index)
            return text if self._is_closed(node) else f"({text})"
        if node.size == 1:
            return self._names[id(node)]
        return f"{self._names[id(node)]}[{self._place(node.name, index)}]"

    def _place(self, name: str, index: int | str) -> int | str:
        """An index, by its name where it has one."""
        return self.places[name][index] if isinstance(index, int) and name in self.places else index

    def _elementwise(self, node: Node, index: int | str) -> str:
        return self._expression(node, [self.element(one, 0 if one.size == 1 else index) for one in node.operands])

    def _is_closed(self, node: Node) -> bool:
        """Whether the text of an operation needs no brackets inside another one."""
        return node.operation in (*_FUNCTIONS, *_HELPERS) or (node.operation == "cast" and node.kind != np.bool_)

    # Statements of one node ---------------------------------------------------------------------------------------

    def _statement(self, node: Node) -> list[str]:
        if node.operation == "collect" and regular(node) is not None:
            return []
        if id(node) in self._single and len(self._elementwise(node, "i")) <= LONGEST:
            self._inside.add(id(node))
            return []
        kind, name = C_TYPES[node.kind], self._new_name(node.name or node.operation)
        self._names[id(node)] = name
        if node.operation == "collect":
            return self._collected(node, kind, name)
        if node.operation == "matmul":
            return self._multiplied(node, kind, name)
        if node.operation == "sum":
            return self._summed(node, kind, name)
        return self._assigned(kind, name, node.size, self._elementwise(node, 0 if node.size == 1 else "i"))

    def _assigned(self, kind: str, name: str, size: int, text: str) -> list[str]:
        if size == 1:
            return [f"const {kind} {name} = {text};"]
        return [f"{kind} {name}[{size}];", f"{_loop('i', size)} {name}[i] = {text};"]

    def _expression(self, node: Node, operands: list[str]) -> str:
        operation, kind = node.operation, node.operands[-1].kind
        suffix = "f" if kind == np.float32 else ""
        if operation in _INFIX:
            return f" {_INFIX[operation]} ".join(operands)
        if operation in _PREFIX:
            return f"{_PREFIX[operation]}{operands[0]}"
        if operation in _FUNCTIONS:
            return f"{_FUNCTIONS[operation]}{suffix}({', '.join(map(bare, operands))})"
        if operation in _HELPERS:
            name = f"{self.prefix}{operation}{suffix}"
            text = _HELPERS[operation].format(type=C_TYPES[kind], name=name)
            if text not in self.helpers:
                self.helpers.append(text)
            return f"{name}({', '.join(map(bare, operands))})"
        if operation == "where":
            return f"{operands[0]} ? {operands[1]} : {operands[2]}"
        if operation == "cast":
            return f"{operands[0]} != 0" if node.kind == np.bool_ else f"({C_TYPES[node.kind]}){operands[0]}"
        raise AssertionError(operation)

    def _collected(self, node: Node, kind: str, name: str) -> list[str]:
        lines = [f"{kind} {name}[{node.size}];"]
        runs = runs_of_places(node)
        if len(runs) > 12 and len(node.operands) == 1:
            places = self._place_table(node)
            return [*lines, f"{_loop('i', node.size)} {name}[i] = {self.element(node.operands[0], f'{places}[i]')};"]
        for first, length, source, start, step in runs:
            if length == 1:
                lines.append(f"{name}[{self._place(node.name, first)}] = {self.element(source, start)};")
            else:
                text = self.element(source, loop_place(start, step, "i") if source.size > 1 else 0)
                lines.append(f"{_loop('i', length)} {name}[{loop_place(first, 1, 'i')}] = {text};")
        return lines

    def _multiplied(self, node: Node, kind: str, name: str) -> list[str]:
        """Sums in the order of the inner index; the innermost loop runs over the columns for vectorisation."""
        (left, right), (rows, inner, columns) = node.operands, node.sizes
        if node.size == 1:
            term = f"{self.element(left, 'i' if inner > 1 else 0)} * {self.element(right, 'i' if inner > 1 else 0)}"
            return [f"{kind} {name} = 0;", f"{_loop('i', inner)} {name} += {term};"]
        at = "i" if rows == 1 else f"k * {inner} + i"
        to = "j" if rows == 1 else f"k * {columns} + j"
        from_right = "i" if columns == 1 else f"i * {columns} + j"
        lines = [f"{kind} {name}[{node.size}];", f"{_loop('i', node.size)} {name}[i] = 0;"]
        if rows > 1:
            lines.append(_loop("k", rows))
        # A zero adds nothing if the weights are finite, and half of the outputs of a ReLU layer are zero.
        finite = right.operation == "constant" and right.table is not None and np.isfinite(right.table).all()
        skip = "if (factor != 0) " if finite and columns >= 16 else ""
        return [
            *lines,
            f"{_loop('i', inner)} {{",
            f"    const {kind} factor = {self.element(left, at if left.size > 1 else 0)};",
            f"    {skip}{_loop('j', columns)} {name}[{to}] += factor * {self.element(right, from_right)};",
            "}",
        ]

    def _summed(self, node: Node, kind: str, name: str) -> list[str]:
        operand, (outer, length, inner) = node.operands[0], node.sizes
        if node.size == 1:
            return [f"{kind} {name} = 0;", f"{_loop('i', length)} {name} += {self.element(operand, 'i')};"]
        to, at = f"k * {inner} + j", f"(k * {length} + i) * {inner} + j"
        return [
            f"{kind} {name}[{node.size}];",
            f"{_loop('i', node.size)} {name}[i] = 0;",
            f"{_loop('k', outer)} {_loop('i', length)} {_loop('j', inner)}",
            f"    {name}[{to}] += {self.element(operand, at)};",
        ]

    # Names and tables ---------------------------------------------------------------------------------------------

    def _new_name(self, name: str) -> str:
        plain = name if name not in (*_RESERVED, *_INDICES, "factor") else f"{name}_value"
        unique = next(one for one in (plain, *(f"{plain}_{n}" for n in range(2, 10_000))) if one not in self._used)
        self._used.add(unique)
        return unique

    def _table(self, node: Node) -> str:
        if id(node) not in self._names:
            assert node.table is not None
            self._names[id(node)] = self._new_table(node.name, C_TYPES[node.kind], node.table)
        return self._names[id(node)]

    def _place_table(self, node: Node) -> str:
        assert node.table is not None
        return self._new_table(f"places_of_{node.name}", "int", node.table)

    def _new_table(self, name: str, kind: str, values: NDArray[Any]) -> str:
        unique = self._new_name(self.prefix + (f"{name}_table" if name == "constant" else name))
        texts = [self.number(value) for value in values]
        rows = [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]
        body = ",\n    ".join(rows)
        self.tables.append(f"static const {kind} {unique}[{len(texts)}] = {{\n    {body}\n}};")
        return unique


def bare(text: str) -> str:
    """A text without brackets around all of it."""
    depth, ends = 0, []
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        ends += [place] * (depth == 0)
    return text[1:-1] if text.startswith("(") and ends == [len(text) - 1] else text


def number(value: Any) -> str:
    """An exact number in C: the shortest text that reads back as the same number."""
    if isinstance(value, np.bool_ | bool | np.integer):
        return str(int(value))
    suffix = "f" if isinstance(value, np.float32) else ""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = f"{value!s}{suffix}"
    return f"({text})" if text.startswith("-") else text


def _loop(index: str, count: int) -> str:
    return f"for (int {index} = 0; {index} < {count}; ++{index})"


def loop_place(start: int, step: int, index: int | str) -> int | str:
    """The place ``start + step * index``, as a number or as a text."""
    if isinstance(index, int) or step == 0:
        return start + step * index if isinstance(index, int) else start
    plain = index.isidentifier() or index.endswith("]")
    scaled = index if step == 1 else f"{step} * {index if plain else f'({index})'}"
    return scaled if start == 0 else f"{start} + {scaled}"
