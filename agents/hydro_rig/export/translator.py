"""From compiled Python functions to C99.

The functions know numbers, truth values, arrays of fixed shapes, and named tuples of these; they call each other,
functions of ``math``, ``min``, ``max`` and ``abs``. Types follow from the arguments: each function is translated once
for the types with which it is called. A construct outside this language raises an error; no translation is silently
wrong.
"""

import ast
import inspect
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydro_rig.export.expressions import BOOL, DOUBLE, INT, Expressions, TranslationError, Type, Typed, array


@dataclass
class Translator:
    """Collects C structs and functions; each is written before its first use."""

    structs: list[str] = field(default_factory=list)
    functions: list[str] = field(default_factory=list)
    _records: dict[str, Type] = field(default_factory=dict)  # by the name of their struct
    _results: dict[str, Type] = field(default_factory=dict)  # function → its result
    _names: dict[tuple[Any, tuple[Any, ...]], str] = field(default_factory=dict)  # function and arguments → C name

    def struct(self, kind: Any) -> Type:
        """C type of a named tuple of doubles."""
        return self.record(kind.__name__.lstrip("_"), [(DOUBLE, name) for name in kind._fields])

    def record(self, name: str, fields: Sequence[tuple[Type, str]]) -> Type:
        """C type with this name and these fields, each with its type first."""
        kind = Type(name, fields=tuple(fields))
        if name not in self._records:
            self._records[name] = kind
            body = "".join(f"    {inner.declared(field_name)};\n" for inner, field_name in fields)
            self.structs.append(f"typedef struct {{\n{body}}} {name};\n")
        if self._records[name] != kind:
            raise TranslationError(f"two named tuples with the name {name}")
        return kind

    def function(self, function: Any, types: Sequence[Any], name: str | None = None) -> tuple[str, Type]:
        """Translate a function for arguments of these C types; returns its name in C and the type of its result.

        An argument that is a tuple of functions stands in place of its type, and is none in C.
        """
        key = (function, tuple(types))
        if key not in self._names:
            wanted = name or function.__name__.lstrip("_")
            taken = set(self._names.values())  # also by functions that call this one
            unique = next(n for n in (wanted, *(f"{wanted}_{i}" for i in range(2, 99))) if n not in taken)
            self._names[key] = unique
            body = _Body(self, function, types, unique)
            self._results[unique] = body.result
            self.functions.append(body.text)
        return self._names[key], self._results[self._names[key]]


class _Body(Expressions):
    """One function: its statements."""

    def __init__(self, translator: Translator, function: Any, types: Sequence[Any], name: str) -> None:
        module = {**function.py_func.__globals__, **inspect.getclosurevars(function.py_func).nonlocals}
        source = getattr(function.py_func, "source", None) or textwrap.dedent(inspect.getsource(function.py_func))
        node = ast.parse(source).body[0]
        if not isinstance(node, ast.FunctionDef):
            raise TranslationError(f"{name}: is no function")
        arguments = [argument.arg for argument in node.args.args]
        given = dict(zip(arguments, types, strict=True))
        laws = {argument: value for argument, value in given.items() if not isinstance(value, Type)}
        super().__init__(translator, name, module | laws)
        self.names = {argument: kind for argument, kind in given.items() if argument not in laws}
        self._locals: list[str] = []
        self._lines: list[str] = []
        self._temporaries = 0
        self.result = Type("void")
        self._block(node.body, "    ")
        arguments = list(dict.fromkeys(argument for argument in given if argument not in laws))
        head = ", ".join(given[argument].declared(argument) for argument in arguments)
        used = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
        unused = [f"    (void){argument};\n" for argument in arguments if argument not in used]
        comment = (ast.get_docstring(node) or name).splitlines()[0].replace("*/", "* /")
        self.text = (
            f"/* {comment} */\nstatic {self.result.element} {name}({head})\n"
            f"{{\n{''.join([*self._locals, *unused, *self._lines])}}}\n"
        )

    def _block(self, statements: Sequence[ast.stmt], indent: str) -> None:
        for statement in statements:
            self._statement(statement, indent)

    def _line(self, indent: str, text: str) -> None:
        self._lines.append(f"{indent}{text}\n")

    def _statement(self, statement: ast.stmt, indent: str) -> None:
        match statement:
            case ast.Assert() | ast.Expr(value=ast.Constant()):
                pass  # an assertion of the compiler's cache, a docstring
            case ast.Expr():
                self._line(indent, f"{self.value(statement.value)[0]};")
            case ast.Return(value=ast.expr() as returned):
                value, kind = self.value(returned)
                if self.result not in (Type("void"), kind):
                    raise self.failure(statement)
                self.result = kind
                self._line(indent, f"return {value};")
            case ast.Assign(targets=[target]):
                self._assign(target, statement.value, indent)
            case ast.AugAssign():
                self._assign(statement.target, ast.BinOp(statement.target, statement.op, statement.value), indent)
            case ast.If():
                test, _ = self.value(statement.test)
                compound = test.startswith("(") and test.endswith(")")  # has brackets around all of it
                self._line(indent, f"if {test if compound else f'({test})'} {{")
                self._block(statement.body, indent + "    ")
                if statement.orelse:
                    self._line(indent, "} else {")
                    self._block(statement.orelse, indent + "    ")
                self._line(indent, "}")
            case ast.For(iter=ast.Call(func=ast.Name(id="range"), args=[*ends]), orelse=[]) if len(ends) <= 2:
                self._loop(statement, ends, indent)
            case ast.Break():
                self._line(indent, "break;")
            case _:
                raise self.failure(statement)

    def _loop(self, node: ast.For, ends: Sequence[ast.expr], indent: str) -> None:
        typed = [self.value(end) for end in ends]
        if any(kind != INT for _, kind in typed):
            raise self.failure(node.iter)
        first, last = typed[0][0] if len(typed) == 2 else "0", typed[-1][0]
        target = ast.unparse(node.target)
        if typed == [("1", INT)] and len(indent) == 4:  # there is one window; a break of it would not compile
            self.module[target] = 0
            self._block(node.body, indent)
            return
        name = self._local("turn" if target == "_" else target, INT)
        self._line(indent, f"for ({name} = {first}; {name} < {last}; ++{name}) {{")
        self._block(node.body, indent + "    ")
        self._line(indent, "}")

    def _assign(self, target: ast.expr, value: ast.expr, indent: str) -> None:
        if not isinstance(target, ast.Tuple):
            if isinstance(target, ast.Name) and (self._new_array(target.id, value) or self._length(target.id, value)):
                return
            self._store(target, self.value(value), indent)
            return
        if isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=True))
            if all(isinstance(name, ast.Name) and self._new_array(name.id, made) for name, made in pairs):
                return
            parts = [self._kept(*self.value(part), indent) for part in value.elts]  # they may be swapped
        else:
            parts = self._unpacked(*self.value(value), indent)
        for element, part in zip(target.elts, parts, strict=True):
            if ast.unparse(element) != "_":
                self._store(element, part, indent)

    def _unpacked(self, text: str, kind: Type, indent: str) -> list[Typed]:
        """The rows of an array, or the fields of a struct."""
        if kind.shape:
            return [(f"({text} + {kind.row().size * i})", kind.row()) for i in range(kind.shape[0])]
        struct, _ = self._kept(text, kind, indent)
        return [(f"{struct}.{name}", inner) for inner, name in kind.fields]

    def _store(self, target: ast.expr, part: Typed, indent: str) -> None:
        """Assign a value to a variable, to an element of an array, or to all elements of an array or row."""
        text, kind = part
        if isinstance(target, ast.Name):
            self._line(indent, f"{self._local(target.id, kind)} = {text};")
            return
        place = self.subscript(target) if isinstance(target, ast.Subscript) else None
        if place is None:
            raise self.failure(target)
        where, wanted = place
        if not wanted.shape and not kind.shape:
            self._line(indent, f"{where} = {text};")
        elif wanted.shape == kind.shape:
            self._line(indent, f"memcpy({where}, {text}, {wanted.size} * sizeof *{where});")
        elif kind in (DOUBLE, INT):
            self._line(indent, f"fill({where}, {wanted.size}, {text});")
        else:
            raise self.failure(target)

    def _new_array(self, name: str, value: ast.expr) -> bool:
        """Declare the array of an ``np.empty``; returns false for another value."""
        if not isinstance(value, ast.Call) or ast.unparse(value.func) != "np.empty" or self.module.get("np") != np:
            return False
        shape = value.args[0].elts if isinstance(value.args[0], ast.Tuple) else [value.args[0]]
        kind = self.names[name] = array(*(self.integer(length) for length in shape))
        self._locals.append(f"    static {kind.element} {name}[{kind.size}];\n")
        return True

    def _length(self, name: str, value: ast.expr) -> bool:
        """Remember the length of an array, which is known at translation; returns false for another value."""
        if not isinstance(value, ast.Subscript) or not ast.unparse(value.value).endswith(".shape"):
            return False
        self.module[name] = int(self.value(value)[0])
        return True

    def _local(self, name: str, kind: Type) -> str:
        before = self.names.get(name)
        if before is None:
            self.names[name] = kind
            self._locals.append(f"    {kind.declared(name)};\n")
        elif before != kind and not (before == DOUBLE and kind in (INT, BOOL)):
            raise TranslationError(f"{self.name}: {name} changes its type")
        return name

    def _kept(self, text: str, kind: Type, indent: str) -> Typed:
        self._temporaries += 1
        name = self._local(f"value_{self._temporaries}", kind)
        self._line(indent, f"{name} = {text};")
        return name, kind
