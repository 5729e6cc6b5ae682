"""How this package compiles: numba when it is there and allowed, with a cache that notices every change.

A kernel is one function that numba compiles, optimises and keeps on disk. What it is made of (:func:`inline`,
:func:`part`, :func:`tuple_reader`) is only translated for it: numba by itself would also optimise each of these
functions, generate its machine code and wrap it for Python, nine tenths of which nobody ever calls.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Callable
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
    package = Path(__file__).parents[1]
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
            kind_of_array = signature.args[0]
            elements = make_array(kind_of_array)(context, builder, arguments[0])
            values = []
            for row in rows:
                place = builder.add(arguments[1], context.get_constant(types.intp, row * lanes))
                pointer = cgutils.get_item_pointer(context, builder, kind_of_array, elements, [place])
                values.append(context.unpack_value(builder, types.float64, pointer))
            return context.make_tuple(builder, result, values)

        return result(array, types.intp), generate

    return cast("Callable[..., Any]", read)


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
