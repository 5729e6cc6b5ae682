"""Records the computation of a NumPy function as a graph of plain array operations.

:func:`trace` calls the function once with arrays that record every operation. Any other dependence on the data (an
``if``, an index, a loop's length) would be recorded for these data only; it raises an error. Numbers get the names that
the lines of Python give them.
"""

from __future__ import annotations

import inspect
import linecache
import re
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from hydro_env import HydroError
from hydro_rig.export.graph import ELEMENTWISE, KINDS, Builder, Graph, Node

_MOVES = (np.reshape, np.transpose, np.tile, np.repeat, np.roll, np.broadcast_to, np.expand_dims, np.squeeze, np.ravel)
_JOINS = (np.concatenate, np.stack, np.column_stack, np.hstack, np.vstack)
_ASSIGNED = re.compile(r"\s*(?:self\.)?([A-Za-z_]\w*)(?:\[[^\]=]*\])?(?:: [^=]+)? [-+*/@]?= ")
_SAY_LITTLE = ("values", "result", "entries")
_OWN = (__file__, str(Path(np.__file__).parent))


class TraceError(HydroError):
    """A function depends on its data in a way that no fixed graph can represent."""


def trace(function: Callable[..., Mapping[str, Any]], inputs: Mapping[str, NDArray[Any]]) -> Graph:
    """The graph of a function of named arrays that returns named arrays.

    Args:
        function: called once, with the inputs as keywords.
        inputs: an example of each input, of the types of :data:`~hydro_rig.export.graph.KINDS`. The graph
            does not depend on their values, only on their shapes.

    Raises:
        TraceError: a graph cannot represent the function; the message names the line.
    """
    builder = Builder()
    traced, outputs = {}, {}
    for name, value in inputs.items():
        traced[name] = Traced(builder, builder.input(name, np.size(value), value.dtype), value)
    with np.errstate(all="ignore"):
        results = function(**traced)
    for name, result in results.items():
        outputs[name] = result._node if isinstance(result, Traced) else builder.constant(result)
    return Graph(builder.inputs, outputs)


def named(name: str, value: Any) -> Any:
    """The value; in the written code it has this name."""
    if isinstance(value, Traced) and value._node.operation not in ("input", "constant"):
        value._node.name = name
    return value


class Traced(NDArrayOperatorsMixin):
    """An array that records its operations; it also holds the example's values, for shapes and types."""

    def __init__(self, builder: Builder, node: Node, value: Any, parent: Traced | None = None, key: Any = None) -> None:
        self._builder, self._node, self._value = builder, node, np.asarray(value)
        self._parent, self._key = parent, key  # of a view: its base
        self._views: list[weakref.ref[Traced]] = []
        if parent is not None:
            parent._views.append(weakref.ref(self))
        if self._value.dtype not in KINDS:
            raise _refusal(f"an array of {self._value.dtype}")

    __hash__ = object.__hash__
    shape = property(lambda self: self._value.shape)
    dtype = property(lambda self: self._value.dtype)
    ndim = property(lambda self: self._value.ndim)
    size = property(lambda self: self._value.size)
    T = property(lambda self: self._moved(np.transpose, view=True))

    def __len__(self) -> int:
        return len(self._value)

    def __iter__(self) -> Any:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, key: Any) -> Traced:
        _check_index(key)
        view = np.shares_memory(self._value[key], self._value)
        return self._moved(lambda places: places[key], view, key if view else None)

    def __setitem__(self, key: Any, value: Any) -> None:
        _check_index(key)
        if isinstance(value, Traced) and value._parent is self and value._key == key:
            return  # the last part of a[key] += b, which has already changed the view a[key]
        self._assign(key, value, None)

    def _assign(self, key: Any, value: Any, writer: Traced | None) -> None:
        places = np.arange(self.size).reshape(self.shape)
        new = self._of(value, self.dtype)
        written = self._value.copy()
        written[key] = new._value
        places[key] = self.size + np.arange(new.size).reshape(new.shape)
        self._replace(self._collected([self, new], places, written), writer)

    def reshape(self, *shape: Any) -> Traced:
        """The same elements in another shape."""
        return self._moved(lambda places: places.reshape(*shape), view=True)

    def copy(self) -> Traced:
        """A copy, which may be changed."""
        return Traced(self._builder, self._node, self._value.copy())

    def astype(self, kind: Any, copy: bool = True) -> Traced:
        """The values in another type."""
        del copy
        value = self._value.astype(kind)
        if value.dtype == self.dtype:
            return self.copy()
        return self != 0 if value.dtype == np.bool_ else self._result("cast", [self], value)

    def sum(self, axis: int | None = None) -> Traced:
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
        target._replace(result.astype(target.dtype), target)
        return target

    def _elementwise(self, ufunc: Any, *operands: Any) -> Traced:
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

    def _product(self, left: Any, right: Any) -> Traced:
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
            return self._of(array)._moved(lambda places: function(places, *rest, **options), view=True)
        if function in _JOINS:
            return self._joined(function, *arguments, **options)
        if function not in _FUNCTIONS:
            raise _refusal(f"np.{function.__name__}")
        return _FUNCTIONS[function](self, *arguments, **options)

    def _joined(self, function: Any, arrays: Any, dtype: Any = None, **options: Any) -> Traced:
        kind = dtype or np.result_type(*(array.dtype for array in arrays))
        parts = [self._of(array, kind) for array in arrays]
        starts = np.cumsum([0, *(part.size for part in parts)])
        numbered = [
            start + np.arange(part.size).reshape(part.shape) for start, part in zip(starts, parts, strict=False)
        ]
        value = function([part._value for part in parts], **options)
        return self._collected(parts, function(numbered, **options), value)

    def _of(self, value: Any, kind: Any = None) -> Traced:
        """A value as a traced array of a type."""
        if isinstance(value, Traced):
            return value if kind is None or value.dtype == kind else value.astype(kind)
        array = np.asarray(value, dtype=kind)
        return Traced(self._builder, self._builder.constant(array, _constant_name(value)), array)

    def _result(self, operation: str, operands: Sequence[Traced], value: Any, **details: Any) -> Traced:
        """The result of an operation; without ``sizes`` element by element: of one element of an operand or all."""
        value = np.asarray(value)
        spread = operands if details else [operand._spread(value.shape) for operand in operands]
        node = self._builder.node(operation, [operand._node for operand in spread], value, **details, **_where())
        return Traced(self._builder, node, value)

    def _collected(self, parts: Sequence[Traced], places: NDArray[Any], value: Any, *of: Any) -> Traced:
        """Elements of the joined parts at some places; ``of``: the array of which it is a view, and the key."""
        node = self._builder.collect([part._node for part in parts], places.reshape(-1), **_where())
        return Traced(self._builder, node, value, *of)

    def _moved(self, move: Callable[[NDArray[Any]], NDArray[Any]], view: bool = False, key: Any = None) -> Traced:
        """The elements that a function selects or rearranges."""
        places = np.asarray(move(np.arange(self.size).reshape(self.shape)))
        return self._collected([self], places, self._value.reshape(-1)[places], self if view else None, key)

    def _spread(self, shape: tuple[int, ...]) -> Traced:
        size = int(np.prod(shape, dtype=int))
        return self if self.size in (1, size) else self._moved(lambda places: np.broadcast_to(places, shape))

    def _replace(self, new: Traced, writer: Traced | None) -> None:
        """Change this array in place, and the array of which it is a view; another view must not be in use."""
        for reference in self._views:
            view = reference()
            if view is not None and view is not writer:
                raise _refusal("a change of an array while another name refers to a part of it")
        every = np.zeros(self.size, dtype=np.int64)
        node = new._node if new.size == self.size else self._builder.collect([new._node], every)
        value = np.broadcast_to(new._value, self.shape).copy()
        if self._parent is not None:
            if self._key is None:
                raise _refusal("a change of a reshaped array")
            self._parent._assign(self._key, Traced(self._builder, node, value), self)
        self._node, self._value = node, value


def _check_index(key: Any) -> None:
    parts = key if isinstance(key, tuple) else (key,)
    if any(isinstance(part, Traced) for part in parts):
        raise _refusal("an index that depends on the data")


def _where_function(self: Traced, condition: Any, yes: Any, no: Any) -> Traced:
    value = np.where(*(part._value if isinstance(part, Traced) else part for part in (condition, yes, no)))
    test, *ways = self._of(condition, np.bool_), self._of(yes, value.dtype), self._of(no, value.dtype)
    table = test._node.table if test._node.operation == "constant" else None
    if table is not None and (table.all() or not table.any()):  # such as the start of an episode
        return ways[0 if table.all() else 1]._moved(lambda places: np.broadcast_to(places, value.shape))
    return self._result("where", [test, *ways], value)


def _einsum(self: Traced, subscripts: str, *operands: Any) -> Any:
    """A product of all operands with one axis per letter, summed over the letters that are not in the result."""
    inputs, _, kept = subscripts.replace(" ", "").partition("->")
    letters = kept + "".join(sorted(set(inputs) - {",", *kept}))
    product: Any = 1
    for number, (names, operand) in enumerate(zip(inputs.split(","), operands, strict=True)):
        if len(set(names)) < len(names):
            raise _refusal(f"np.einsum('{subscripts}')")
        order = [names.index(letter) for letter in letters if letter in names]
        spread = tuple(slice(None) if letter in names else None for letter in letters)
        move = lambda places, order=order, spread=spread: places.transpose(order)[spread]  # noqa: E731
        factor = self._of(operand)._moved(move)
        product = product * factor if number else factor
    for _ in letters[len(kept) :]:
        product = product.sum(axis=-1)
    return product


def _power(base: Any, exponent: Any) -> Any:
    if isinstance(exponent, int) and exponent == 2:
        return base * base
    traced = base if isinstance(base, Traced) else exponent
    return traced._elementwise(np.power, base, exponent)


def _diff(self: Traced, array: Any, n: int = 1, axis: int = -1) -> Any:
    if n != 1:
        raise _refusal(f"np.diff with n = {n}")
    before, after = ([slice(None)] * self._of(array).ndim for _ in range(2))
    before[axis], after[axis] = slice(None, -1), slice(1, None)
    return array[tuple(after)] - array[tuple(before)]


def _filled(number: float) -> Callable[..., Traced]:
    def filled(self: Traced, array: Any, dtype: Any = None, shape: Any = None) -> Traced:
        return self._of(np.full(array.shape if shape is None else shape, number, dtype=dtype or array.dtype))

    return filled


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
    np.copy: lambda self, array: self._of(array).copy(),
    np.dot: lambda self, left, right: self._product(left, right),
    np.einsum: _einsum,
    np.diff: _diff,
    np.outer: lambda self, left, right: self._of(left).reshape(-1, 1) * self._of(right).reshape(1, -1),
    np.searchsorted: lambda _, edges, values: (values.reshape(-1, 1) > edges).astype(np.int64).sum(axis=1),
    np.zeros_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.empty_like: _filled(np.nan),  # NaN reveals an element that is never set
    np.shape: lambda self, array: self._of(array).shape,
    np.ndim: lambda self, array: self._of(array).ndim,
}


# Names and refusals: the line of Python that runs ---------------------------------------------------------------------


def _caller() -> tuple[Any, str]:
    """The frame of the traced function that runs, and its line."""
    frame: Any = inspect.currentframe()
    while frame.f_code.co_filename.startswith(_OWN):
        frame = frame.f_back
    return frame, linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()


def _where() -> dict[str, str]:
    """Name and origin of a node: the variable to which the traced line assigns, or the function; and the line.

    The name is empty if the line calls the number ``values`` or the like: then it has the name of its operand.
    """
    frame, line = _caller()
    return _told(frame.f_code.co_filename, frame.f_code.co_name, line)


@cache
def _told(file: str, function: str, line: str) -> dict[str, str]:
    return {"name": _assigned(line, function), "origin": f"{Path(file).name}, {function}: {line}"}


def _assigned(line: str, function: str) -> str:
    match = _ASSIGNED.match(line)
    name = match.group(1) if match else function
    return "" if match and name in _SAY_LITTLE else re.sub(r"\W", "", name).strip("_") or "value"


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
