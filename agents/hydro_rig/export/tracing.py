"""Records the computation of a NumPy function as a graph of plain array operations.

:func:`trace` calls the function once with arrays that record every operation. Any other dependence on the data (an
``if``, an index, a loop's length) would be recorded for these data only; it raises an error. Numbers get the names that
the lines of Python give them.
"""

import inspect
import linecache
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from hydro_env import HydroError
from hydro_env.types import Array
from hydro_rig.export.graph import ELEMENTWISE, KINDS, Builder, Graph, Node

_MOVES = (np.reshape, np.transpose, np.tile, np.repeat, np.roll, np.broadcast_to, np.expand_dims, np.squeeze, np.ravel)
_JOINS = (np.concatenate, np.stack, np.column_stack, np.hstack, np.vstack)
_ASSIGNED = re.compile(r"\s*(?:self\.)?([A-Za-z_]\w*)(?:\[[^\]=]*\])?(?:: [^=]+)? [-+*/@]?= ")
_SAY_LITTLE = ("values", "result", "entries")
_OWN = (__file__, str(Path(np.__file__).parent))


class TraceError(HydroError):
    """A function depends on its data in a way that no fixed graph can represent."""


def trace(function: Callable[..., Mapping[str, Any]], inputs: Mapping[str, Array]) -> Graph:
    """The graph of a function of named arrays that returns named arrays; it is called once, with examples of these.

    The examples have types of :data:`~hydro_rig.export.graph.KINDS`. The graph depends on their shapes alone.

    Raises:
        TraceError: a graph cannot represent the function; the message names the line.
    """
    builder = Builder()
    traced = {
        name: _traced(builder, builder.input(name, np.size(value), value.dtype), value)
        for name, value in inputs.items()
    }
    with np.errstate(all="ignore"):
        results = function(**traced)
    outputs = {
        name: result.node() if isinstance(result, Traced) else builder.constant(result)
        for name, result in results.items()
    }
    return Graph(builder.inputs, outputs)


def named(name: str, value: Any) -> Any:
    """The value; in the written code it has this name."""
    if isinstance(value, Traced) and value.node().operands:
        value.node().name = name
    return value


class Traced(NDArrayOperatorsMixin):
    """An array that records its operations.

    ``_places`` numbers its elements among all those of the builder. Slices, views, joins and changes of parts are those
    of NumPy, on this array; they are no operations. ``_value`` holds the example, for shapes and types.
    """

    def __init__(self, builder: Builder, places: Any, value: Any) -> None:
        self._builder, self._places, self._value = builder, np.asarray(places), np.asarray(value)
        if self._value.dtype not in KINDS:
            raise _refusal(f"an array of {self._value.dtype}")
        self.node()  # the line that makes or changes it gives it a name

    __hash__ = object.__hash__
    shape = property(lambda self: self._value.shape)
    dtype = property(lambda self: self._value.dtype)
    ndim = property(lambda self: self._value.ndim)
    size = property(lambda self: self._value.size)
    T = property(lambda self: self._moved(np.transpose))

    def node(self) -> Node:
        """The node of the graph that holds its elements; the line that runs gives a new one its name."""
        return self._builder.collect(self._places.reshape(-1), self.dtype, **_origin())

    def __len__(self) -> int:
        return len(self._value)

    def __iter__(self) -> Any:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, key: Any) -> "Traced":
        return self._moved(lambda array: array[key])

    def __setitem__(self, key: Any, value: Any) -> None:
        new = self._of(value, self.dtype)
        self._places[key], self._value[key] = new._places, new._value
        self.node()  # the line that makes or changes it gives it a name

    def reshape(self, *shape: Any) -> "Traced":
        """The same elements in another shape."""
        return self._moved(lambda array: array.reshape(*shape))

    def copy(self) -> "Traced":
        """A copy, which may be changed."""
        return Traced(self._builder, self._places.copy(), self._value.copy())

    def astype(self, kind: Any, copy: bool = True) -> "Traced":
        """The values in another type."""
        del copy
        value = self._value.astype(kind)
        if value.dtype == self.dtype:
            return self.copy()
        return self != 0 if value.dtype == np.bool_ else self._result("cast", [self], value)

    def sum(self, axis: int | None = None) -> "Traced":
        """Sum of all elements or along an axis."""
        if axis is None:
            return self.reshape(-1).sum(axis=0)
        value = self._value.sum(axis=axis)
        axis %= self.ndim
        outer, inner = (int(np.prod(part, dtype=int)) for part in (self.shape[:axis], self.shape[axis + 1 :]))
        return self._result("sum", [self], value, sizes=(outer, self.shape[axis], inner))

    def clip(self, low: Any, high: Any) -> Any:
        """The values clipped to low and high."""
        return np.minimum(np.maximum(self, low), high)

    def _refused(self, *_: Any, **__: Any) -> Any:
        raise _refusal("a decision or a number that depends on the data")

    __bool__ = __float__ = __int__ = __index__ = __complex__ = __array__ = item = tolist = any = all = _refused
    nonzero = argmax = argmin = __contains__ = _refused

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, out: Any = None, **options: Any) -> Any:
        if method == "__call__" and not options and ufunc in _COMPOSED:
            result = _COMPOSED[ufunc](*operands)
        elif method == "__call__" and not options and (ufunc in ELEMENTWISE or ufunc is np.matmul):
            result = self._product(*operands) if ufunc is np.matmul else self._elementwise(ufunc, *operands)
        else:
            raise _refusal(f"np.{ufunc.__name__}" + (f".{method}" if method != "__call__" else ""))
        if out is None:
            return result
        target = out[0]
        if not isinstance(target, Traced):
            raise _refusal("a result written into an array that is not traced")
        target[...] = result
        return target

    def _elementwise(self, ufunc: Any, *operands: Any) -> "Traced":
        operands = tuple(np.asarray(operand) if isinstance(operand, list | tuple) else operand for operand in operands)
        kinds = [getattr(operand, "dtype", type(operand)) for operand in operands]
        wanted = ufunc.resolve_dtypes((*kinds, None))
        arrays = []
        for operand, kind in zip(operands, wanted, strict=False):
            if ELEMENTWISE[ufunc] in ("and", "or", "not"):
                kind = np.dtype(np.bool_)
            elif kind.kind == "i" and ufunc in _ORDERS:
                kind = np.dtype(np.float64)
            arrays.append(self._of(operand, kind))
        return self._result(ELEMENTWISE[ufunc], arrays, ufunc(*(array._value for array in arrays)))

    def _product(self, left: Any, right: Any) -> "Traced":
        kind = np.result_type(left.dtype, right.dtype)
        a, b = self._of(left, kind), self._of(right, kind)
        if a.ndim > 2 or b.ndim > 2:
            raise _refusal("a product of more than two dimensions")
        rows, columns = a.shape[0] if a.ndim == 2 else 1, b.shape[1] if b.ndim == 2 else 1
        return self._result("matmul", [a, b], a._value @ b._value, sizes=(rows, a.shape[-1], columns))

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        del types
        if function in _MOVES:
            array, *rest = arguments
            return array._moved(lambda part: function(part, *rest, **options))
        if function in _JOINS:
            return self._joined(function, *arguments, **options)
        if function not in _FUNCTIONS:
            raise _refusal(f"np.{function.__name__}")
        return _FUNCTIONS[function](self, *arguments, **options)

    def _joined(self, function: Any, arrays: Any, dtype: Any = None, **options: Any) -> "Traced":
        kind = dtype or np.result_type(*(array.dtype for array in arrays))
        parts = [self._of(array, kind) for array in arrays]
        places = function([part._places for part in parts], **options)
        value = function([part._value for part in parts], **options)
        return Traced(self._builder, places, value)

    def _of(self, value: Any, kind: Any = None) -> "Traced":
        if isinstance(value, Traced):
            return value if kind is None or value.dtype == kind else value.astype(kind)
        array = np.asarray(value, kind)
        return _traced(self._builder, self._builder.constant(array, _constant_name(value)), array)

    def _result(self, operation: str, operands: "Sequence[Traced]", value: Any, **details: Any) -> "Traced":
        """The result of an operation; without ``sizes`` element by element: of one element of an operand or all."""
        value = np.asarray(value)
        if not details:
            operands = [operand if operand.size == 1 else operand._spread(value.shape) for operand in operands]
        node = self._builder.node(operation, [operand.node() for operand in operands], value, **details, **_origin())
        return _traced(self._builder, node, value)

    def _moved(self, move: Callable[[Array], Array]) -> "Traced":
        """The elements that a function selects or rearranges; a view of NumPy is a view."""
        return Traced(self._builder, move(self._places), move(self._value))

    def _spread(self, shape: tuple[int, ...]) -> "Traced":
        return self if self.size == np.prod(shape, dtype=int) else self._moved(lambda a: np.broadcast_to(a, shape))


def _traced(builder: Builder, node: Node, value: Array) -> Traced:
    """The elements of a node in the shape of the example."""
    return Traced(builder, node.first + np.arange(node.size).reshape(value.shape), value.copy())


def _where_function(self: Traced, condition: Any, yes: Any, no: Any) -> Traced:
    value = np.where(*(part._value if isinstance(part, Traced) else part for part in (condition, yes, no)))
    test, *ways = self._of(condition, np.bool_), self._of(yes, value.dtype), self._of(no, value.dtype)
    table = test.node().table if test.node().operation == "constant" else None
    if table is not None and (table.all() or not table.any()):  # such as the start of an episode
        return ways[0 if table.all() else 1]._moved(lambda array: np.broadcast_to(array, value.shape).copy())
    return self._result("where", [test, *ways], value)


def _einsum(self: Traced, subscripts: str, *operands: Any) -> Any:
    """A product of all operands with one axis per letter, summed over the letters that are not in the result."""
    inputs, _, kept = subscripts.replace(" ", "").partition("->")
    letters = kept + "".join(sorted(set(inputs) - {",", *kept}))
    product: Any = 1
    for number, (names, operand) in enumerate(zip(inputs.split(","), operands, strict=True)):
        if len(set(names)) < len(names) or "->" not in subscripts:
            raise _refusal(f"np.einsum('{subscripts}')")
        order = [names.index(letter) for letter in letters if letter in names]
        spread = tuple(slice(None) if letter in names else None for letter in letters)
        traced: Any = self._of(operand)
        factor = np.transpose(traced, order)[spread]
        product = product * factor if number else factor
    for _ in letters[len(kept) :]:
        product = product.sum(axis=-1)
    return product


def _power(base: Any, exponent: Any) -> Any:
    if isinstance(exponent, int) and exponent == 2:
        return base * base
    traced = base if isinstance(base, Traced) else exponent
    return traced._elementwise(np.power, base, exponent)


def _diff(_: Traced, array: Any, axis: int = -1) -> Any:
    return array._moved(lambda a: np.delete(a, 0, axis)) - array._moved(lambda a: np.delete(a, -1, axis))


_ORDERS = (np.greater, np.greater_equal, np.less, np.less_equal)
_COMPOSED: dict[Any, Callable[..., Any]] = {
    np.square: lambda x: x * x,
    np.power: _power,
    np.not_equal: lambda a, b: np.logical_not(np.equal(a, b)),
    np.maximum: lambda a, b: np.where(np.less(a, b), b, a),  # NaN stays NaN
    np.minimum: lambda a, b: np.where(np.greater(a, b), b, a),
    np.sign: lambda x: np.where(x > 0.0, 1.0, np.where(x < 0.0, -1.0, x)),
    np.copysign: lambda size, sign: np.where(sign < 0.0, -np.absolute(size), np.absolute(size)),
    np.logaddexp: lambda a, b: np.maximum(a, b) + np.log(1.0 + np.exp(-np.absolute(a - b))),
}
"""Functions that are written by others."""

_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where_function,
    np.clip: lambda self, array, low, high: self._of(array).clip(low, high),
    np.sum: lambda self, array, axis=None: self._of(array).sum(axis),
    np.dot: lambda self, left, right: self._product(left, right),
    np.einsum: _einsum,
    np.diff: _diff,
    np.searchsorted: lambda _, edges, values: (values.reshape(-1, 1) > edges).astype(np.int64).sum(axis=1),
    np.zeros_like: lambda self, array, **options: self._of(np.zeros_like(array._value, **options)),
    # NaN reveals an element that is never set.
    np.empty_like: lambda self, array, **options: self._of(np.full_like(array._value, np.nan, **options)),
}


# Names and refusals: the line of Python that runs ---------------------------------------------------------------------


def _caller() -> tuple[Any, str]:
    """The frame of the traced function that runs, and its line."""
    frame: Any = inspect.currentframe()
    while frame.f_code.co_filename.startswith(_OWN):
        frame = frame.f_back
    return frame, linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()


def _origin() -> dict[str, str]:
    """Name and origin of a node: the variable to which the traced line assigns, or the function; and the line.

    The name is empty if the line calls the number ``values`` or the like: then it has the name of its operand.
    """
    frame, line = _caller()
    return _told(frame.f_code.co_filename, frame.f_code.co_name, line)


@cache
def _told(file: str, function: str, line: str) -> dict[str, str]:
    match = _ASSIGNED.match(line)
    name = match[1] if match else re.sub(r"\W", "", function)
    name = "" if match and name in _SAY_LITTLE else name.strip("_") or "value"
    return {"name": name, "origin": f"{Path(file).name}, {function}: {line}"}


def _constant_name(value: Any) -> str:
    """The name by which the traced function or its object knows a constant array; empty if by none."""
    variables = _caller()[0].f_locals
    variables = {**getattr(variables.get("self"), "__dict__", {}), **variables}
    return next((name.strip("_") for name, held in variables.items() if held is value and name != "self"), "")


def _refusal(what: str) -> TraceError:
    frame, line = _caller()
    return TraceError(
        f"{Path(frame.f_code.co_filename).name}, line {frame.f_lineno}: {line}: {what} cannot be exported"
    )
