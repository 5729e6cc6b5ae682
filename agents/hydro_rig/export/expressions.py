"""Python expressions as C99: types of C, then the translation to text and type."""

import ast
import builtins
import math
from typing import Any, NamedTuple, Self

import numpy as np

from hydro_env import HydroError
from hydro_env.compiling import Inline
from hydro_rig.export.c_files import c_number


class Type(NamedTuple):
    """A type of C: a number, a struct, or an array of a fixed shape in row-major order."""

    element: str
    shape: tuple[int, ...] = ()
    constant: bool = False
    fields: tuple[Any, ...] = ()  # type and name of each field of a struct

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    def row(self, indices: int = 1) -> Self:
        """Type of an array after its first indices."""
        left = self.shape[indices:]
        return self._replace(shape=left, constant=self.constant and bool(left))

    def declared(self, name: str) -> str:
        """Declaration of a variable; an array is a pointer to its first element."""
        return f"{'const ' * self.constant}{self.element} {'*' if self.shape else ''}{name}"


DOUBLE, FLOAT, BOOL, INT, UINT64 = (Type(name) for name in ("double", "float", "int", "long", "uint64_t"))


def array(*shape: int, constant: bool = False) -> Type:
    """Type of an array of ``double``; a constant one is read-only."""
    return Type("double", shape, constant)


Typed = tuple[str, Type]
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_INTEGER_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.BitXor: "^", ast.RShift: ">>"}
_NUMBERS = (BOOL, INT, FLOAT, DOUBLE)  # types that C converts as Python does, the widest last
_MATH = (math.asinh, math.cos, math.exp, math.floor, math.hypot, math.log, math.log10, math.sin, math.sqrt, math.tanh)
_FUNCTIONS = {function: function.__name__ for function in _MATH} | {abs: "fabs"}
_CASTS = {np.float64: DOUBLE, float: DOUBLE, np.float32: FLOAT, np.int64: INT, int: INT, np.uint64: UINT64}


class TranslationError(HydroError):
    """A Python function uses something that has no translation."""


class Expressions:
    """The expressions of one function.

    ``names``: types of arguments and local variables; ``module``: what is known at translation by name, that of the
    function's module and lengths of arrays.
    """

    def __init__(self, translator: Any, name: str, module: dict[str, Any]) -> None:
        self.translator, self.name, self.module = translator, name, module
        self.names: dict[str, Type] = {}

    def failure(self, node: ast.AST) -> TranslationError:
        """The error for an expression without translation."""
        return TranslationError(f"{self.name}: no translation for: {ast.unparse(node).splitlines()[0]}")

    def value(self, node: ast.expr) -> Typed:
        """Text and type of an expression."""
        typed = self._value(node)
        if typed is None:
            raise self.failure(node)
        return typed

    def _value(self, node: ast.expr) -> Typed | None:
        match node:
            case ast.Constant(value=bool() | int() | float() as number):
                return _literal(number)
            case ast.Name() | ast.Attribute():
                known = self._known(node)
                return _literal(known) if isinstance(known, bool | int | float | np.uint64) else self._variable(node)
            case ast.Subscript():
                return self.subscript(node)
            case ast.UnaryOp(op=ast.Not()):
                return f"(!{self.value(node.operand)[0]})", BOOL
            case ast.UnaryOp(op=ast.USub()):
                text, kind = self.value(node.operand)
                return f"(-{text})", kind
            case ast.BinOp():
                return self._arithmetic(node)
            case ast.BoolOp():
                mark = " && " if isinstance(node.op, ast.And) else " || "
                return f"({mark.join(self.value(term)[0] for term in node.values)})", BOOL
            case ast.Compare():
                terms = [self.value(term)[0] for term in (node.left, *node.comparators)]
                marks = [_COMPARISONS[type(mark)] for mark in node.ops]
                pairs = [f"({terms[i]} {mark} {terms[i + 1]})" for i, mark in enumerate(marks)]
                return f"({' && '.join(pairs)})" if len(pairs) > 1 else pairs[0], BOOL
            case ast.IfExp():
                (test, _), (yes, kind), (no, other) = map(self.value, (node.test, node.body, node.orelse))
                if kind != other and not {kind, other} <= set(_NUMBERS):
                    return None
                return f"({test} ? {yes} : {no})", kind if kind == other else max(kind, other, key=_NUMBERS.index)
            case ast.Tuple():
                parts = [self.value(part) for part in node.elts]
                kinds = [kind for _, kind in parts]
                fields = [(kind, f"v{place}") for place, kind in enumerate(kinds)]
                struct = self.translator.record("Tuple_" + "_".join(kind.element for kind in kinds), fields)
                return _compound(struct, [text for text, _ in parts])
            case ast.Call():
                return self._call(node)
        return None

    def integer(self, node: ast.expr) -> int:
        """Value of an expression that is known at translation, such as the length of a new array."""
        if isinstance(node, ast.Subscript):  # the length of another array
            return int(self.value(node)[0])
        names = {name: value for name, value in self.module.items() if isinstance(value, int)}
        try:
            return int(eval(ast.unparse(node), {"__builtins__": {}}, names))
        except Exception:
            raise self.failure(node) from None

    def subscript(self, node: ast.Subscript) -> Typed | None:
        """An element of an array, one of its rows, all of it (``[:]``), or a field of a tuple."""
        chosen = node.slice
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            return _literal(self.value(node.value.value)[1].shape[self.integer(chosen)])
        text, kind = self.value(node.value)
        if not kind.shape:
            inner, field = kind.fields[self.integer(chosen)]
            return f"{text}.{field}", inner
        if isinstance(chosen, ast.Slice):
            return (text, kind) if chosen.lower is chosen.upper is chosen.step is None else None
        indices = chosen.elts if isinstance(chosen, ast.Tuple) else [chosen]
        if len(indices) > len(kind.shape):
            return None
        terms = []
        for place, each in enumerate(indices):
            index, of = self.value(each)
            if of != INT:
                return None
            stride = math.prod(kind.shape[place + 1 :])
            if index != "0":
                terms.append(index if stride == 1 else f"{stride} * {index}")
        offset = " + ".join(terms) or "0"
        left = kind.row(len(indices))
        if left.shape:
            return f"({text} + {offset})" if offset != "0" else text, left
        return f"{text}[{offset}]", left

    def _variable(self, node: ast.Name | ast.Attribute) -> Typed | None:
        if isinstance(node, ast.Name):
            return (node.id, self.names[node.id]) if node.id in self.names else None
        text, kind = self.value(node.value)
        fields = {name: inner for inner, name in kind.fields}
        return (f"{text}.{node.attr}", fields[node.attr]) if node.attr in fields else None

    def _arithmetic(self, node: ast.BinOp) -> Typed | None:
        (left, kind), (right, other) = self.value(node.left), self.value(node.right)
        operation, both = type(node.op), {kind, other}
        match node.op:
            case ast.Pow() if isinstance(node.right, ast.Constant) and node.right.value == 2:
                return f"({left} * {left})", kind
            case ast.Pow():
                return f"pow({left}, {right})", DOUBLE
            case ast.FloorDiv() if both == {INT}:
                return f"({left} / {right})", INT  # the same for non-negative numbers
            case ast.Mod() if both == {INT}:
                return f"({left} % {right})", INT
            case ast.Div() if both == {INT}:
                return f"((double){left} / {right})", DOUBLE
        if both == {UINT64} and operation in _INTEGER_OPERATORS:
            return f"({left} {_INTEGER_OPERATORS[operation]} {right})", UINT64
        if operation in _OPERATORS and both <= {INT, FLOAT, DOUBLE}:
            return f"({left} {_OPERATORS[operation]} {right})", max(kind, other, key=_NUMBERS.index)
        return None

    def _known(self, node: ast.expr) -> Any:
        """What a name means at translation, such as a function or ``math.pi``; ``None`` for a variable."""
        match node:
            case ast.Attribute():
                return getattr(self._known(node.value), node.attr, None)
            case ast.Name(id=name) if name not in self.names:
                return self.module.get(name, getattr(builtins, name, None))
        return None

    def _laws(self, node: ast.expr) -> Any:
        """A tuple of functions, which is known at translation; ``None`` for any other argument."""
        value = self._known(node)
        return value if isinstance(value, tuple) and isinstance(value[0], Inline | tuple) else None

    def _call(self, node: ast.Call) -> Typed | None:
        callee = self._known(node.func)
        given = [self._laws(argument) or self.value(argument) for argument in node.args]
        parts = [part for part in given if isinstance(part[1], Type)]
        texts, kinds = [text for text, _ in parts], [kind for _, kind in parts]
        if isinstance(callee, Inline):
            types = [part[1] if isinstance(part[1], Type) else part for part in given]
            name, result = self.translator.function(callee, types)
            return f"{name}({', '.join(texts)})", result
        if isinstance(callee, type) and hasattr(callee, "_fields"):
            values = dict(zip(callee._fields, parts, strict=False))
            values |= {str(keyword.arg): self.value(keyword.value) for keyword in node.keywords}
            if set(values) != set(callee._fields):
                return None
            fields = []
            for name in callee._fields:
                kind = values[name][1]
                fields.append((kind if kind.shape else DOUBLE, name))
            struct = self.translator.record(callee.__name__.lstrip("_"), fields)
            return _compound(struct, [values[name][0] for name in callee._fields])
        if node.keywords:
            return None
        if callee is math.sqrt and kinds == [FLOAT]:
            return f"sqrtf({texts[0]})", FLOAT
        if callee is math.isfinite:
            return f"isfinite({texts[0]})", BOOL
        if callee in _FUNCTIONS:
            return f"{_FUNCTIONS[callee]}({', '.join(texts)})", DOUBLE
        if callee in (min, max) and len(texts) >= 2:
            return _extreme(callee.__name__, texts, integers=set(kinds) == {INT})
        if callee in _CASTS and len(texts) == 1:
            return f"(({_CASTS[callee].element}){texts[0]})", _CASTS[callee]
        return None


def _extreme(name: str, texts: list[str], integers: bool) -> Typed:
    """As in Python: the first value unless another one is smaller (greater)."""
    text, mark = texts[0], "<" if name == "min" else ">"
    for other in texts[1:]:
        text = f"({other} {mark} {text} ? {other} : {text})" if integers else f"{name}imum({text}, {other})"
    return text, INT if integers else DOUBLE


def _compound(struct: Type, values: list[str]) -> Typed:
    return f"({struct.element}){{{', '.join(values)}}}", struct


def _literal(value: float | np.uint64) -> Typed:
    if isinstance(value, np.uint64):
        return f"UINT64_C({int(value)})", UINT64
    text = c_number(value)
    kind = BOOL if isinstance(value, bool) else INT if isinstance(value, int) else DOUBLE
    return f"({text})" if text.startswith("-") else text, kind
