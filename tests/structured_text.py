"""Runs Structured Text: blark parses it, and each statement is translated to one of Python."""

from __future__ import annotations

import dataclasses
import math
import operator
import re
from typing import Any

import numpy as np
from blark.parse import parse_source_code

OPERATORS = {"=": "==", "<>": "!=", "AND": "and", "OR": "or"}
ORDERS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
NUMBER = re.compile(r"-?\d+\.\d+(?:E[-+]?\d+)?|-?\d+")
KINDS = {"LREAL": 0.0, "REAL": 0.0, "BOOL": False, "LINT": 0, "DINT": 0}


def real(value: float) -> float:
    return float(np.float32(value))


def divided(a: float, b: float) -> float:
    if isinstance(a, int) and isinstance(b, int):
        raise TypeError("a division of integers")
    return a / b if b != 0.0 else math.nan if a == 0.0 or a != a else math.copysign(math.inf, a) * math.copysign(1.0, b)


def compared(block: dict[str, Any], order: str, a: float, b: float) -> bool:
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
    "EXPT": pow,
    "LIMIT": lambda low, x, high: max(low, min(x, high)),
    "SEL": lambda chosen, no, yes: yes if chosen else no,
    "LREAL_TO_REAL": real,
    "REAL_TO_LREAL": float,
    "LINT_TO_LREAL": float,
    "LREAL_TO_DINT": round,
    "BOOL_TO_LREAL": float,
    "_divided": divided,
    "_real": real,
}


class FunctionBlock:
    """One instance of the function block of a text; ``gains`` are its inputs by name.

    ``stops``: whether a comparison with what is not a number stops the runtime.
    """

    stops = True

    def __init__(self, text: str) -> None:
        parsed = parse_source_code(text)
        if parsed.exception is not None:
            raise parsed.exception
        items = parsed.transform().items
        block = next(item for item in items if type(item).__name__ == "FunctionBlock")
        self.kinds: dict[str, str] = {}
        self.memory: dict[str, Any] = {}
        self.gains: dict[str, float] = {}
        for item in items:
            if type(item).__name__ == "DataTypeDeclaration":
                for entry in item.declaration.declarations:
                    self.gains[_name(entry.variables[0])] = float(str(entry.init.value.value))
        for section in block.declarations:
            for entry in section.items:
                self._declare(entry)
        lines = self._statements(block.body, 1)
        code = "\n".join(["def step(v):", *lines])
        space = dict(FUNCTIONS)
        exec(code, space)
        self._step = space["step"]

    def _declare(self, entry: Any) -> None:
        spec = entry.init.spec
        array = hasattr(spec, "subranges")
        kind = str(spec.type.type_name if array else spec.type)
        size = int(str(spec.subranges[0].stop.value)) + 1 if array else 0
        for variable in entry.variables:
            name = _name(variable)
            self.kinds[name] = kind
            if kind not in KINDS:
                continue  # the structure of gains
            value: Any = [KINDS[kind]] * size if size else KINDS[kind]
            if name == "valid":
                value = [True] * size
            elif entry.init.value is not None:
                numbers = [float(one) for one in NUMBER.findall(str(entry.init.value))]
                value = [real(one) for one in numbers] if kind == "REAL" else numbers
                assert len(value) == max(size, 1), name
                value = value if size else int(value[0])  # the place of a signal
            self.memory[name] = value

    holding = property(lambda self: self.memory["holding"])

    def __call__(self, signals: Any, start: bool, valid: Any = None, lost_limit: int = 0) -> float:
        """Voltage for the signals of one sample."""
        valid = [math.isfinite(one) for one in signals] if valid is None else list(valid)
        self.memory |= {"signals": [float(one) for one in signals], "start": bool(start), "valid": valid}
        self.memory |= {"lostlimit": lost_limit, "stops": self.stops}
        self.memory |= {f"gains.{name}": value for name, value in self.gains.items()}
        self._step(self.memory)
        return self.memory["voltage"]

    def _statements(self, listed: Any, depth: int) -> list[str]:
        lines = []
        for one in listed.statements if listed is not None else ():
            lines += [f"{'    ' * depth}{line}" for line in self._statement(one, depth)]
        return lines or [f"{'    ' * depth}pass"]

    def _statement(self, one: Any, depth: int) -> list[str]:
        kind = type(one).__name__
        if kind == "AssignmentStatement":
            (target,) = one.variables
            text, name = self._value(one.expression), _plain(getattr(target.name, "name", target.name))
            return [f"{self._value(target)} = {f'_real({text})' if self.kinds[name] == 'REAL' else text}"]
        if kind == "ForStatement":
            inside = self._statements(one.statements, 1)
            return [f"for v['{_plain(one.control)}'] in range({one.from_}, {one.to} + 1):", *inside]
        if kind == "IfStatement":
            yes, no = (self._statements(part, 1) for part in (one.statements, one.else_clause.statements))
            return [f"if {self._value(one.if_expression)}:", *yes, "else:", *no]
        raise NotImplementedError(kind)

    def _value(self, one: Any) -> str:
        kind = type(one).__name__
        if kind == "BinaryOperation":
            left, right, sign = self._value(one.left), self._value(one.right), str(one.op).upper()
            if sign in ORDERS:
                return f"_compared(v, '{sign}', {left}, {right})"
            return f"_divided({left}, {right})" if sign == "/" else f"({left} {OPERATORS.get(sign, sign)} {right})"
        if kind == "UnaryOperation":
            return f"({'not ' if str(one.op).upper() == 'NOT' else str(one.op)}{self._value(one.expr)})"
        if kind == "ParenthesizedExpression":
            return f"({self._value(one.expr)})"
        if kind == "FunctionCall":
            return f"{one.name}({', '.join(self._value(each.value) for each in one.parameters)})"
        if kind in ("Real", "Integer"):
            return f"_real({one.value})" if "REAL" in str(one.type_name) else str(one.value)
        if kind == "Boolean":
            return str(str(one.value).upper() == "TRUE")
        if kind == "SimpleVariable":
            return f"v['{_plain(one)}']"
        if kind == "MultiElementVariable":
            (element,) = one.elements
            if hasattr(element, "subscripts"):
                (index,) = element.subscripts
                return f"v['{_plain(one.name)}'][{self._value(index)}]"
            return f"v['{_plain(one.name)}.{_plain(element.field)}']"
        raise NotImplementedError(f"{kind}: {dataclasses.asdict(one) if dataclasses.is_dataclass(one) else one}")


def _name(declared: Any) -> str:
    return _plain(declared.variable.name)


def _plain(name: Any) -> str:
    return str(name).lower()
