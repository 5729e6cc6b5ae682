"""C functions of :class:`~hydro_rig.export.translator.Translator` as functions of Structured Text.

Some compilers copy an array at each call. A function in Structured Text therefore holds all C functions that it needs,
written out where they are called, and one array, ``work``, takes the place of all arrays that are not constant: a
pointer is an index. A lost sample is 1.0E30, because few controllers compute with what is not a number.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pycparser import CParser, c_ast

from hydro_env.types import ByName
from hydro_rig.export.c_files import TEMPLATES, render
from hydro_rig.export.c_writer import beside
from hydro_rig.export.expressions import TranslationError
from hydro_rig.export.structured_text import RESERVED, literal

KINDS = {"int": "BOOL", "long": "DINT", "float": "REAL", "double": "LREAL"}
STANDARD = {"sqrt": "SQRT", "sqrtf": "SQRT", "exp": "EXP", "log": "LN", "log10": "LOG", "fabs": "ABS", "pow": "EXPT"}
OPERATORS = {"%": "MOD", "==": "=", "!=": "<>"}  # others have the same text
NAME = re.compile(r"\b[A-Za-z_]\w*")
SPLIT = "@"  # where a function is split, and for its name


class Value(NamedTuple):
    """A number, or a place in an array, whose index is the text."""

    text: str
    kind: str
    array: str = ""  # its name


class TextFunctions:
    """Functions of Structured Text from a C source, for one array ``work`` of ``size`` numbers.

    ``known``: arguments of the functions, by name: a mapping stands for a struct, a whole number for an array of so
    many numbers in ``work``, an array for a constant one. ``prefix``: of the names of the functions, and of the type of
    the array, ``PREFIXWork``. ``constants``: kind and value of what is constant, such as places in the array.

    Raises:
        TranslationError: the source uses a construct without translation.
    """

    def __init__(self, source: str, known: Mapping[str, Any], prefix: str) -> None:
        self.prefix, self.size = prefix, 0
        self.functions: list[str] = []
        self.kinds: dict[str, str] = {}
        self.constants: dict[str, tuple[str, str]] = {}
        self.tables: dict[str, list[str]] = {}
        self._fixed, self._scope = set[str](), ByName()
        self._known = {name: self._declared(name, value) for name, value in known.items()}
        whole = (TEMPLATES / "text_helpers.c").read_text(encoding="utf-8") + source
        tree = CParser().parse(re.sub(r"/\*.*?\*/", " ", whole, flags=re.DOTALL))
        self._definitions = {getattr(node, "decl", node).name: node for node in tree.ext}  # functions and structs

    def function(self, name: str, call: str, split: str = "") -> None:
        """Write out a call of a C function with some of the known arguments.

        With the name of a loop variable, ``split``, the result are three functions: what comes before this loop, one
        pass of it, which is true after the last one, and what follows.
        """
        c_name, *arguments = NAME.findall(call)
        self._lines, self._split, self._break = list[str](), split, list[str]()
        self._line = self._lines.append
        self._called(c_name, [self._known[one] for one in arguments])
        pieces = "\n".join(self._lines).split(f"\n{SPLIT}\n")
        for piece, end in zip(pieces, ("Begin", "Pass", "End") if split else ("",), strict=True):
            own, names = self.prefix + name + end, set[str]()
            lines = piece.replace(SPLIT, own).splitlines()
            for line in lines:
                if {*NAME.findall(line.rpartition(" := ")[2])} & self.kinds.keys() - names:
                    raise TranslationError(f"{own}: a variable without a value: {line}")
                names.update(NAME.findall(line))
            values = {"of": self, "name": own, "names": names, "lines": lines}
            self.functions.append(render("text_function.st.j2", values))

    # Names ---------------------------------------------------------------------------------------------------------

    def _named(self, name: str, kind: str, array: str = "", number: str = "") -> Value:
        """A new variable, or constant."""
        unique, count = name, 1
        while unique.lower() in {"work", *RESERVED, *self.kinds, *self.constants, *self.tables}:
            count += 1
            unique = f"{name}_{count}"
        if number:
            self._fixed.add(unique)
            self.constants[unique] = kind, number
        else:
            self.kinds[unique] = kind
        return Value(unique, kind, array)

    def _declared(self, name: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {field: self._declared(f"{name}_{field}", part) for field, part in value.items()}
        if isinstance(value, int):
            self.size += value
            return self._named(name, "DINT", "work", str(self.size - value))
        if np.ndim(value):
            self.tables[name] = [literal(number) for number in np.ravel(value)]
            self._fixed.add(name)
            return Value("0", "DINT", name)
        return self._named(name, "LREAL", number=literal(value))

    def _is_fixed(self, value: Value) -> bool:
        return self._fixed.issuperset(NAME.findall(value.text))

    def _bound(self, name: str, value: Any) -> Any:
        """Give a value that does not change a name; returns what stands for it."""
        if isinstance(value, dict):
            return {field: self._bound(f"{name}_{field}", part) for field, part in value.items()}
        if self._is_fixed(value):
            table, _, place = value.text.rstrip("]").partition("[")
            if place.isdigit():
                return self._named(name, value.kind, number=self.tables[table][int(place)])
            if value.array or " " not in value.text:
                return value
        variable = self._named(name, value.kind, value.array)
        self._fixed.add(variable.text)
        self._line(f"{variable.text} := {value.text};")
        return variable

    # Statements ----------------------------------------------------------------------------------------------------

    def _called(self, name: str, given: Sequence[Any]) -> Any:
        """Write out a function; returns its result."""
        before, node, result = self._scope, self._definitions[name], None
        scope: ByName = {"INFINITY": Value(literal(np.inf), "LREAL")}
        for parameter, value in zip(node.decl.type.args.params, given, strict=True):
            scope[parameter.name] = self._bound(parameter.name, self._as(value, _kind(parameter.type)))
        self._scope = scope
        for statement in node.body.block_items:
            if isinstance(statement, c_ast.Return):
                result = self._as(self._value(statement.expr), _kind(node.decl.type.type))
            else:
                self._statement(statement)
        self._scope = before
        return result

    def _statement(self, node: Any) -> None:
        match type(node).__name__:
            case "Compound":
                for statement in node.block_items:
                    self._statement(statement)
            case "Decl" if isinstance(node.type, c_ast.ArrayDecl):
                self._scope[node.name] = self._declared(node.name, int(node.type.dim.value))
            case "Decl":
                kind = _kind(node.type)
                self._scope[node.name] = self._named(node.name, kind) if kind.isupper() else None
            case "Assignment":
                value, target = self._values([node.rvalue, node.lvalue])
                if target is None:
                    self._scope[node.lvalue.name] = self._bound(node.lvalue.name, value)
                elif node.op != "=" or isinstance(value, dict) or value.array or self._is_fixed(target):
                    raise _failure(node)  # a pointer, a struct, or an argument would change
                else:
                    self._line(f"{target.text} := {self._as(value, target.kind).text};")
            case "If":
                self._line(f"IF {self._value(node.cond).text} THEN")
                self._statement(node.iftrue)
                if node.iffalse:
                    self._line("ELSE")
                    self._statement(node.iffalse)
                self._line("END_IF;")
            case "For":
                self._loop(node)
            case "Break":
                self._lines += self._break
            case _:
                self._value(node)

    def _loop(self, node: Any) -> None:
        """A loop from one whole number to below another one."""
        name, around, end = node.init.lvalue.name, self._break, [SPLIT]
        if name == self._split:
            self._line(SPLIT)
            self._break = [f"{SPLIT} := TRUE;", "RETURN;"]
        else:
            self._statement(node.init)
            counter, mark, condition = self._scope[name].text, len(self._lines), self._value(node.cond).text
            if len(self._lines) > mark or node.next.op != "++":
                raise _failure(node)
            self._line(f"WHILE {condition} DO")
            self._break, end = ["EXIT;"], [f"{counter} := {counter} + 1;", "END_WHILE;"]
        self._statement(node.stmt)
        self._lines += end
        self._break = around

    # Expressions ---------------------------------------------------------------------------------------------------

    def _values(self, nodes: Sequence[Any]) -> list[Any]:
        values: list[Any] = []
        for node in nodes:
            mark = len(self._lines)
            values.append(self._value(node))
            if "work[" in str(values[:-1]) and any(line.startswith("work[") for line in self._lines[mark:]):
                raise _failure(node)  # would change what was read before
        return values

    def _value(self, node: Any) -> Any:
        match type(node).__name__, getattr(node, "op", ""):
            case "Value", _:
                return node
            case "Constant", _:
                whole = node.type == "int"
                return Value(node.value, "DINT") if whole else Value(literal(float(node.value)), "LREAL")
            case "ID", _ if node.name in self._scope:
                return self._scope[node.name]
            case "StructRef", _:
                return self._value(node.name)[node.field.name]
            case "ArrayRef", _:
                place, index = self._values([node.name, node.subscript])
                return Value(f"{place.array}[{_sum(place, index)}]", "LREAL")
            case "UnaryOp", "sizeof":
                return Value("1", "DINT")
            case "UnaryOp", "-" | "!":
                value = self._value(node.expr)
                return value._replace(text=f"{'-' if node.op == '-' else 'NOT '}{beside(value.text)}")
            case "BinaryOp", "&&":
                return self._chosen(node.left, node.right, Value("FALSE", "BOOL"))
            case "BinaryOp", "||":
                return self._chosen(node.left, Value("TRUE", "BOOL"), node.right)
            case "BinaryOp", _:
                return self._binary(node)
            case "TernaryOp", _:
                return self._chosen(node.cond, node.iftrue, node.iffalse)
            case "Cast", _:
                return self._as(self._value(node.expr), _kind(node.to_type.type))
            case "CompoundLiteral", _:
                fields = self._definitions[_kind(node.type.type)].type.type.decls
                parts = zip(fields, self._values(node.init.exprs), strict=True)
                return {field.name: self._as(value, _kind(field.type)) for field, value in parts}
            case "FuncCall", _:
                name, given = node.name.name, self._values(node.args.exprs)
                if name in self._definitions:
                    return self._called(name, given)
                if name in STANDARD:
                    kind = "REAL" if name == "sqrtf" else "LREAL"
                    texts = [self._as(one, kind).text for one in given]
                    return Value(f"{STANDARD[name]}({', '.join(texts)})", kind)
        raise _failure(node)

    def _chosen(self, condition: Any, first: Any, second: Any) -> Value:
        """One of two values; the other one is not computed."""
        self._line(f"IF {self._value(condition).text} THEN")
        yes = self._value(first)
        chosen = self._named("chosen", yes.kind)
        self._lines += [f"{chosen.text} := {yes.text};", "ELSE"]
        no = self._as(self._value(second), yes.kind)
        self._lines += [f"{chosen.text} := {no.text};", "END_IF;"]
        return chosen

    def _binary(self, node: Any) -> Value:
        left, right = self._values([node.left, node.right])
        if node.op == "!=" and left == right:  # true for what is not a number
            return Value(f"{left.text} > 1.0E29", "BOOL")
        if node.op == "+" and left.kind == right.kind == "DINT":
            return left._replace(text=_sum(left, right))
        if node.op in ("&", "|", "^", "<<", ">>"):
            raise _failure(node)
        kind = max(left.kind, right.kind, key=len)  # the wider one
        texts = [beside(self._as(one, kind).text) for one in (left, right)]
        return Value(f" {OPERATORS.get(node.op, node.op)} ".join(texts), "BOOL" if node.op[0] in "<=>!" else kind)

    def _as(self, value: Any, kind: str) -> Any:
        """A number as one of another kind."""
        if not kind.isupper() or value.kind == kind:  # a pointer, a struct, nothing
            return value
        if value.text.isdigit() and kind == "LREAL":
            return Value(f"{value.text}.0", kind)
        if (value.kind, kind) not in {("DINT", "LREAL"), ("REAL", "LREAL"), ("LREAL", "REAL")}:
            raise TranslationError(f"no translation from {value.kind} to {kind}: {value.text}")
        return Value(f"{value.kind}_TO_{kind}({value.text})", kind)


def _kind(node: Any) -> str:
    """The kind of a declared number, the name of a struct, nothing of a pointer."""
    if isinstance(node, c_ast.PtrDecl):
        return ""
    name = str(node.type.names[0])
    return KINDS.get(name, name)


def _sum(first: Value, second: Value) -> str:
    """The sum of two whole numbers."""
    return " + ".join(one.text for one in (first, second) if one.text != "0") or "0"


def _failure(node: Any) -> TranslationError:
    return TranslationError(f"no translation to Structured Text of {type(node).__name__} at {node.coord}")
