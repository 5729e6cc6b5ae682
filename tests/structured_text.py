"""Runs Structured Text: each statement is translated to one of Python, and what is unknown here is an error.

blark judges the grammar of a whole text, in a slow test: it takes a minute.
"""

import ast
import math
import operator
import re
from typing import Any

import numpy as np

ORDERS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
SIGNS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
WORDS = {"AND": "and", "OR": "or", "NOT": "not", "TRUE": "True", "FALSE": "False", "=": "==", "<>": "!="}
WORD = re.compile(r"\b(?:AND|OR|NOT|TRUE|FALSE)\b|<>|(?<![<>=])=")
NUMBER = re.compile(r"-?\d+\.\d+(?:E[-+]?\d+)?|-?\d+")
KINDS = {"LREAL": 0.0, "REAL": 0.0, "BOOL": False, "DINT": 0}
COMMENT = re.compile(r"\(\*.*?\*\)", re.DOTALL)
DECLARED = re.compile(r"^ +([\w, ]+) : (?:ARRAY\[0\.\.(\d+)\] OF )?(\w+)(?: := ([^;]*))?;", re.MULTILINE)
STATEMENT = re.compile(
    r"\s*(?:FOR (?P<counter>\w+) := (?P<first>\d+) TO (?P<last>\d+) DO\b"
    r"|WHILE (?P<loop>[^;]+?) DO\b|(?P<jump>EXIT|RETURN);|(?P<end>END_(?:FOR|IF|WHILE);)"
    r"|IF (?P<condition>[^;]+?) THEN\b|ELSIF (?P<next>[^;]+?) THEN\b|(?P<otherwise>ELSE)\b"
    r"|(?P<target>[^;:]+) := (?P<value>[^;]+);)"
)


def real(value):
    return float(np.float32(value))


def divided(a, b):
    if isinstance(a, int) and isinstance(b, int):
        return a // b
    return a / b if b != 0.0 else math.nan if a == 0.0 or a != a else math.copysign(math.inf, a) * math.copysign(1.0, b)


def compared(block, order, a, b):
    """A comparison; with what is not a number it stops the runtime, as that of TwinCAT, unless ``block`` allows it."""
    if block["stops"] and (a != a or b != b):
        raise FloatingPointError(f"{a} {order} {b}")
    return ORDERS[order](a, b)


FUNCTIONS: dict[str, Any] = {
    "_compared": compared,
    "ABS": abs,
    "SQRT": lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
    "EXP": math.exp,
    "LN": math.log,
    "LOG": math.log10,
    "EXPT": pow,
    "LIMIT": lambda low, x, high: max(low, min(x, high)),
    "SEL": lambda chosen, no, yes: yes if chosen else no,
    "LREAL_TO_REAL": real,
    "REAL_TO_LREAL": float,
    "DINT_TO_LREAL": float,
    "LREAL_TO_DINT": round,
    "BOOL_TO_LREAL": float,
    "BOOL_TO_DINT": int,
    "DINT_TO_REAL": real,
    "BOOL_TO_REAL": real,
    "REAL_TO_DINT": round,
    "_divided": divided,
    "_real": real,
}


class ToPython(ast.NodeTransformer):
    """An expression of Structured Text, whose signs are those of Python, over the memory ``v``."""

    def visit_Name(self, node):
        return ast.parse(f"v[{node.id.lower()!r}]", mode="eval").body

    def visit_Attribute(self, node):
        return self.visit_Name(ast.Name(ast.unparse(node)))

    def visit_Call(self, node):
        return ast.Call(node.func, [self.visit(each) for each in node.args], [])

    def visit_Compare(self, node):
        left, (sign,), (right,) = self.visit(node.left), node.ops, map(self.visit, node.comparators)
        if type(sign) not in SIGNS:
            return ast.Compare(left, [sign], [right])
        return ast.Call(ast.Name("_compared"), [ast.Name("v"), ast.Constant(SIGNS[type(sign)]), left, right], [])

    def visit_BinOp(self, node):
        left, right = self.visit(node.left), self.visit(node.right)
        if isinstance(node.op, ast.Div):
            return ast.Call(ast.Name("_divided"), [left, right], [])
        return ast.BinOp(left, node.op, right)


def to_python(expression):
    text = WORD.sub(lambda word: f" {WORDS[word[0]]} ", re.sub(r"REAL#([\d.]+(?:E[-+]\d+)?)", r"_real(\1)", expression))
    return ast.unparse(ToPython().visit(ast.parse(" ".join(text.split()), mode="eval").body))


class FunctionBlock:
    """One instance of the function block of a text, called with inputs by name; its outputs by name.

    ``stops``: whether a comparison with what is not a number stops the runtime.
    """

    stops = True

    def __init__(self, text):
        before, block = re.split(r"^FUNCTION_BLOCK ", COMMENT.sub("", text), flags=re.MULTILINE)
        types, *functions = re.split(r"^FUNCTION (?=\w)", before, flags=re.MULTILINE)
        declarations, _, body = block.rpartition("END_VAR")
        found = DECLARED.findall(types)
        self.gains = {name.lower(): float(value) for name, last, _, value in found if not last}
        self.arrays = {name: (last, kind) for name, last, kind, _ in found if last}
        self.outputs = [
            name for name, *_ in DECLARED.findall(declarations.partition("VAR_OUTPUT")[2].partition("END_VAR")[0])
        ]
        self.kinds: dict[str, str] = {}
        space = dict(FUNCTIONS)
        for function in functions:
            space |= self._function(function, space)
        self.memory = self._declared(declarations)
        self._step = self._translated(body, space)

    def _declared(self, declarations):
        """The variables with their initial values."""
        memory: dict[str, Any] = {}
        for names, last, kind, value in DECLARED.findall(declarations):
            last, kind = self.arrays.get(kind, (last, kind))
            for name in names.lower().split(", "):
                self.kinds[name] = kind
                if kind in KINDS:  # no structure
                    memory[name] = self._initial(name, kind, int(last) + 1 if last else 0, value)
        return memory

    def _function(self, text, space):
        """A function of arrays that it changes, by its name."""
        name = text.partition(" ")[0]
        declarations, _, body = text.rpartition("END_VAR")
        changed = DECLARED.search(declarations)[1].split(", ")
        self.kinds[name.lower()] = "BOOL"
        memory = self._declared(declarations)
        step = self._translated(body, dict(space))

        def called(*arrays):
            v = {**memory, "stops": self.stops, **dict(zip(changed, arrays, strict=True))}
            step(v)
            return v[name.lower()]

        return {name: called}

    def _translated(self, body, space):
        """A function of the memory, from statements that call functions of ``space``."""
        exec("\n".join(["def step(v):", *self._lines(body.partition("END_FUNCTION")[0].rstrip())]), space)
        return space["step"]

    def _initial(self, name, kind, size, text):
        if not text:
            return [KINDS[kind]] * size if size else KINDS[kind]
        numbers = [float(one) for one in NUMBER.findall(text)]
        assert len(numbers) == max(size, 1), name
        if size:
            return [real(one) for one in numbers] if kind == "REAL" else numbers
        return type(KINDS[kind])(numbers[0])

    def __call__(self, inputs):
        """Outputs of one call; the inputs have the names of the exported block, and so the outputs."""
        self.memory["stops"] = self.stops
        self.memory |= {f"gains.{name}": value for name, value in self.gains.items()}
        for name, value in inputs.items():
            plain = name if "." in name else {"reference": "ReferencePosition"}.get(name, name.replace("_", ""))
            self.memory[plain.lower()] = value
        self._step(self.memory)
        return {re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower(): self.memory[name.lower()] for name in self.outputs}

    def _lines(self, body):
        lines, depth, place = [], 1, 0
        while place < len(body):
            found = STATEMENT.match(body, place)
            assert found, body[place : place + 80]
            place = found.end()
            if found["end"]:
                depth -= 1
                continue
            if found["otherwise"] or found["next"]:
                depth -= 1
                line = f"elif {to_python(found['next'])}:" if found["next"] else "else:"
            elif found["condition"]:
                line = f"if {to_python(found['condition'])}:"
            elif found["loop"]:
                line = f"while {to_python(found['loop'])}:"
            elif found["jump"]:
                line = {"EXIT": "break", "RETURN": "return"}[found["jump"]]
            elif found["counter"]:
                line = f"for v[{found['counter'].lower()!r}] in range({found['first']}, {found['last']} + 1):"
            else:
                line = self._assigned(found["target"], to_python(found["value"]))
            lines.append("    " * depth + line)
            depth += line.endswith(":")
        assert depth == 1
        return lines

    def _assigned(self, target, value):
        name = target.partition("[")[0].lower()
        return f"{to_python(target)} = {f'_real({value})' if self.kinds[name] == 'REAL' else value}"
