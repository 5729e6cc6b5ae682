"""Translates the plant's algebraic Python functions to C99.

The functions know numbers, truth values and named tuples; they call each other, ``math.sqrt``, ``min``, ``max`` and
``abs``. Types follow from the arguments: each function is translated once for the types with which it is called. A
construct outside this language raises an error, so that nothing is translated wrongly in silence.
"""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydro_env import HydroError
from hydro_env.compiling import Inline

DOUBLE, FLOAT, BOOL = "double", "float", "int"
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}


class TranslationError(HydroError):
    """A Python function uses something that has no translation."""


@dataclass
class Translator:
    """Collects C structs and functions; each is written before its first use."""

    structs: list[str] = field(default_factory=list)
    functions: list[str] = field(default_factory=list)
    _fields: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)  # struct → (type, name) of each field
    _names: set[str] = field(default_factory=set)
    _known: dict[tuple[Any, tuple[str, ...]], tuple[str, str]] = field(default_factory=dict)  # → C name, result

    def struct(self, kind: Any, name: str | None = None) -> str:
        """C type of a named tuple of doubles."""
        return self._struct(name or kind.__name__.lstrip("_"), [(DOUBLE, one) for one in kind._fields])

    def _struct(self, name: str, fields: Sequence[tuple[str, str]]) -> str:
        if name not in self._fields:
            self._fields[name] = tuple(fields)
            body = "".join(f"    {kind} {one};\n" for kind, one in fields)
            self.structs.append(f"typedef struct {{\n{body}}} {name};\n")
        if self._fields[name] != tuple(fields):
            raise TranslationError(f"two named tuples with the name {name}")
        return name

    def function(self, function: Any, types: Sequence[str], name: str | None = None) -> tuple[str, str]:
        """Translate a function for arguments of these C types; returns its name in C and the type of its result."""
        key = (function, tuple(types))
        if key not in self._known:
            wanted = name or function.__name__.lstrip("_")
            unique = next(n for n in (wanted, *(f"{wanted}_{i}" for i in range(2, 99))) if n not in self._names)
            self._names.add(unique)  # before those that it calls get theirs
            body = _Body(self, function, types, unique)
            self._known[key] = unique, body.result
            self.functions.append(body.text)
        return self._known[key]

    def fields(self, kind: str) -> tuple[tuple[str, str], ...]:
        """Type and name of each field of a struct."""
        return self._fields[kind]


class _Body:
    """One function in C."""

    def __init__(self, translator: Translator, function: Any, types: Sequence[str], name: str) -> None:
        self._all, self._name = translator, name
        self._globals = function.py_func.__globals__
        closure = inspect.getclosurevars(function.py_func).nonlocals
        self._globals = {**self._globals, **closure}
        source = getattr(function.py_func, "source", None) or textwrap.dedent(inspect.getsource(function.py_func))
        node = ast.parse(source).body[0]
        if not isinstance(node, ast.FunctionDef):
            raise TranslationError(f"{name}: is no function")
        arguments = [argument.arg for argument in node.args.args]
        self._types = dict(zip(arguments, types, strict=True))
        self._locals: dict[str, str] = {}
        self._temporaries = 0
        self.result = ""
        lines = self._block(node.body, "    ")
        declared = "".join(f"    {kind} {local};\n" for local, kind in self._locals.items())
        head = ", ".join(f"{kind} {argument}" for argument, kind in zip(arguments, types, strict=True))
        comment = (ast.get_docstring(node) or name).splitlines()[0].replace("*/", "* /")
        self.text = f"/* {comment} */\nstatic {self.result} {name}({head})\n{{\n{declared}{''.join(lines)}}}\n"

    def _fail(self, node: ast.AST) -> TranslationError:
        return TranslationError(f"{self._name}: no translation for: {ast.unparse(node)}")

    # Statements ---------------------------------------------------------------------------------------------------

    def _block(self, statements: Sequence[ast.stmt], indent: str) -> list[str]:
        lines: list[str] = []
        for statement in statements:
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                continue  # a docstring
            if isinstance(statement, ast.Return) and statement.value is not None:
                value, kind = self._value(statement.value, lines, indent)
                self.result = self.result or kind
                if kind != self.result:
                    raise self._fail(statement)
                lines.append(f"{indent}return {value};\n")
            elif isinstance(statement, ast.Assign) and len(statement.targets) == 1:
                self._assign(statement.targets[0], statement.value, lines, indent)
            elif isinstance(statement, ast.AugAssign):
                self._assign(
                    statement.target, ast.BinOp(statement.target, statement.op, statement.value), lines, indent
                )
            elif isinstance(statement, ast.If):
                test, _ = self._value(statement.test, lines, indent)
                lines.append(f"{indent}if ({test}) {{\n")
                lines += self._block(statement.body, indent + "    ")
                if statement.orelse:
                    lines.append(f"{indent}}} else {{\n")
                    lines += self._block(statement.orelse, indent + "    ")
                lines.append(f"{indent}}}\n")
            elif isinstance(statement, ast.For):
                lines += self._loop(statement, indent)
            elif isinstance(statement, ast.Break):
                lines.append(f"{indent}break;\n")
            else:
                raise self._fail(statement)
        return lines

    def _loop(self, node: ast.For, indent: str) -> list[str]:
        counted = isinstance(node.iter, ast.Call) and ast.unparse(node.iter.func) == "range"
        if not counted or not isinstance(node.iter, ast.Call) or len(node.iter.args) != 1:
            raise self._fail(node.iter)
        end, _ = self._value(node.iter.args[0], [], indent)
        name = self._local("turn" if ast.unparse(node.target) == "_" else ast.unparse(node.target), DOUBLE)
        head = f"{indent}for ({name} = 0.0; {name} < {end}; {name} += 1.0) {{\n"
        return [head, *self._block(node.body, indent + "    "), f"{indent}}}\n"]

    def _assign(self, target: ast.expr, value: ast.expr, lines: list[str], indent: str) -> None:
        if isinstance(target, ast.Name):
            text, kind = self._value(value, lines, indent)
            lines.append(f"{indent}{self._local(target.id, kind)} = {text};\n")
            return
        if not isinstance(target, ast.Tuple) or not all(isinstance(one, ast.Name) for one in target.elts):
            raise self._fail(target)
        names = [one.id for one in target.elts if isinstance(one, ast.Name)]
        if isinstance(value, ast.Tuple):  # all values first: the assignment may swap them
            parts = [self._kept(*self._value(one, lines, indent), lines, indent) for one in value.elts]
        else:
            text, kind = self._value(value, lines, indent)
            kept, _ = self._kept(text, kind, lines, indent)
            parts = [(f"{kept}.{one}", inner) for inner, one in self._all.fields(kind)]
        for name, (text, kind) in zip(names, parts, strict=True):
            if name != "_":
                lines.append(f"{indent}{self._local(name, kind)} = {text};\n")

    def _local(self, name: str, kind: str) -> str:
        if name in self._types:
            if self._types[name] != kind:
                raise TranslationError(f"{self._name}: {name} changes its type")
        else:
            self._types[name] = self._locals[name] = kind
        return name

    def _kept(self, text: str, kind: str, lines: list[str], indent: str) -> tuple[str, str]:
        self._temporaries += 1
        name = self._local(f"value_{self._temporaries}", kind)
        lines.append(f"{indent}{name} = {text};\n")
        return name, kind

    # Expressions ----------------------------------------------------------------------------------------------------

    def _value(self, node: ast.expr, lines: list[str], indent: str) -> tuple[str, str]:
        """Text and type of an expression; values that C needs under a name are put before it."""

        def of(one: ast.expr) -> tuple[str, str]:
            return self._value(one, lines, indent)

        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            return _literal(node.value)
        if isinstance(node, ast.Name):
            if node.id in self._types:
                return node.id, self._types[node.id]
            value = self._globals.get(node.id)
            if isinstance(value, bool | int | float):
                return _literal(value)
        elif isinstance(node, ast.Attribute) and isinstance(self._callee(node), float):
            return _literal(self._callee(node))  # such as math.pi
        elif isinstance(node, ast.Attribute):
            text, kind = of(node.value)
            inner = next((inner for inner, one in self._all.fields(kind) if one == node.attr), None)
            if inner is not None:
                return f"{text}.{node.attr}", inner
        elif (
            isinstance(node, ast.Subscript)
            and isinstance(node.slice, ast.Constant)
            and isinstance(node.slice.value, int)
        ):
            text, kind = of(node.value)
            inner, one = self._all.fields(kind)[node.slice.value]
            return f"{text}.{one}", inner
        elif isinstance(node, ast.UnaryOp):
            text, kind = of(node.operand)
            return (f"(!{text})", BOOL) if isinstance(node.op, ast.Not) else (f"(-{text})", kind)
        elif isinstance(node, ast.BinOp):
            return self._arithmetic(node, of)
        elif isinstance(node, ast.BoolOp):
            mark = " && " if isinstance(node.op, ast.And) else " || "
            return f"({mark.join(of(one)[0] for one in node.values)})", BOOL
        elif isinstance(node, ast.Compare):
            terms = [of(node.left)[0], *(of(one)[0] for one in node.comparators)]
            marks = [_COMPARISONS[type(mark)] for mark in node.ops]
            pairs = [f"({terms[i]} {mark} {terms[i + 1]})" for i, mark in enumerate(marks)]
            return f"({' && '.join(pairs)})" if len(pairs) > 1 else pairs[0], BOOL
        elif isinstance(node, ast.IfExp):
            test, _ = of(node.test)
            (yes, kind), (no, other) = of(node.body), of(node.orelse)
            if kind == other:
                return f"({test} ? {yes} : {no})", kind
        elif isinstance(node, ast.Tuple):
            parts = [of(one) for one in node.elts]
            kinds = [kind for _, kind in parts]
            struct = self._all._struct("Tuple_" + "_".join(kinds), [(kind, f"v{i}") for i, kind in enumerate(kinds)])
            return f"({struct}){{{', '.join(text for text, _ in parts)}}}", struct
        elif isinstance(node, ast.Call):
            return self._call(node, of)
        raise self._fail(node)

    def _arithmetic(self, node: ast.BinOp, of: Any) -> tuple[str, str]:
        (left, kind), (right, other) = of(node.left), of(node.right)
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant) and node.right.value == 2:
            return f"({left} * {left})", kind
        if isinstance(node.op, ast.Pow):
            return f"pow({left}, {right})", DOUBLE
        if isinstance(node.op, ast.Mod):
            return f"fmod({left}, {right})", DOUBLE
        mark = _OPERATORS.get(type(node.op))
        if mark is None or not {kind, other} <= {DOUBLE, FLOAT}:
            raise self._fail(node)
        return f"({left} {mark} {right})", DOUBLE if DOUBLE in (kind, other) else FLOAT

    def _callee(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            return getattr(self._globals.get(node.value.id), node.attr, None)
        if isinstance(node, ast.Name):
            return self._globals.get(node.id, {"min": min, "max": max, "abs": abs}.get(node.id))
        return None

    def _call(self, node: ast.Call, of: Any) -> tuple[str, str]:
        callee = self._callee(node.func)
        parts = [of(one) for one in node.args]
        texts, kinds = [text for text, _ in parts], [kind for _, kind in parts]
        if isinstance(callee, Inline):
            name, result = self._all.function(callee, kinds)
            return f"{name}({', '.join(texts)})", result
        if isinstance(callee, type) and hasattr(callee, "_fields"):
            given = {keyword.arg: of(keyword.value)[0] for keyword in node.keywords}
            values = dict(zip(callee._fields, texts, strict=False)) | given
            if set(values) != set(callee._fields):
                raise self._fail(node)
            struct = self._all.struct(callee)
            return f"({struct}){{{', '.join(values[one] for one in callee._fields)}}}", struct
        if node.keywords:
            raise self._fail(node)
        if callee is math.sqrt:
            return (f"sqrtf({texts[0]})", FLOAT) if kinds == [FLOAT] else (f"sqrt({texts[0]})", DOUBLE)
        if callee in (math.sin, math.exp):
            return f"{callee.__name__}({texts[0]})", DOUBLE
        if callee is abs:
            return f"fabs({texts[0]})", DOUBLE
        if callee in (min, max) and len(texts) >= 2:
            # As in Python: the first value stays unless another is smaller (greater).
            name = f"{callee.__name__}imum"
            text = texts[0]
            for other in texts[1:]:
                text = f"{name}({text}, {other})"
            return text, DOUBLE
        if callee is np.float64:
            return f"((double){texts[0]})", DOUBLE
        if callee is np.float32:
            return f"((float){texts[0]})", FLOAT
        raise self._fail(node)


def _literal(value: float) -> tuple[str, str]:
    if isinstance(value, bool):
        return str(int(value)), BOOL
    number = float(value)
    if not math.isfinite(number):
        return ("INFINITY" if number > 0 else "(-INFINITY)") if number == number else "NAN", DOUBLE
    return (repr(number) if number >= 0.0 else f"({number!r})"), DOUBLE
