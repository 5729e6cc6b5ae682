"""A graph of plain array operations of a traced NumPy function, for the writers of C and ONNX.

Every array is flat. Operations:

* ``input``, ``constant``;
* the functions of :data:`ELEMENTWISE`, element by element; an operand with one element is repeated;
* ``cast`` to another type; ``where``: condition, value if true, value otherwise;
* ``collect``: elements of the concatenated operands at constant indices. It represents every slice, join, transposition
  and assignment to a part of an array;
* ``matmul`` and ``sum``, with the three sizes in ``sizes``: rows, inner, columns; or outer, summed, inner.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydro_env.types import Array

_UFUNCS = (
    np.add, np.subtract, np.multiply, np.divide, np.negative, np.absolute, np.sqrt, np.exp, np.log, np.power, np.tanh,
    np.arcsinh, np.equal, np.greater, np.greater_equal, np.less, np.less_equal,
)  # fmt: skip
ELEMENTWISE: dict[Any, str] = {function: function.__name__ for function in _UFUNCS}
ELEMENTWISE |= dict.fromkeys((np.logical_and, np.bitwise_and), "and")
ELEMENTWISE |= dict.fromkeys((np.logical_or, np.bitwise_or), "or")
ELEMENTWISE |= dict.fromkeys((np.logical_not, np.invert), "not")
"""Name of the operation of each NumPy function that works element by element."""

SCALED = "_scaled"  # ends the name of an entry of the observation, without unit; the same number in SI has none
Kind = np.dtype[Any]  # of the numbers of a node
KINDS = DOUBLE, SINGLE, *_ = tuple(np.dtype(kind) for kind in (np.float64, np.float32, np.int64, np.bool_))


@dataclass(eq=False, repr=False)  # a graph in words would be as long as all its paths
class Node:
    """One operation and its result, a flat array."""

    operation: str
    operands: "tuple[Node, ...]"
    size: int
    kind: Kind
    table: Array | None = None  # values of a constant, indices of a collect
    sizes: tuple[int, int, int] = (1, 1, 1)  # of matmul and sum
    name: str = ""
    origin: str = ""  # its line of Python
    first: int = 0  # number of its first element among all those of its builder

    @cached_property
    def runs(self) -> "list[EvenRun]":
        """A ``collect`` as stretches with equal steps."""
        assert self.table is not None
        pieces = [(source, place) for source in self.operands for place in range(source.size)]
        runs: list[EvenRun] = []
        for element, number in enumerate(self.table):
            source, place = pieces[number]
            if runs:
                run = runs[-1]
                step = place - run.start if run.length == 1 else run.step
                if run.source is source and place == run.start + run.length * step:
                    runs[-1] = run._replace(length=run.length + 1, step=step)
                    continue
            runs.append(EvenRun(element, 1, source, place, 0))
        return runs

    @property
    def is_part(self) -> bool:
        """Whether it is a ``collect`` of a single stretch, which needs no array of its own."""
        return self.operation == "collect" and len(self.runs) == 1

    @property
    def whole(self) -> "Node":
        """The node of which it is a part, or itself."""
        return self.runs[0].source if self.is_part else self


class EvenRun(NamedTuple):
    """Elements of a ``collect`` that come from one operand with equal steps."""

    first: int
    length: int
    source: Node
    start: int  # index in the source
    step: int


class Graph(NamedTuple):
    """Named inputs and outputs; everything between follows from the outputs."""

    inputs: dict[str, Node]
    outputs: dict[str, Node]

    def nodes(self) -> list[Node]:
        """All operations, operands first; no inputs, no constants."""
        return in_order([*self.outputs.values()])


def in_order(outputs: Sequence[Node]) -> list[Node]:
    """The operations that some nodes need, operands first; no inputs, no constants."""
    done: dict[Node, None] = {}
    waiting = [*reversed(outputs)]
    while waiting:
        missing = [operand for operand in waiting[-1].operands if operand not in done]
        if waiting[-1] in done or not missing:
            done.setdefault(waiting.pop())
        else:
            waiting += reversed(missing)
    return [node for node in done if node.operands]


def in_single(graph: Graph) -> Graph:
    """The same operations in single precision."""
    made: dict[Node, Node] = {}
    constants = [node for node in needed([*graph.outputs.values()]) if node.operation == "constant"]
    for node in (*graph.inputs.values(), *constants, *graph.nodes()):
        kind = SINGLE if node.kind == DOUBLE else node.kind
        table = node.table.astype(kind) if node.operation == "constant" and node.table is not None else node.table
        operands = tuple(made[operand] for operand in node.operands)
        same = node.operation == "cast" and operands[0].kind == kind
        made[node] = operands[0] if same else replace(node, operands=operands, kind=kind, table=table)
    inputs, outputs = ({name: made[node] for name, node in part.items()} for part in (graph.inputs, graph.outputs))
    return Graph(inputs, outputs)


def needed(outputs: Sequence[Node]) -> set[Node]:
    """Every node on which some nodes depend, and themselves."""
    return {*outputs, *(operand for node in in_order(outputs) for operand in node.operands)}


@dataclass
class Builder:
    """Makes nodes: it evaluates constants, numbers all elements, and keeps equal nodes only once."""

    inputs: dict[str, Node] = field(default_factory=dict)
    _made: dict[Any, Node] = field(default_factory=dict)
    _elements: list[tuple[Node, int]] = field(default_factory=list)  # of inputs, constants and results

    def input(self, name: str, size: int, kind: Kind) -> Node:
        """A new input."""
        self.inputs[name] = self._numbered(Node("input", (), size, kind, name=name))
        return self.inputs[name]

    def constant(self, values: Any, name: str = "") -> Node:
        """A constant, flattened."""
        table = np.ascontiguousarray(values).reshape(-1)
        return self._once(Node("constant", (), table.size, table.dtype, table, name=name or "constant"))

    def node(self, operation: str, operands: Sequence[Node], value: Array, **details: Any) -> Node:
        """An operation; ``value`` is its result for the values of the trace."""
        if all(operand.operation == "constant" for operand in operands):
            return self.constant(value, details.get("name", ""))
        return self._once(Node(operation, tuple(operands), value.size, value.dtype, **details))

    def collect(self, numbers: Array, kind: Kind, **details: Any) -> Node:
        """The node that holds some elements, by their numbers, (size,)."""
        pieces: list[tuple[Node, int]] = [self._elements[number] for number in numbers]
        firsts = {}
        total = 0
        for source, _ in pieces:
            if source not in firsts:
                firsts[source] = total
                total += source.size
        table = np.array([firsts[source] + offset for source, offset in pieces], np.int64)
        if len(firsts) == 1 and np.array_equal(table, np.arange(total)):
            return pieces[0][0]
        if all(source.operation == "constant" for source in firsts):
            values = [source.table[offset] for source, offset in pieces if source.table is not None]
            return self.constant(np.array(values, kind), details.get("name", ""))
        return self._once(Node("collect", tuple(firsts), table.size, kind, table, **details))

    def _once(self, node: Node) -> Node:
        table = None if node.table is None else (node.table.tobytes(), node.table.dtype.str)
        key = (node.operation, node.operands, node.kind.str, table, node.sizes)
        if key not in self._made:
            node.name = node.name or inherited(node.operands, node.origin)
            self._made[key] = self._numbered(node)
        return self._made[key]

    def _numbered(self, node: Node) -> Node:
        node.first = len(self._elements)
        self._elements += [(node, offset) for offset in range(node.size)]
        return node


def inherited(operands: Collection[Node], origin: str) -> str:
    """Name of a number whose line of Python gives it none: that of its only operand, or its function."""
    names = {operand.name.removesuffix(SCALED) for operand in operands if operand.operands}
    return names.pop() if len(names) == 1 else re.sub(r"\W", "", origin.split(": ")[0].split(", ")[-1]).strip("_")
