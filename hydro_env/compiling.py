"""Compilation of the inner loops through numba's public interface, with a disk cache that detects every change.

:func:`inline` marks the functions that kernels call, :func:`compiled` marks the kernels. Numba compiles neither loops
over the fields of a named tuple nor ``_replace``; this module generates the functions that replace them from the list
of fields (:func:`tuple_reader` and the others).
"""

import gc
import hashlib
import sys
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, cached_property, reduce
from pathlib import Path
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}
"""Division follows NumPy; a product and a sum may become one instruction; other Python threads may run.

On one processor the same source gives the same bits, independent of other plants in the run. Between processors with
and without fused multiply–add the last digits differ: ``contract`` allows the compiler to use that instruction.
"""


def _with_sources(digest: Any, folder: Path) -> Any:
    """A digest, with all source files of a folder behind what it holds."""
    longer = digest.copy()
    for file in sorted(folder.rglob("*.py")):
        longer.update(file.read_bytes())
    return longer


_OWN_SOURCES = _with_sources(hashlib.sha256(), Path(__file__).parent)  # read once


def digest_of_sources(*folders: Path) -> int:
    """A digest of all source files of this package, and of folders."""
    return int.from_bytes(reduce(_with_sources, folders, _OWN_SOURCES).digest()[:7], "big")


SOURCES = digest_of_sources()
"""Of this package alone; kernels have it in their closure, those of other packages a digest of their own folder too.

Numba keys its cache on the kernel's own file and closure, and would miss a change in functions from other files.
"""


class _Function:
    """What Python's own function tells about a compiled one."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func = function
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__


class Inline(_Function):
    """A function that is merged into the compiled functions that call it; loops over it can then vectorise.

    Its first call from Python compiles it on its own. Numba would prepare every function for calls from Python, which
    takes a third of the compile time, although few of these functions are ever called from Python.
    """

    def __call__(self, *arguments: Any) -> Any:
        """Call it from Python."""
        return self._alone(*arguments)

    def __reduce__(self) -> Any:
        """Its name alone, for numba's cache: the digest of all sources stands beside it in a kernel's closure."""
        return str, (self.__name__,)

    @cached_property
    def merged(self) -> Any:
        """The form that numba merges into callers."""
        return numba().njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)(self.py_func)

    @cached_property
    def _alone(self) -> Any:
        return numba().njit(**OPTIONS)(self.py_func)


def inline(function: Function) -> Function:
    """Make a function an :class:`Inline`."""
    return cast("Function", Inline(function))


@cache
def numba() -> Any:
    """The module numba, imported at the first compilation: parameters and configuration do not need it."""
    import numba as module
    from numba.extending import models, register_model, typeof_impl

    types = module.types

    class Merged(types.Dispatcher):
        """A call with other constants is no other function: numba would compile it again for each of them."""

        def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
            plain = {name: types.unliteral(kind) for name, kind in kws.items()}
            return super().get_call_type(context, tuple(map(types.unliteral, args)), plain)

    register_model(Merged)(models.OpaqueModel)

    @typeof_impl.register(Inline)
    def type_of_inline(value: Inline, context: Any) -> Any:
        return Merged(value.merged)

    return module


class Kernel(_Function):
    """A compiled function with its machine code cached on disk.

    The first call loads or compiles it. A damaged cache entry is deleted. If nothing can be written (no folder, a full
    disk), the kernel is compiled for this process alone.
    """

    _ready = False

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of the function, with a cache if its folder can be written."""
        try:
            return numba().njit(cache=True, **OPTIONS)(self.py_func)
        except RuntimeError:
            return numba().njit(**OPTIONS)(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code."""
        return self.dispatcher(*arguments) if self._ready else self._first(arguments)

    @property
    def loaded(self) -> Callable[..., Any]:
        """The compiled machine code, if available, for callers that save tenths of microseconds."""
        return self.dispatcher if self._ready else self

    def _first(self, arguments: tuple[Any, ...]) -> Any:
        collecting = gc.isenabled()
        gc.disable()  # otherwise it searches millions of live compiler objects repeatedly
        try:
            with _announcing():
                result = self._load(arguments)
        finally:
            if collecting:
                gc.enable()
        self._ready = True
        return result

    def _load(self, arguments: tuple[Any, ...]) -> Any:
        if numba().config.DISABLE_JIT:
            return self.dispatcher(*arguments)
        try:
            return self.dispatcher(*arguments)
        except numba().core.errors.NumbaError:
            raise
        except Exception:
            if self.dispatcher.signatures:  # compiled, but it could not be stored: a full disk
                return self.dispatcher(*arguments)
        for file in Path(self.dispatcher.stats.cache_path or "").glob(f"*.{self.__name__}-*.nb[ic]"):
            file.unlink(missing_ok=True)  # it could not be read
        self.dispatcher = numba().njit(**OPTIONS)(self.py_func)
        return self.dispatcher(*arguments)


def compiled(function: Callable[..., Any]) -> Kernel:
    """Compile a kernel; :data:`SOURCES` must be in its closure."""
    return Kernel(function)


@contextmanager
def _announcing() -> Iterator[None]:
    """Say it once on the console if something compiles; importing numba and loading machine code is no reason."""
    event = numba().core.event
    listener = type("Begin", (event.Listener,), {"on_start": lambda *_: _announce(), "on_end": lambda *_: None})()
    with event.install_listener("numba:compile", listener):
        yield


@cache
def _announce() -> None:
    print("hydro_env: compiling for this processor, once per version; up to a minute", file=sys.stderr)


def _generated(name: str, parameters: str, lines: Sequence[str], **names: Any) -> Any:
    """A function with this body, merged into its caller; ``names`` are its globals."""
    body = "\n".join(f"    {line}" for line in lines)
    source = f"def {name}({parameters}):\n{body}"
    exec(compile(source, f"<{name}>", "exec"), names)
    names[name].source = source  # for the translation to C
    return inline(names[name])


def merged(name: str, parameters: str, result: str, **names: Any) -> Any:
    """A function of ``parameters`` that returns the expression ``result``, in which ``names`` stand."""
    return _generated(name, parameters, [f"return {result}"], **names)


def named_tuple(name: str, fields: Iterable[str] | str, module: str) -> Any:
    """A named tuple of fields by name, or of a text with their names; a class statement cannot express either."""
    return namedtuple(name, fields, module=module)


def tuple_reader(kind: Any, first: int = 0, lanes: int = 0) -> Any:
    """``read(array)``: the named tuple ``kind`` from a one-dimensional array, from index ``first`` on.

    With ``lanes``: ``read(array, lane)``, from one lane of rows of so many elements, from row ``first`` on.
    """
    values = ", ".join(f"array[{place}]" for place in _places(kind, first, lanes))
    return _generated("read", "array, lane" if lanes else "array", [f"return kind({values})"], kind=kind)


def tuple_writer(kind: Any, first: int = 0, lanes: int = 0) -> Any:
    """``write(array, values)`` or ``write(array, lane, values)``: the inverse of :func:`tuple_reader`."""
    places = zip(_places(kind, first, lanes), kind._fields, strict=True)
    lines = [f"array[{place}] = values.{name}" for place, name in places]
    return _generated("write", "array, lane, values" if lanes else "array, values", lines)


def _places(kind: Any, first: int, lanes: int) -> list[str]:
    return [f"{row * lanes} + lane" if lanes else f"{row}" for row in range(first, first + len(kind._fields))]


def lane_function(array: str, rows: int, lanes: int, *statements: str) -> Any:
    """A function of an array that runs statements for every ``lane`` and ``place`` = row · lanes + lane."""
    lines = [
        f"for lane in range({lanes}):",
        f"    for row in range({rows}):",  # inner and unrolled: the loop over lanes becomes vector instructions
        f"        place = row * {lanes} + lane",
        *(f"        {statement}" for statement in statements),
    ]
    return _generated("combine", array, lines)


def lane_loader(columns: Sequence[int], first: int, lanes: int) -> Any:
    """``load(work, lane, array, row)``: columns of a row of an array into one lane, from row ``first`` on."""
    lines = [f"work[{(first + n) * lanes} + lane] = array[row, {column}]" for n, column in enumerate(columns)]
    return _generated("load", "work, lane, array, row", lines)


def lane_storer(columns: Sequence[int], first: int, lanes: int) -> Any:
    """``store(work, lane, array, row)``: the inverse of :func:`lane_loader`."""
    lines = [f"array[row, {column}] = work[{(first + n) * lanes} + lane]" for n, column in enumerate(columns)]
    return _generated("store", "work, lane, array, row", lines)


def function_of_number(functions: Sequence[Callable[..., Any]], parameters: str, number: str) -> Any:
    """A function of ``parameters`` that calls ``functions[number]`` with the others; nothing for other numbers."""
    others = ", ".join(name for name in parameters.split(", ") if name != number)
    lines = [f"if {number} == {index}: function_{index}({others})" for index in range(len(functions))]
    names = {f"function_{index}": function for index, function in enumerate(functions)}
    return _generated("choose", parameters, lines, **names)


def tuple_replacer(kind: Any, *replaced: str) -> Any:
    """``replace(old, …)``: a copy of the named tuple ``kind`` with new values of the fields ``replaced``, in order."""
    values = ", ".join(name if name in replaced else f"old.{name}" for name in kind._fields)
    return _generated("replace", f"old, {', '.join(replaced)}", [f"return kind({values})"], kind=kind)


def tuple_joiner(kind: Any, parts: Sequence[Any]) -> Any:
    """``join(part_0, part_1, …)``: the named tuple ``kind`` whose fields are those of its parts, one after another."""
    values = [f"part_{number}.{field}" for number, part in enumerate(parts) for field in part._fields]
    parameters = ", ".join(f"part_{number}" for number in range(len(parts)))
    return _generated("join", parameters, [f"return kind({', '.join(values)})"], kind=kind)


def tuple_first(kind: Any, condition: str, names: str) -> Any:
    """``first(…)``: index of the first field for which a condition over ``{name}`` is true, −1 for none."""
    lines = [f"if {condition.replace('{name}', name)}: return {index}" for index, name in enumerate(kind._fields)]
    return _generated("first", names, [*lines, "return -1"])


def tuple_map(kind: Any, expression: str, parameters: str) -> Any:
    """The named tuple ``kind`` of an expression over ``{name}``, field by field."""
    values = ", ".join(expression.replace("{name}", name) for name in kind._fields)
    return _generated("combine", parameters, [f"return kind({values})"], kind=kind)


def tuple_maximum(kind: Any, expression: str, parameters: str) -> Any:
    """The largest value of an expression over ``{name}``; NaN if any value is NaN."""
    values = {f"value_{name}": expression.replace("{name}", name) for name in kind._fields}
    lines = [f"{value} = {text}" for value, text in values.items()]
    lines += [f"total = {' + '.join(values)}", f"return max({', '.join(values)}) if total == total else total"]
    return _generated("largest", parameters, lines)
