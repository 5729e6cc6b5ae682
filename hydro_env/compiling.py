"""How this package compiles: numba when it is there and allowed, with a cache that notices every change.

A kernel is one function that numba compiles, optimises and keeps on disk. What it is made of (:func:`inline`,
:func:`part`, :func:`tuple_reader`) is only translated for it: numba by itself would also optimise each of these
functions, generate its machine code and wrap it for Python, nine tenths of which nobody ever calls.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import cgutils, config, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, DefaultPassBuilder
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

Function = TypeVar("Function", bound=Callable[..., Any])

STRICT: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}
"""IEEE arithmetic as written (bit-reproducible), divisions like NumPy's, other Python threads may run."""


def inline(function: Function) -> Function:
    """Compile a scalar function that is always merged into its caller, so that loops over it vectorise."""
    return part(function, forceinline=True)


def part(function: Function, **options: Any) -> Function:
    """Compile a function, or the function of a kernel, as a part of the kernels that call it.

    Called from Python it is compiled on its own, at its first call.
    """
    function = getattr(function, "py_func", function)
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return cast("Function", _Part(function, options))


def compiled(function: Function) -> Function:
    """Compile a kernel and keep the machine code on disk, where a folder can be written.

    Numba keys its cache on the kernel's own file and on its closure. A kernel that merges functions of other
    files therefore takes their :func:`source_stamp` as a closure variable.
    """
    try:
        return cast("Function", numba.njit(cache=True, pipeline_class=_KernelCompiler, **STRICT)(function))
    except RuntimeError:  # no folder for the cache can be written
        return cast("Function", numba.njit(cache=False, pipeline_class=_KernelCompiler, **STRICT)(function))


def source_stamp(*sources: str) -> int:
    """A number that changes whenever one of the source files (paths inside the package) changes."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sources:
        digest.update((package / source).read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")


def tuple_reader(kind: type, first: int = 0) -> Callable[..., Any]:
    """A compiled function ``read(array)`` that reads a one-dimensional array, from index ``first`` on.

    The result is a named tuple ``kind`` of float64.
    """
    reader = lane_reader(kind, first, 1)
    return part(lambda array: reader(array, 0), forceinline=True)


def lane_reader(kind: type, first_row: int, lanes: int) -> Callable[..., Any]:
    """A compiled function ``read(array, lane)`` that reads one lane of rows of ``lanes`` elements, from a row on.

    The array is one-dimensional, the result a named tuple ``kind`` of float64. For every element that such a function
    reads by an index, numba would infer and check types; here the loads are written down directly.
    """
    rows = range(first_row, first_row + len(kind._fields))  # type: ignore[attr-defined]
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return lambda array, lane: kind(*(array[row * lanes + lane] for row in rows))
    result = types.NamedUniTuple(types.float64, len(rows), kind)

    @intrinsic
    def read(typing_context: Any, array: Any, lane: Any) -> Any:
        del typing_context
        if not isinstance(array, types.Array) or array.ndim != 1 or array.dtype != types.float64:
            return None

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            place = _lane_of(context, builder, signature.args[0], arguments[0], arguments[1], lanes)
            values = [builder.load(place(row)) for row in rows]
            return context.make_tuple(builder, result, values)

        return result(array, types.intp), generate

    return cast("Callable[..., Any]", read)


def lane_writer(first_row: int, count: int, lanes: int) -> Callable[..., Any]:
    """A compiled function ``write(array, lane, values)``, the inverse of :func:`lane_reader` for a tuple of values."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]

        def write_one_by_one(array: Any, lane: int, values: Any) -> None:
            for row, value in enumerate(values, first_row):
                array[row * lanes + lane] = value

        return write_one_by_one

    @intrinsic
    def write(typing_context: Any, array: Any, lane: Any, values: Any) -> Any:
        del typing_context

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            place = _lane_of(context, builder, signature.args[0], arguments[0], arguments[1], lanes)
            for index in range(count):
                value = builder.extract_value(arguments[2], index)
                value = context.cast(builder, value, signature.args[2].types[index], types.float64)
                builder.store(value, place(first_row + index))
            return context.get_dummy_value()

        return types.none(array, types.intp, values), generate

    return cast("Callable[..., Any]", write)


def lane_combination(
    result: int, terms: Sequence[tuple[float, int]], count: int, lanes: int, base: int | None = None, factor: int = 0
) -> Callable[..., Any]:
    """A compiled function ``combine(array, lane)``: result ← base + factor · Σ weight · rows, in one lane.

    Written down directly for the same reason as :func:`lane_reader`.

    Args:
        result: first row of the ``count`` rows that are written.
        terms: (weight, first row) of what is added up.
        count: number of rows.
        lanes: lanes per row.
        base: first row of what the sum is added to; ``None`` is zero.
        factor: the row (one for all) that multiplies the sum.
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]

        def combine_one_by_one(array: Any, lane: int) -> None:
            for row in range(count):
                total = sum(weight * array[(first + row) * lanes + lane] for weight, first in terms)
                start = 0.0 if base is None else array[(base + row) * lanes + lane]
                array[(result + row) * lanes + lane] = start + array[factor * lanes + lane] * total

        return combine_one_by_one

    @intrinsic
    def combine(typing_context: Any, array: Any, lane: Any) -> Any:
        del typing_context

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            place = _lane_of(context, builder, signature.args[0], arguments[0], arguments[1], lanes)
            scale = builder.load(place(factor))
            for row in range(count):
                total = None
                for weight, first in terms:
                    constant = context.get_constant(types.float64, weight)
                    term = builder.fmul(constant, builder.load(place(first + row)), flags=("contract",))
                    total = term if total is None else builder.fadd(total, term, flags=("contract",))
                total = builder.fmul(scale, total, flags=("contract",))
                if base is not None:
                    total = builder.fadd(builder.load(place(base + row)), total, flags=("contract",))
                builder.store(total, place(result + row))
            return context.get_dummy_value()

        return types.none(array, types.intp), generate

    return cast("Callable[..., Any]", combine)


def tuple_difference(kind: type) -> Callable[..., Any]:
    """A compiled function ``difference(a, b)`` of two named tuples ``kind`` of float64, element by element."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return lambda a, b: kind(*(x - y for x, y in zip(a, b, strict=True)))
    result = types.NamedUniTuple(types.float64, len(kind._fields), kind)  # type: ignore[attr-defined]

    @intrinsic
    def difference(typing_context: Any, a: Any, b: Any) -> Any:
        del typing_context, a, b

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            del signature
            values = [
                builder.fsub(builder.extract_value(arguments[0], n), builder.extract_value(arguments[1], n))
                for n in range(len(result))
            ]
            return context.make_tuple(builder, result, values)

        return result(result, result), generate

    return cast("Callable[..., Any]", difference)


def tuple_choice(kind: type) -> Callable[..., Any]:
    """A compiled function ``choice(condition, a, b)``: a or b, two named tuples ``kind`` of float64."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return lambda condition, a, b: a if condition else b
    result = types.NamedUniTuple(types.float64, len(kind._fields), kind)  # type: ignore[attr-defined]

    @intrinsic
    def choice(typing_context: Any, condition: Any, a: Any, b: Any) -> Any:
        del typing_context, a, b

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            chooses = context.cast(builder, arguments[0], signature.args[0], types.boolean)
            values = [
                builder.select(chooses, builder.extract_value(arguments[1], n), builder.extract_value(arguments[2], n))
                for n in range(len(result))
            ]
            return context.make_tuple(builder, result, values)

        return result(condition, result, result), generate

    return cast("Callable[..., Any]", choice)


def _lane_of(context: Any, builder: Any, kind: Any, array: Any, lane: Any, lanes: int) -> Callable[[int], Any]:
    """A function that gives the pointer to one lane of a row of an array."""
    elements = make_array(kind)(context, builder, array)

    def place(row: int) -> Any:
        index = builder.add(lane, context.get_constant(types.intp, row * lanes))
        return cgutils.get_item_pointer(context, builder, kind, elements, [index])

    return place


class _Part:
    """What stands for a part of kernels: numba sees the bare translation, Python an ordinary compiled function."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.py_func = function
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        self._alone = numba.njit(**options, **STRICT)(function)
        unwrapped: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self._translated: Any = numba.njit(pipeline_class=_PartCompiler, **unwrapped, **options, **STRICT)(function)

    @property
    def _numba_type_(self) -> Any:
        return self._translated._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self._alone(*arguments)


class _NoMachineCode:
    """A code generator for functions that have no machine code, hence no address for their environment."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def set_env(self, name: str, environment: Any) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)


class _PartLibrary(JITCodeLibrary):
    """Translated functions that are linked into a kernel and optimised there, once, with everything else."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True

    @property
    def codegen(self) -> Any:
        return _NoMachineCode(self._codegen)

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _PartCompiler(Compiler):
    def define_pipelines(self) -> list[Any]:
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.library.enable_object_caching()
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]


class _KernelCompiler(Compiler):
    def compile_extra(self, function: Any) -> Any:
        """Compile while the garbage collector rests: it would search millions of live objects again and again."""
        collecting = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(function)
        finally:
            if collecting:
                gc.enable()
