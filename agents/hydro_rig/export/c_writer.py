"""Writes a graph of array operations as statements: plain loops over arrays of fixed size; and what makes them C99."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hydro_rig.export.c_files import c_number
from hydro_rig.export.graph import KINDS, Graph, Kind, Node

LONGEST = 120  # characters of the longest number that is written into the statement of another one


class Language(NamedTuple):
    """How a language writes things: texts for ``str.format``."""

    types: Mapping[Any, str]
    operations: Mapping[str, str]  # {0} … an operand beside others, {a} … alone; {to}, {of}: types; {f}: see C
    number: Callable[[Any], str]
    assign: str  # variable, text
    loop: str  # index, count, statement, last
    variable: str  # type, name
    array: str  # type, name, size, last
    table: str  # type, name, size, last, numbers
    comment: str
    reserved: frozenset[str]  # in small letters
    declares_first: bool  # all variables before all statements
    repeats: frozenset[str] = frozenset()  # operations whose text holds an operand more than once


ARITHMETIC = {
    "add": "{0} + {1}", "subtract": "{0} - {1}", "multiply": "{0} * {1}", "divide": "{0} / {1}", "negative": "-{0}",
}  # fmt: skip
C_OPERATIONS = ARITHMETIC | {
    "and": "{0} && {1}", "or": "{0} || {1}", "not": "!{0}", "equal": "{0} == {1}",
    # The macros of C99 raise no exception for what is not a number.
    "greater": "isgreater({a}, {b})", "greater_equal": "isgreaterequal({a}, {b})",
    "less": "isless({a}, {b})", "less_equal": "islessequal({a}, {b})",
    "where": "{0} ? {1} : {2}", "cast": "({to}){0}",
    # The suffix f is that of functions in single precision.
    "absolute": "fabs{f}({a})", "sqrt": "sqrt{f}({a})", "exp": "exp{f}({a})", "log": "log{f}({a})",
    "power": "pow{f}({a}, {b})", "tanh": "tanh{f}({a})", "arcsinh": "asinh{f}({a})",
}  # fmt: skip
C = Language(
    types=dict(zip(KINDS, ("double", "float", "long", "int"), strict=True)),
    operations=C_OPERATIONS,
    number=c_number,
    assign="{} = {};",
    loop="for (int {0} = 0; {0} < {1}; ++{0}) {2}",
    variable="{} {};",
    array="{} {}[{}];",
    table="static const {0} {1}[{2}] = {{\n    {4}\n}};",
    comment="/* {} */",
    reserved=frozenset(("short", "long", "signed", "register", "auto", "static", "const", "double", "i", "j", "k")),
    declares_first=False,
)


@dataclass
class Writer:
    """Writes statements of a language, and collects the constant tables and declarations that they need.

    A statement is a whole line of Python: it takes up the numbers that only this line needs. Arithmetic in single
    precision stays in statements of its own, because a processor may compute an expression more exactly.
    """

    graph: Graph
    inputs: Mapping[str, str]  # text of each input of the graph, by name; for an array without index
    language: Language = C
    taken: Sequence[str] = ()  # further names that no variable may have
    prefix: str = ""  # of the names of tables, for a file that contains others
    tables: list[str] = field(default_factory=list)
    declared: list[str] = field(default_factory=list)  # where the language wants them first
    work: dict[str, tuple[Kind, int]] = field(default_factory=dict)  # there: arrays that several values share
    _names: dict[Node, str] = field(default_factory=dict)
    _inside: set[Node] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._used = {name.lower() for name in self.taken} | self.language.reserved
        self._kept = Counter(node.whole for node in self.graph.outputs.values())
        self._free: list[str] = []  # of ``work``
        self._readers: dict[Node, list[Node]] = {}
        for node in self.graph.nodes():
            if not node.is_part:
                for operand in node.operands:
                    self._readers.setdefault(operand.whole, []).append(node)
        self._unread = self._kept + Counter({node: len(readers) for node, readers in self._readers.items()})

    def statements(self, nodes: Sequence[Node]) -> list[str]:
        """Statements that compute nodes, operands first; each result gets a variable."""
        lines = []
        origin = ""
        for node in nodes:
            written = self._statement(node)
            if written and node.origin and node.origin != origin:
                origin = node.origin
                plain = re.sub(r"/\*|\*/|\(\*|\*\)", lambda mark: " ".join(mark[0]), origin)
                lines.append(self.language.comment.format(plain))
            lines += written
        return lines

    def kept(self, name: str, node: Node, lines: list[str]) -> str:
        """A separate variable for a result; statements that define it go to ``lines``."""
        if node in self._names and node.operation != "constant":
            return self._names[node]
        variable = self._new_name(name)
        lines += self._defined(node, variable, self.element(node, "i"))
        return variable

    def stored(self, target: str, variable: str, size: int) -> str:
        """A statement that copies a variable, or an array of a size."""
        if size == 1:
            return self.language.assign.format(target, variable)
        return self._loop("i", size, self.language.assign.format(f"{target}[i]", f"{variable}[i]"))

    def element(self, node: Node, index: int | str) -> str:
        """Text of one element; ``index`` is a number, or the text of an index in a loop; of one element always that."""
        index = 0 if node.size == 1 else index
        if node.operation == "constant":
            assert node.table is not None
            if isinstance(index, int):
                return self.language.number(node.table[index])
            if node not in self._names:
                name = self._new_name(self.prefix + ("constant_table" if node.name == "constant" else node.name))
                self._names[node] = name
                self.tables.append(self.table(name, node.kind, node.table))
            return f"{self._names[node]}[{index}]"
        if node.is_part:
            run = node.runs[0]
            return self.element(run.source, _place(run.start, run.step, index))
        if node in self._inside:
            return self._expression(node, index)
        text = self.inputs[node.name] if node.operation == "input" else self._names[node]
        return text if node.size == 1 else f"{text}[{index}]"

    def table(self, name: str, kind: Kind, values: np.ndarray[Any, Any]) -> str:
        """A declaration of constants."""
        numbers = [self.language.number(value).removeprefix("REAL#") for value in values]  # the array has the type
        rows = [", ".join(numbers[first : first + 8]) for first in range(0, len(numbers), 8)]
        size = len(numbers)
        return self.language.table.format(self.language.types[kind], name, size, size - 1, ",\n    ".join(rows))

    def _statement(self, node: Node) -> list[str]:
        if node.is_part:
            return []
        if self._may_be_inside(node) and len(self._expression(node, "i")) <= LONGEST:
            self._inside.add(node)
            return []
        shared = self.language.declares_first and node.size > 1
        name = self._names[node] = self._shared(node) if shared else self._new_name(node.name or node.operation)
        if node.operation == "collect":
            lines = self._collected(node, name)
        elif node.operation in ("matmul", "sum"):
            lines = self._total(node, name)
        else:
            lines = self._defined(node, name, self._expression(node, "i"))
        self.release(*node.operands)
        return lines

    def _shared(self, node: Node) -> str:
        """An array that nothing needs any more, or a new one, for a value."""
        fitting = [name for name in self._free if self.work[name][0] == node.kind]
        if not fitting:
            name = self._new_name("work")
            self.work[name] = (node.kind, node.size)
            return name
        name = min(fitting, key=lambda one: abs(self.work[one][1] - node.size))
        self._free.remove(name)
        self.work[name] = (node.kind, max(self.work[name][1], node.size))
        return name

    def release(self, *nodes: Node) -> None:
        """One reader of some nodes is done: free the arrays of which it was the last one."""
        for node in nodes:
            whole = node.whole
            if whole in self._inside:
                self.release(*whole.operands)
            elif whole in self._names and self._names[whole] in self.work:
                self._unread[whole] -= 1
                if not self._unread[whole]:
                    self._free.append(self._names[whole])

    def _may_be_inside(self, node: Node) -> bool:
        """Whether only one other statement of the same line of Python needs a number, and it stays as exact there."""
        readers = self._readers.get(node, [])
        if len(readers) != 1 or node in self._kept or node.operation in ("matmul", "sum", "collect"):
            return False
        reader = readers[0]
        if reader.operation == "matmul" or reader.operation in self.language.repeats:
            return False
        same_size = node.size == reader.size or reader.operation in ("collect", "sum")
        exact = node.kind != np.float32 or node.operation in ("where", "cast", "absolute", "negative")
        return same_size and exact and (self.language.declares_first or node.origin == reader.origin)

    def _expression(self, node: Node, index: int | str) -> str:
        texts = [self.element(operand, index) for operand in node.operands]
        kinds = {"to": self.language.types[node.kind], "of": self.language.types[node.operands[-1].kind]}
        suffix = "f" if node.operands[-1].kind == np.float32 else ""
        template = self.language.operations[node.operation]
        return template.format(*map(beside, texts), **dict(zip("abc", texts, strict=False)), **kinds, f=suffix)

    def _defined(self, node: Node, name: str, text: str) -> list[str]:
        """Statements that define a variable, or each element of an array."""
        language = self.language
        if node.size == 1 and not language.declares_first:
            return [f"const {language.types[node.kind]} {language.assign.format(name, text)}"]
        target = name if node.size == 1 else f"{name}[i]"
        statement = language.assign.format(target, text)
        return [*self._declaration(node, name), self._loop("i", node.size, statement)]

    def _declaration(self, node: Node, name: str) -> list[str]:
        text = declaration(self.language, name, node.size, node.kind)
        if name in self.work:
            return []
        if not self.language.declares_first:
            return [text]
        self.declared.append(text)
        return []

    def _collected(self, node: Node, name: str) -> list[str]:
        lines = self._declaration(node, name)
        for run in node.runs:
            index = 0 if run.length == 1 else "i"
            text = self.element(run.source, _place(run.start, run.step, index))
            statement = self.language.assign.format(f"{name}[{_place(run.first, 1, index)}]", text)
            lines.append(self._loop("i", run.length, statement))
        return lines

    def _total(self, node: Node, name: str) -> list[str]:
        """Sums over ``i``; the innermost loop runs over the columns, so that their sums do not wait for each other."""
        k, i, j = digits = tuple(zip("kij", node.sizes, strict=True))
        if node.operation == "sum":
            term = beside(self.element(node.operands[0], _mixed(digits)))
        else:
            left, right = node.operands
            term = f"{beside(self.element(left, _mixed((k, i))))} * {beside(self.element(right, _mixed((i, j))))}"
        into = name if node.size == 1 else f"{name}[{_mixed((k, j))}]"
        statement = self.language.assign.format(into, f"{into} + {term}")
        for index, count in reversed(digits):
            statement = self._loop(index, count, statement)
        zero = self.language.number(node.kind.type(0))
        begin = self.language.assign.format(name if node.size == 1 else f"{name}[i]", zero)
        return [*self._declaration(node, name), self._loop("i", node.size, begin), statement]

    def _loop(self, index: str, count: int, statement: str) -> str:
        return statement if count == 1 else self.language.loop.format(index, count, statement, count - 1)

    def _new_name(self, name: str) -> str:
        plain = f"{name}_value" if name.lower() in self.language.reserved else name
        unique, number = plain, 1
        while unique.lower() in self._used:
            number += 1
            unique = f"{plain}_{number}"
        self._used.add(unique.lower())
        return unique


def declaration(language: Language, name: str, size: int, kind: Kind) -> str:
    """A variable, or an array of a size."""
    text = language.variable if size == 1 else language.array
    return text.format(language.types[kind], name, size, size - 1)


def beside(text: str) -> str:
    """A text beside an operator: in brackets if it holds one itself."""
    depth = 0
    for letter in text:
        depth += (letter in "([") - (letter in ")]")
        if letter == " " and depth == 0:
            return f"({text})"
    return f"({text})" if text.startswith("-") else text


def _place(start: int, step: int, index: int | str) -> int | str:
    """The place ``start + step * index``, as a number or as a text."""
    if isinstance(index, int):
        return start + step * index
    if step == 0:
        return start
    text = index if step == 1 else f"{step} * {beside(index)}"
    return text if start == 0 else f"{start} + {text}"


def _mixed(digits: Sequence[tuple[str, int]]) -> int | str:
    """Place of an element in a flat array, by indices and their counts."""
    text = ""
    for index, count in digits:
        if count > 1:
            text = f"{beside(text)} * {count} + {index}" if text else index
    return text or 0
