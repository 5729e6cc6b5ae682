"""Records the computation of a NumPy function as a graph of plain array operations.

:func:`trace` calls the function once with arrays that record every operation. Any other dependence on the data (an
``if``, an index, a loop's length) would be recorded for these data only; it raises an error.
"""

from __future__ import annotations

import linecache
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from hydro_env import HydroError
from hydro_rig.export.graph import ELEMENTWISE, KINDS, Builder, Graph, Node
from hydro_rig.export.origin import caller, constant_name, where

_MOVES = (np.reshape, np.transpose, np.tile, np.repeat, np.roll, np.broadcast_to, np.expand_dims, np.squeeze, np.ravel)
_JOINS = (np.concatenate, np.stack, np.column_stack, np.hstack, np.vstack)


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
    traced = {
        name: Traced(builder, builder.input(name, np.size(value), value.dtype), value) for name, value in inputs.items()
    }
    with np.errstate(all="ignore"):
        results = function(**traced)
    outputs = {
        name: result._node if isinstance(result, Traced) else builder.constant(result)
        for name, result in results.items()
    }
    return builder.graph(outputs)


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

    # What NumPy arrays have ---------------------------------------------------------------------------------------

    __hash__ = object.__hash__
    shape = property(lambda self: self._value.shape)
    dtype = property(lambda self: self._value.dtype)
    ndim = property(lambda self: self._value.ndim)
    size = property(lambda self: self._value.size)

    @property
    def T(self) -> Traced:  # noqa: N802
        """Transposed."""
        return self._moved(np.transpose, view=True)

    def __len__(self) -> int:
        return len(self._value)

    def __iter__(self) -> Any:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, key: Any) -> Traced:
        if _holds_traced(key):
            raise _refusal("an index that depends on the data")
        view = np.shares_memory(self._value[key], self._value)
        return self._moved(lambda places: places[key], view, key if view else None)

    def __setitem__(self, key: Any, value: Any) -> None:
        if _holds_traced(key):
            raise _refusal("an index that depends on the data")
        if isinstance(value, Traced) and value._parent is self and value._key == key:
            return  # the last part of a[key] += b, which has already changed the view a[key]
        self._assign(key, value, None)

    def _assign(self, key: Any, value: Any, writer: Traced | None) -> None:
        places = np.arange(self.size).reshape(self.shape)
        new = self._of(value, self.dtype)
        written = self._value.copy()
        written[key] = new._value
        places[key] = self.size + np.arange(new.size).reshape(new.shape)
        node = self._builder.collect([self._node, new._node], places.reshape(-1), **where())
        self._replace(node, written, writer)

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
        return Traced(self._builder, self._builder.node("cast", [self._node], value, **where()), value)

    def sum(self, axis: int | None = None) -> Traced:
        """Sum of all elements or along an axis."""
        if axis is None:
            return self.reshape(-1).sum(axis=0)
        value = self._value.sum(axis=axis)
        axis %= self.ndim
        outer, inner = (int(np.prod(part, dtype=int)) for part in (self.shape[:axis], self.shape[axis + 1 :]))
        sizes = (outer, self.shape[axis], inner)
        if sizes[1] == 1:
            return Traced(self._builder, self._node, value)
        return Traced(self._builder, self._builder.node("sum", [self._node], value, sizes=sizes, **where()), value)

    def clip(self, low: Any, high: Any) -> Any:
        """The values clipped to low and high."""
        return np.minimum(np.maximum(self, low), high)

    def _refused(self, *_: Any, **__: Any) -> Any:
        raise _refusal("a decision or a number that depends on the data")

    __bool__ = __float__ = __int__ = __index__ = __complex__ = __array__ = item = tolist = any = all = _refused
    nonzero = argmax = argmin = __contains__ = _refused

    # NumPy's functions --------------------------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, out: Any = None, **options: Any) -> Any:
        if ufunc is np.logaddexp and method == "__call__" and not options:
            return np.maximum(*operands) + np.log(1.0 + np.exp(-np.absolute(operands[0] - operands[1])))
        if ufunc is np.square or (ufunc is np.power and isinstance(operands[1], int) and operands[1] == 2):
            ufunc, operands = np.multiply, (operands[0], operands[0])
        if method != "__call__" or options or not (ufunc in ELEMENTWISE or ufunc is np.matmul):
            raise _refusal(f"np.{ufunc.__name__}" + (f".{method}" if method != "__call__" else ""))
        result = self._product(*operands) if ufunc is np.matmul else self._elementwise(ufunc, *operands)
        if out is None:
            return result
        if not isinstance(out[0], Traced):
            raise _refusal("a result written into an array that is not traced")
        target, result = out[0], result.astype(out[0].dtype)
        target._replace(result._node, np.broadcast_to(result._value, target.shape).copy(), target)
        return target

    def _elementwise(self, ufunc: Any, *operands: Any) -> Traced:
        operands = tuple(np.asarray(one) if isinstance(one, list | tuple) else one for one in operands)
        kinds = [one.dtype if isinstance(one, Traced | np.ndarray | np.generic) else type(one) for one in operands]
        wanted = ufunc.resolve_dtypes((*kinds, None))
        logical = ELEMENTWISE[ufunc] in ("and", "or", "not")
        arrays = [self._of(one, np.bool_ if logical else kind) for one, kind in zip(operands, wanted, strict=False)]
        value = ufunc(*(one._value for one in arrays))
        nodes = [one._spread(value.shape)._node for one in arrays]
        return Traced(self._builder, self._builder.node(ELEMENTWISE[ufunc], nodes, value, **where()), value)

    def _product(self, left: Any, right: Any) -> Traced:
        kind = np.result_type(*(one.dtype for one in (left, right)))
        a, b = self._of(left, kind), self._of(right, kind)
        if a.ndim > 2 or b.ndim > 2:
            raise _refusal("a product of more than two dimensions")
        rows, columns = a.shape[0] if a.ndim == 2 else 1, b.shape[1] if b.ndim == 2 else 1
        value = a._value @ b._value
        sizes = (rows, a.shape[-1], columns)
        return Traced(
            self._builder, self._builder.node("matmul", [a._node, b._node], np.asarray(value), sizes=sizes, **where()),
            value,
        )  # fmt: skip

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        del types
        if function in _MOVES:
            array, *rest = arguments
            return self._of(array)._moved(lambda places: function(places, *rest, **options), view=True)
        if function in _JOINS:
            return self._joined(function, *arguments, **options)
        own = _FUNCTIONS.get(function)
        if own is None:
            raise _refusal(f"np.{function.__name__}")
        return own(self, *arguments, **options)

    def _joined(self, function: Any, arrays: Any, dtype: Any = None, **options: Any) -> Traced:
        kind = dtype or np.result_type(*(one.dtype for one in arrays))
        parts = [self._of(one, kind) for one in arrays]
        starts = np.cumsum([0, *(one.size for one in parts)])
        numbered = [start + np.arange(one.size).reshape(one.shape) for start, one in zip(starts, parts, strict=False)]
        places = function(numbered, **options)
        value = function([one._value for one in parts], **options)
        node = self._builder.collect([one._node for one in parts], places.reshape(-1), **where())
        return Traced(self._builder, node, value)

    # Inside -------------------------------------------------------------------------------------------------------

    def _of(self, value: Any, kind: Any = None) -> Traced:
        """A value as a traced array of a type."""
        if isinstance(value, Traced):
            return value if kind is None or value.dtype == kind else value.astype(kind)
        array = np.asarray(value, dtype=kind)
        return Traced(self._builder, self._builder.constant(array, constant_name(value) or "constant"), array)

    def _moved(self, move: Callable[[NDArray[Any]], NDArray[Any]], view: bool = False, key: Any = None) -> Traced:
        """The elements that a function selects or rearranges."""
        places = np.asarray(move(np.arange(self.size).reshape(self.shape)))
        node = self._builder.collect([self._node], places.reshape(-1), **where())
        value = self._value.reshape(-1)[places.reshape(-1)].reshape(places.shape)
        return Traced(self._builder, node, value, self if view else None, key)

    def _spread(self, shape: tuple[int, ...]) -> Traced:
        """The operand of an operation with a result of this shape: one element or all."""
        size = int(np.prod(shape, dtype=int))
        return self if self.size in (1, size) else self._moved(lambda places: np.broadcast_to(places, shape))

    def _replace(self, node: Node, value: NDArray[Any], writer: Traced | None) -> None:
        """Change this array in place, and the array of which it is a view; another view must not be in use."""
        for reference in self._views:
            view = reference()
            if view is not None and view is not writer:
                raise _refusal("a change of an array while another name refers to a part of it")
        if self._parent is not None:
            if self._key is None:
                raise _refusal("a change of a reshaped array")
            self._parent._assign(self._key, Traced(self._builder, node, value), self)
        size = self._builder.collect([node], np.zeros(self.size, dtype=np.int64)) if node.size != self.size else node
        self._node, self._value = size, value


def _holds_traced(key: Any) -> bool:
    return any(isinstance(one, Traced) for one in (key if isinstance(key, tuple) else (key,)))


def _where_function(self: Traced, condition: Any, yes: Any, no: Any) -> Traced:
    holders = [one._value if isinstance(one, Traced) else one for one in (condition, yes, no)]
    value = np.where(*holders)
    test, *values = self._of(condition, np.bool_), self._of(yes, value.dtype), self._of(no, value.dtype)
    known = test._node.table if test._node.operation == "constant" else None
    if known is not None and (known.all() or not known.any()):  # such as the start of an episode
        chosen = values[0] if known.all() else values[1]
        return chosen._moved(lambda places: np.broadcast_to(places, value.shape))
    nodes = [one._spread(value.shape)._node for one in (test, *values)]
    return Traced(self._builder, self._builder.node("where", nodes, value, **where()), value)


def _einsum(self: Traced, subscripts: str, *operands: Any) -> Traced:
    """A product of all operands with one axis per letter, summed over the letters that are not in the result."""
    given, _, kept = subscripts.replace(" ", "").partition("->")
    letters = kept + "".join(sorted(set(given) - {",", *kept}))
    product: Any = None
    for names, operand in zip(given.split(","), operands, strict=True):
        if len(set(names)) < len(names):
            raise _refusal(f"np.einsum('{subscripts}')")
        array = self._of(operand)
        order = sorted(range(len(names)), key=lambda axis, names=names: letters.index(names[axis]))  # type: ignore[misc]
        spread = tuple(slice(None) if letter in names else None for letter in letters)
        factor = array._moved(lambda places, order=order, spread=spread: places.transpose(order)[spread])  # type: ignore[misc]
        product = factor if product is None else product * factor
    for _ in letters[len(kept) :]:
        product = product.sum(axis=-1)
    return product  # type: ignore[no-any-return]


def _diff(self: Traced, array: Any, n: int = 1, axis: int = -1) -> Any:
    if n != 1:
        raise _refusal(f"np.diff with n = {n}")
    before, after = ([slice(None)] * self._of(array).ndim for _ in range(2))
    before[axis], after[axis] = slice(None, -1), slice(1, None)
    return array[tuple(after)] - array[tuple(before)]


def _filled(number: float) -> Callable[..., Traced]:
    def filled(self: Traced, array: Any, dtype: Any = None, shape: Any = None) -> Traced:
        kind, size = dtype or array.dtype, array.shape if shape is None else shape
        return self._of(np.full(size, number, dtype=kind))

    return filled


def _searchsorted(self: Traced, edges: Any, values: Any) -> Any:
    return (values.reshape(-1, 1) > edges).astype(np.int64).sum(axis=1)


def _outer(self: Traced, left: Any, right: Any) -> Any:
    return self._of(left).reshape(-1, 1) * self._of(right).reshape(1, -1)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where_function,
    np.clip: lambda self, array, low, high: self._of(array).clip(low, high),
    np.sum: lambda self, array, axis=None: self._of(array).sum(axis),
    np.copy: lambda self, array: self._of(array).copy(),
    np.dot: lambda self, left, right: self._product(left, right),
    np.einsum: _einsum,
    np.diff: _diff,
    np.outer: _outer,
    np.searchsorted: _searchsorted,
    np.zeros_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.empty_like: _filled(np.nan),  # NaN reveals an element that is never set
    np.shape: lambda self, array: self._of(array).shape,
    np.ndim: lambda self, array: self._of(array).ndim,
}


def _refusal(what: str) -> TraceError:
    frame = caller()
    place = ""
    if frame is not None:
        file, line = frame.f_code.co_filename, frame.f_lineno
        place = f"{Path(file).name}, line {line}: {linecache.getline(file, line).strip()}: "
    return TraceError(f"{place}{what} cannot be exported")
