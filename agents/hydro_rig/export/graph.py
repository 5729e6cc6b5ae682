"""A graph of plain array operations of a traced NumPy function, for the writers of C and ONNX.

Every array is flat. Operations:

* ``input``, ``constant``;
* the functions of :data:`ELEMENTWISE`, element by element; an operand with one element is repeated;
* ``cast`` to another type; ``where``: condition, value if true, value otherwise;
* ``collect``: elements of the concatenated operands at constant indices. It represents every slice, join, transposition
  and assignment to a part of an array;
* ``matmul`` and ``sum``, with the three sizes in ``sizes``: rows, inner, columns; or outer, summed, inner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_rig.export.origin import inherited

ELEMENTWISE = {
    np.add: "add",
    np.subtract: "subtract",
    np.multiply: "multiply",
    np.divide: "divide",
    np.negative: "negative",
    np.absolute: "absolute",
    np.sqrt: "sqrt",
    np.exp: "exp",
    np.log: "log",
    np.power: "power",
    np.tanh: "tanh",
    np.arcsinh: "arcsinh",
    np.sign: "sign",
    np.copysign: "copysign",
    np.maximum: "maximum",
    np.minimum: "minimum",
    np.equal: "equal",
    np.greater: "greater",
    np.greater_equal: "greater_equal",
    np.less: "less",
    np.less_equal: "less_equal",
    np.logical_and: "and",
    np.logical_or: "or",
    np.logical_not: "not",
    np.bitwise_and: "and",
    np.bitwise_or: "or",
    np.invert: "not",
    np.not_equal: "not_equal",
}
"""Name of the operation of each NumPy function that works element by element."""

KINDS = tuple(np.dtype(kind) for kind in (np.float64, np.float32, np.int64, np.bool_))


@dataclass(eq=False)
class Node:
    """One operation and its result, a flat array."""

    operation: str
    operands: tuple[Node, ...]
    size: int
    kind: np.dtype[Any]
    table: NDArray[Any] | None = None  # values of a constant, indices of a collect
    sizes: tuple[int, int, int] = (1, 1, 1)  # of matmul and sum
    name: str = ""
    origin: str = ""  # its line of Python

    def piece(self, place: int) -> tuple[Node, int]:
        """The operand of a ``collect`` that provides an element, and its index there."""
        assert self.table is not None
        offset = int(self.table[place])
        for source in self.operands:
            if offset < source.size:
                return source, offset
            offset -= source.size
        raise AssertionError("a place beyond the operands")


@dataclass(frozen=True)
class Graph:
    """Named inputs and outputs; everything between follows from the outputs."""

    inputs: dict[str, Node]
    outputs: dict[str, Node]

    def nodes(self, outputs: Sequence[Node] | None = None) -> list[Node]:
        """The operations that some outputs need (default: all), operands first; no inputs, no constants."""
        return in_order([*(self.outputs.values() if outputs is None else outputs)])

    def used(self, outputs: Sequence[Node]) -> dict[str, NDArray[np.bool_]]:
        """Whether some outputs depend on each element of each input, (size,) each."""
        wanted = {id(node): np.ones(node.size, dtype=np.bool_) for node in outputs}

        def want(node: Node, elements: NDArray[np.bool_]) -> None:
            before = wanted.setdefault(id(node), np.zeros(node.size, dtype=np.bool_))
            before |= elements if node.size == elements.size else elements.any()

        for node in reversed(self.nodes(outputs)):
            elements = wanted[id(node)]
            if node.operation == "collect":
                joined = np.zeros(sum(one.size for one in node.operands), dtype=np.bool_)
                joined[node.table[elements]] = True  # type: ignore[index]
                ends = np.cumsum([one.size for one in node.operands])[:-1]
                for one, part in zip(node.operands, np.split(joined, ends), strict=True):
                    want(one, part)
            elif node.operation == "sum":
                outer, length, inner = node.sizes
                want(node.operands[0], elements.reshape(outer, 1, inner).repeat(length, axis=1).reshape(-1))
            else:
                for one in node.operands:
                    want(one, np.array([elements.any()]) if node.operation == "matmul" else elements)
        return {name: wanted.get(id(node), np.zeros(node.size, dtype=np.bool_)) for name, node in self.inputs.items()}


def runs_of_places(node: Node) -> list[tuple[int, int, Node, int, int]]:
    """A ``collect`` as stretches with equal steps: first element, length, operand, first index in it, step."""
    runs: list[tuple[int, int, Node, int, int]] = []
    for element in range(node.size):
        source, place = node.piece(element)
        if runs:
            first, length, before, start, step = runs[-1]
            wanted = place - start if length == 1 else step
            if before is source and place == start + length * wanted:
                runs[-1] = (first, length + 1, before, start, wanted)
                continue
        runs.append((element, 1, source, place, 0))
    return runs


def source_of(node: Node) -> Node:
    """The node of which a node is a regular part, or itself."""
    found = regular(node) if node.operation == "collect" else None
    return node if found is None else source_of(found[0])


def regular(node: Node) -> tuple[Node, int, int] | None:
    """Operand, start and step of a ``collect`` that is a single stretch, which needs no separate array."""
    runs = runs_of_places(node) if node.size < 4096 else []
    return (runs[0][2], runs[0][3], runs[0][4]) if len(runs) == 1 else None


def in_order(outputs: Sequence[Node]) -> list[Node]:
    """The operations that some nodes need, operands first; no inputs, no constants."""
    found: dict[int, Node] = {}
    waiting = [*reversed(outputs)]
    while waiting:
        node = waiting[-1]
        missing = [one for one in node.operands if id(one) not in found]
        if id(node) in found or not missing:
            waiting.pop()
            found[id(node)] = node
        else:
            waiting += reversed(missing)
    return [node for node in found.values() if node.operation not in ("input", "constant")]


@dataclass
class Builder:
    """Makes nodes: it evaluates constants, merges nested ``collect`` nodes, and keeps equal nodes only once."""

    inputs: dict[str, Node] = field(default_factory=dict)
    _known: dict[Any, Node] = field(default_factory=dict)

    def input(self, name: str, size: int, kind: np.dtype[Any]) -> Node:
        """A new input."""
        self.inputs[name] = Node("input", (), size, kind, name=name)
        return self.inputs[name]

    def constant(self, values: Any, name: str = "constant") -> Node:
        """A constant, flattened."""
        table = np.ascontiguousarray(values).reshape(-1)
        return self._once(Node("constant", (), table.size, table.dtype, table, name=name))

    def node(self, operation: str, operands: Sequence[Node], value: NDArray[Any], **details: Any) -> Node:
        """An operation; ``value`` is its result for the values of the trace."""
        if all(one.operation == "constant" for one in operands):
            return self.constant(value, details.get("name") or "constant")
        details["name"] = details.get("name") or inherited(operands, details.get("origin", ""))
        return self._once(Node(operation, tuple(operands), value.size, value.dtype, **details))

    def collect(self, operands: Sequence[Node], places: NDArray[np.int64], **details: Any) -> Node:
        """Elements of the concatenated operands at ``places``, (size,)."""
        starts = np.cumsum([0, *(one.size for one in operands)])
        which = np.searchsorted(starts, places, side="right") - 1
        offsets = places - starts[which]
        sources: dict[int, Node] = {}
        pieces: list[tuple[int, int]] = []  # of each element: source, place in it
        for number, offset in zip(which.tolist(), offsets.tolist(), strict=True):
            source = operands[number]
            if source.operation == "collect":
                source, offset = source.piece(offset)
            sources[id(source)] = source
            pieces.append((id(source), offset))
        first = dict(zip(sources, np.cumsum([0, *(one.size for one in sources.values())]).tolist(), strict=False))
        table = np.array([first[number] + offset for number, offset in pieces], dtype=np.int64)
        joined = tuple(sources.values())
        if len(joined) == 1 and np.array_equal(table, np.arange(joined[0].size)):
            return joined[0]
        if all(one.operation == "constant" for one in joined):
            values = np.concatenate([one.table for one in joined if one.table is not None])
            return self.constant(values[table], details.get("name") or "constant")
        details["name"] = details.get("name") or inherited(joined, details.get("origin", ""))
        return self._once(Node("collect", joined, table.size, joined[0].kind, table, **details))

    def _once(self, node: Node) -> Node:
        table = None if node.table is None else (node.table.tobytes(), node.table.dtype.str)
        key = (node.operation, tuple(id(one) for one in node.operands), node.kind.str, table, node.sizes)
        return self._known.setdefault(key, node)

    def graph(self, outputs: Mapping[str, Node]) -> Graph:
        """The graph of some outputs."""
        return Graph(dict(self.inputs), dict(outputs))
