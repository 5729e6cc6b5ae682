"""How this package compiles: numba when it is there and allowed, with a cache that notices every change."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

STRICT: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}
"""IEEE arithmetic as written (bit-reproducible), divisions like NumPy's, other Python threads may run."""


def inline(function: Function) -> Function:
    """Compile a scalar function that is always merged into its caller, so that loops over it vectorise."""
    return cast("Function", numba.njit(forceinline=True, **STRICT)(function))


def compiled(function: Function) -> Function:
    """Compile a kernel and keep the machine code on disk, where a folder can be written.

    Numba keys its cache on the kernel's own file and on its closure. A kernel that merges functions of other
    files therefore takes their :func:`source_stamp` as a closure variable.
    """
    try:
        return cast("Function", numba.njit(cache=True, **STRICT)(function))
    except RuntimeError:  # no folder for the cache can be written
        return cast("Function", numba.njit(cache=False, **STRICT)(function))


def source_stamp(*sources: str) -> int:
    """A number that changes whenever one of the source files (paths inside the package) changes."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for source in sources:
        digest.update((package / source).read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")


def tuple_reader(kind: type, first: int = 0) -> Callable[..., Any]:
    """A compiled function that reads a one-dimensional array, from index ``first`` on, as a named tuple ``kind``."""
    fields = ", ".join(f"array[{first + index}]" for index in range(len(kind._fields)))  # type: ignore[attr-defined]
    reader: Callable[..., Any] = eval(f"lambda array: Kind({fields})", {"Kind": kind})
    return inline(reader)
