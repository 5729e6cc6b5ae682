"""Types of C in translated code, each a string: ``double``, a struct's name, or ``double[3][5]`` for an array."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

DOUBLE, FLOAT, BOOL, INT, UINT64 = "double", "float", "int", "long", "uint64_t"


def array(*shape: int, element: str = DOUBLE) -> str:
    """Type of an array with a fixed shape; ``const double`` as element makes it read-only."""
    return element + "".join(f"[{count}]" for count in shape)


def shape_of(kind: str) -> tuple[int, ...]:
    """Shape of an array; empty for other types."""
    return tuple(int(count) for count in re.findall(r"\[(\d+)\]", kind))


def size_of(kind: str) -> int:
    """Number of elements of an array."""
    return math.prod(shape_of(kind))


def element_of(kind: str) -> str:
    """Type of the elements of an array, without ``const``."""
    return kind.split("[")[0].removeprefix("const ")


def row_of(kind: str, indices: int = 1) -> str:
    """Type of an array after its first indices."""
    left = shape_of(kind)[indices:]
    return array(*left, element=kind.split("[")[0]) if left else element_of(kind)


def strides_of(kind: str) -> list[int]:
    """Stride of each index of an array, in elements."""
    shape = shape_of(kind)
    return [math.prod(shape[place + 1 :]) for place in range(len(shape))]


def declared(kind: str, name: str) -> str:
    """Declaration of a variable; an array is a pointer to its first element, in row-major order."""
    return f"{kind.split('[')[0]} *{name}" if shape_of(kind) else f"{kind} {name}"


def literals(values: Sequence[float]) -> str:
    """Exact numbers for the definition of an array."""
    return ", ".join("INFINITY" if value == math.inf else repr(float(value)) for value in values)
