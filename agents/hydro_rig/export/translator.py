"""From compiled Python functions to C99.

The functions know numbers, truth values, arrays of fixed shapes, and named tuples of these; they call each other,
functions of ``math``, ``min``, ``max`` and ``abs``. Types follow from the arguments: each function is translated once
for the types with which it is called. A construct outside this language raises an error; no translation is silently
wrong.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydro_rig.export.expressions import (
    BOOL,
    DOUBLE,
    INT,
    Expressions,
    TranslationError,
    Typed,
    array,
    declared,
    element_of,
    row_of,
    shape_of,
    size_of,
)


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
        return self.record(name or kind.__name__.lstrip("_"), [(DOUBLE, one) for one in kind._fields])

    def record(self, name: str, fields: Sequence[tuple[str, str]]) -> str:
        """C type with this name and these fields, each with its type first."""
        if name not in self._fields:
            self._fields[name] = tuple(fields)
            body = "".join(f"    {declared(kind, one)};\n" for kind, one in fields)
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
            self._names.add(unique)  # before the functions that it calls
            body = _Body(self, function, types, unique)
            self._known[key] = unique, body.result
            self.functions.append(body.text)
        return self._known[key]

    def fields(self, kind: str) -> tuple[tuple[str, str], ...]:
        """Type and name of each field of a struct; none for another type."""
        return self._fields.get(kind, ())


class _Body:
    def __init__(self, translator: Translator, function: Any, types: Sequence[str], name: str) -> None:
        self._all, self._name = translator, name
        known = {**function.py_func.__globals__, **inspect.getclosurevars(function.py_func).nonlocals}
        source = getattr(function.py_func, "source", None) or textwrap.dedent(inspect.getsource(function.py_func))
        node = ast.parse(source).body[0]
        if not isinstance(node, ast.FunctionDef):
            raise TranslationError(f"{name}: is no function")
        arguments = [argument.arg for argument in node.args.args]
        self._of = Expressions(translator, name, known)
        self._of.names = dict(zip(arguments, types, strict=True))
        self._locals: list[str] = []
        self._temporaries = 0
        self.result = ""
        lines = self._block(node.body, "    ")
        self.result = self.result or "void"
        head = ", ".join(declared(kind, argument) for argument, kind in zip(arguments, types, strict=True))
        unused = "".join(f"    (void){one};\n" for one in arguments if not _uses(node, one))
        comment = (ast.get_docstring(node) or name).splitlines()[0].replace("*/", "* /")
        self.text = (
            f"/* {comment} */\nstatic {self.result} {name}({head})\n"
            f"{{\n{''.join(self._locals)}{unused}{''.join(lines)}}}\n"
        )

    # Statements ---------------------------------------------------------------------------------------------------

    def _block(self, statements: Sequence[ast.stmt], indent: str) -> list[str]:
        lines: list[str] = []
        for statement in statements:
            if isinstance(statement, ast.Assert) or (
                isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            ):
                continue  # an assertion of the compiler's cache, a docstring
            if isinstance(statement, ast.Expr):
                lines.append(f"{indent}{self._of.value(statement.value)[0]};\n")
            elif isinstance(statement, ast.Return) and statement.value is not None:
                value, kind = self._of.value(statement.value)
                self.result = self.result or kind
                if kind != self.result:
                    raise self._of.failure(statement)
                lines.append(f"{indent}return {value};\n")
            elif isinstance(statement, ast.Assign) and len(statement.targets) == 1:
                self._assign(statement.targets[0], statement.value, lines, indent)
            elif isinstance(statement, ast.AugAssign):
                changed = ast.BinOp(statement.target, statement.op, statement.value)
                self._assign(statement.target, changed, lines, indent)
            elif isinstance(statement, ast.If):
                test, _ = self._of.value(statement.test)
                lines.append(f"{indent}if ({_bare(test)}) {{\n")
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
                raise self._of.failure(statement)
        return lines

    def _loop(self, node: ast.For, indent: str) -> list[str]:
        counted = isinstance(node.iter, ast.Call) and ast.unparse(node.iter.func) == "range"
        if not counted or not isinstance(node.iter, ast.Call) or len(node.iter.args) > 2 or node.orelse:
            raise self._of.failure(node.iter)
        ends = [self._of.value(one) for one in node.iter.args]
        if any(kind != INT for _, kind in ends):
            raise self._of.failure(node.iter)
        first, last = ends[0][0] if len(ends) == 2 else "0", ends[-1][0]
        name = self._local("turn" if ast.unparse(node.target) == "_" else ast.unparse(node.target), INT)
        head = f"{indent}for ({name} = {first}; {name} < {last}; ++{name}) {{\n"
        return [head, *self._block(node.body, indent + "    "), f"{indent}}}\n"]

    def _assign(self, target: ast.expr, value: ast.expr, lines: list[str], indent: str) -> None:
        if not isinstance(target, ast.Tuple):
            if isinstance(target, ast.Name) and (self._new_array(target.id, value) or self._length(target.id, value)):
                return
            self._store(target, self._of.value(value), lines, indent)
            return
        parts: list[Typed]
        if isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=True))
            if all(isinstance(one, ast.Name) and self._new_array(one.id, of) for one, of in pairs):
                return
            parts = [self._kept(*self._of.value(one), lines, indent) for one in value.elts]  # they may be swapped
        else:
            text, kind = self._of.value(value)
            if shape_of(kind):
                size = size_of(row_of(kind)) if shape_of(row_of(kind)) else 1
                parts = [(f"({text} + {size * i})", row_of(kind)) for i in range(shape_of(kind)[0])]
            else:
                kept, _ = self._kept(text, kind, lines, indent)
                parts = [(f"{kept}.{one}", inner) for inner, one in self._all.fields(kind)]
        for one, part in zip(target.elts, parts, strict=True):
            if ast.unparse(one) != "_":
                self._store(one, part, lines, indent)

    def _store(self, target: ast.expr, part: Typed, lines: list[str], indent: str) -> None:
        """Assign a value to a variable, to an element of an array, or to all elements of an array or row."""
        text, kind = part
        if isinstance(target, ast.Name):
            lines.append(f"{indent}{self._local(target.id, kind)} = {text};\n")
            return
        place = self._of.subscript(target) if isinstance(target, ast.Subscript) else None
        if place is None:
            raise self._of.failure(target)
        where, wanted = place
        if not shape_of(wanted) and not shape_of(kind):
            lines.append(f"{indent}{where} = {text};\n")
        elif shape_of(wanted) and shape_of(wanted) == shape_of(kind):
            lines.append(f"{indent}memcpy({where}, {text}, {size_of(wanted)} * sizeof *{where});\n")
        elif shape_of(wanted) and kind in (DOUBLE, INT):
            lines.append(f"{indent}fill({where}, {size_of(wanted)}, {text});\n")
        else:
            raise self._of.failure(target)

    def _new_array(self, name: str, value: ast.expr) -> bool:
        """Declare the array of an ``np.empty``; returns false for another value."""
        if not isinstance(value, ast.Call) or ast.unparse(value.func) != "np.empty" or self._of.known.get("np") != np:
            return False
        shape = value.args[0].elts if isinstance(value.args[0], ast.Tuple) else [value.args[0]]
        kind = array(*(self._of.integer(one) for one in shape))
        self._of.names[name] = kind
        self._locals.append(f"    static {element_of(kind)} {name}[{size_of(kind)}];\n")
        return True

    def _length(self, name: str, value: ast.expr) -> bool:
        """Remember the length of an array, which is known at translation; returns false for another value."""
        if not isinstance(value, ast.Subscript) or not ast.unparse(value.value).endswith(".shape"):
            return False
        self._of.constants[name] = int(self._of.value(value)[0])
        return True

    def _local(self, name: str, kind: str) -> str:
        known = self._of.names.get(name)
        if known is None:
            self._of.names[name] = kind
            self._locals.append(f"    {declared(kind, name)};\n")
        elif known != kind and not (known == DOUBLE and kind in (INT, BOOL)):
            raise TranslationError(f"{self._name}: {name} changes its type")
        return name

    def _kept(self, text: str, kind: str, lines: list[str], indent: str) -> Typed:
        self._temporaries += 1
        name = self._local(f"value_{self._temporaries}", kind)
        lines.append(f"{indent}{name} = {text};\n")
        return name, kind


def _bare(text: str) -> str:
    """A text without outer parentheses, which cause compiler warnings."""
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if text[0] == "(" and place == len(text) - 1 else text
    return text


def _uses(function: ast.FunctionDef, name: str) -> bool:
    return any(isinstance(node, ast.Name) and node.id == name for node in ast.walk(function))
