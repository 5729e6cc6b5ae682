"""Python expressions as C99: types of C, then the translation to text and type."""

from __future__ import annotations

import ast
import math
import re
from typing import Any

import numpy as np

from hydro_env import HydroError
from hydro_env.compiling import Inline

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


Typed = tuple[str, str]
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_BITS = {ast.BitXor: "^", ast.RShift: ">>"}
_NUMBERS = (BOOL, INT, FLOAT, DOUBLE)  # types that C converts as Python does, the widest last
_FUNCTIONS = (math.asinh, math.cos, math.exp, math.floor, math.hypot, math.log, math.log10, math.sin, math.tanh)
_CASTS = {np.float64: DOUBLE, float: DOUBLE, np.float32: FLOAT, np.int64: INT, int: INT, np.uint64: UINT64}
_BUILT_IN = {"min": min, "max": max, "abs": abs, "float": float, "int": int}


class TranslationError(HydroError):
    """A Python function uses something that has no translation."""


class Expressions:
    """The expressions of one function.

    Attributes:
        names: types of arguments and local variables.
        constants: variables with a value known at translation, such as the length of an array.
        known: the other names of the function's module.
    """

    def __init__(self, translator: Any, name: str, known: dict[str, Any]) -> None:
        self.translator, self.name, self.known = translator, name, known
        self.names: dict[str, str] = {}
        self.constants: dict[str, int] = {}

    def failure(self, node: ast.AST) -> TranslationError:
        """The error for an expression without translation."""
        return TranslationError(f"{self.name}: no translation for: {ast.unparse(node)}")

    def value(self, node: ast.expr) -> Typed:
        """Text and type of an expression."""
        found: Typed | None = None
        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            return _literal(node.value)
        if isinstance(node, ast.Name):
            found = self._name(node.id)
        elif isinstance(node, ast.Attribute):
            found = self._attribute(node)
        elif isinstance(node, ast.Subscript):
            found = self.subscript(node)
        elif isinstance(node, ast.UnaryOp):
            text, kind = self.value(node.operand)
            return (f"(!{text})", BOOL) if isinstance(node.op, ast.Not) else (f"(-{text})", kind)
        elif isinstance(node, ast.BinOp):
            found = self._arithmetic(node)
        elif isinstance(node, ast.BoolOp):
            mark = " && " if isinstance(node.op, ast.And) else " || "
            return f"({mark.join(self.value(one)[0] for one in node.values)})", BOOL
        elif isinstance(node, ast.Compare):
            terms = [self.value(one)[0] for one in (node.left, *node.comparators)]
            marks = [_COMPARISONS[type(mark)] for mark in node.ops]
            pairs = [f"({terms[i]} {mark} {terms[i + 1]})" for i, mark in enumerate(marks)]
            return f"({' && '.join(pairs)})" if len(pairs) > 1 else pairs[0], BOOL
        elif isinstance(node, ast.IfExp):
            (test, _), (yes, kind), (no, other) = (self.value(one) for one in (node.test, node.body, node.orelse))
            if kind == other or {kind, other} <= set(_NUMBERS):
                found = f"({test} ? {yes} : {no})", kind if kind == other else _widest(kind, other)
        elif isinstance(node, ast.Tuple):
            parts = [self.value(one) for one in node.elts]
            return self._struct("Tuple_" + "_".join(kind for _, kind in parts), parts)
        elif isinstance(node, ast.Call):
            found = self._call(node)
        if found is None:
            raise self.failure(node)
        return found

    def integer(self, node: ast.expr) -> int:
        """Value of an expression that is known at translation, such as the length of a new array."""
        if isinstance(node, ast.Subscript):  # the length of another array
            return int(self.value(node)[0])
        known = {name: value for name, value in self.known.items() if isinstance(value, int)} | self.constants
        try:
            return int(eval(ast.unparse(node), {"__builtins__": {}}, known))
        except Exception:
            raise self.failure(node) from None

    def subscript(self, node: ast.Subscript) -> Typed | None:
        """An element of an array, one of its rows, all of it (``[:]``), or a field of a tuple."""
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            return _literal(shape_of(self.value(node.value.value)[1])[self.integer(node.slice)])
        text, kind = self.value(node.value)
        if not shape_of(kind):
            inner, field = self.translator.fields(kind)[self.integer(node.slice)]
            return f"{text}.{field}", inner
        if isinstance(node.slice, ast.Slice):
            return (text, kind) if node.slice.lower is node.slice.upper is node.slice.step is None else None
        indices = [self.value(one) for one in (node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice])]
        if len(indices) > len(shape_of(kind)) or any(one != INT for _, one in indices):
            return None
        left = row_of(kind, len(indices))
        pairs = zip((index for index, _ in indices), strides_of(kind), strict=False)
        terms = [index if stride == 1 else f"{stride} * {index}" for index, stride in pairs if index != "0"]
        offset = " + ".join(terms) or "0"
        if shape_of(left):
            return f"({text} + {offset})" if offset != "0" else text, left
        return f"{text}[{offset}]", left

    def _name(self, name: str) -> Typed | None:
        if name in self.constants:
            return _literal(self.constants[name])
        if name in self.names:
            return name, self.names[name]
        value = self.known.get(name)
        return _literal(value) if isinstance(value, bool | int | float | np.uint64) else None

    def _attribute(self, node: ast.Attribute) -> Typed | None:
        if isinstance(self._callee(node), float):  # such as math.pi
            return _literal(self._callee(node))
        text, kind = self.value(node.value)
        fields = {name: inner for inner, name in self.translator.fields(kind)}
        return (f"{text}.{node.attr}", fields[node.attr]) if node.attr in fields else None

    def _struct(self, name: str, parts: list[Typed]) -> Typed:
        struct = self.translator.record(name, [(kind, f"v{i}") for i, (_, kind) in enumerate(parts)])
        return f"({struct}){{{', '.join(text for text, _ in parts)}}}", struct

    def _arithmetic(self, node: ast.BinOp) -> Typed | None:
        (left, kind), (right, other) = self.value(node.left), self.value(node.right)
        both = {kind, other}
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant) and node.right.value == 2:
            return f"({left} * {left})", kind
        if isinstance(node.op, ast.Pow):
            return f"pow({left}, {right})", DOUBLE
        if isinstance(node.op, ast.FloorDiv) and both == {INT}:
            return f"({left} / {right})", INT  # the same for non-negative numbers
        if isinstance(node.op, ast.Mod) and both <= {INT, DOUBLE}:
            return (f"({left} % {right})", INT) if both == {INT} else (f"fmod({left}, {right})", DOUBLE)
        if both == {UINT64} and type(node.op) in {**_OPERATORS, **_BITS} and not isinstance(node.op, ast.Div):
            return f"({left} {({**_OPERATORS, **_BITS})[type(node.op)]} {right})", UINT64
        mark = _OPERATORS.get(type(node.op))
        if mark is None or not both <= {INT, FLOAT, DOUBLE}:
            return None
        if mark == "/" and both == {INT}:
            return f"((double){left} / {right})", DOUBLE
        return f"({left} {mark} {right})", _widest(kind, other)

    def _callee(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            return getattr(self.known.get(node.value.id), node.attr, None)
        if isinstance(node, ast.Name):
            return self.known.get(node.id, _BUILT_IN.get(node.id))
        return None

    def _call(self, node: ast.Call) -> Typed | None:
        callee = self._callee(node.func)
        parts = [self.value(one) for one in node.args]
        texts, kinds = [text for text, _ in parts], [kind for _, kind in parts]
        if isinstance(callee, Inline):
            name, result = self.translator.function(callee, kinds)
            return f"{name}({', '.join(texts)})", result
        if isinstance(callee, type) and hasattr(callee, "_fields"):
            given = {keyword.arg: self.value(keyword.value)[0] for keyword in node.keywords}
            values = dict(zip(callee._fields, texts, strict=False)) | given
            if set(values) != set(callee._fields):
                return None
            struct = self.translator.struct(callee)
            return f"({struct}){{{', '.join(values[one] for one in callee._fields)}}}", struct
        if node.keywords:
            return None
        if callee is math.sqrt:
            return (f"sqrtf({texts[0]})", FLOAT) if kinds == [FLOAT] else (f"sqrt({texts[0]})", DOUBLE)
        if callee in _FUNCTIONS:
            return f"{callee.__name__}({', '.join(texts)})", DOUBLE
        if callee is math.isfinite:
            return f"(isfinite({texts[0]}) != 0)", BOOL
        if callee is abs:
            return f"fabs({texts[0]})", DOUBLE
        if callee in (min, max) and len(texts) >= 2:
            # As in Python: the first value unless another one is smaller (greater).
            text, mark = texts[0], "<" if callee is min else ">"
            for other in texts[1:]:
                whole = f"({other} {mark} {text} ? {other} : {text})"
                text = whole if set(kinds) == {INT} else f"{callee.__name__}imum({text}, {other})"
            return text, INT if set(kinds) == {INT} else DOUBLE
        cast = next((kind for one, kind in _CASTS.items() if callee is one), None)
        return (f"(({cast}){texts[0]})", cast) if cast is not None and len(texts) == 1 else None


def _widest(kind: str, other: str) -> str:
    return max(kind, other, key=_NUMBERS.index)


def _literal(value: float | np.uint64) -> Typed:
    if isinstance(value, np.uint64):
        return f"UINT64_C({int(value)})", UINT64
    if isinstance(value, bool):
        return str(int(value)), BOOL
    if isinstance(value, int):
        return (str(value) if value >= 0 else f"({value})"), INT
    number = float(value)
    if not math.isfinite(number):
        return ("INFINITY" if number > 0 else "(-INFINITY)") if number == number else "NAN", DOUBLE
    return (repr(number) if number >= 0.0 else f"({number!r})"), DOUBLE
