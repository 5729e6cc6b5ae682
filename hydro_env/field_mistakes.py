"""Wrong fields of a configuration in words: what, where, which value, what is allowed, and what was probably meant."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hydro_env.errors import ConfigurationError, UnknownKeyError
from hydro_env.mistakes import did_you_mean, one_of
from hydro_env.units import UNITS, split_quantity

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

MOST_MISTAKES = 20
"""Largest number of mistakes that one message lists."""

ABSENT = ("missing", "invalid_key")
"""Kinds of mistakes whose place the values do not have; a key that is a number counts as none."""

Path = tuple[int | str, ...]


def described(
    model: type[BaseModel],
    error: ValidationError,
    values: Mapping[str, Any],
    source: str,
    within: str = "",
    line_of: Callable[[Path, Any], int | None] = lambda path, value: None,
) -> ConfigurationError:
    """The error that names every mistake of a group: one in one line, several in one line each below a heading.

    Args:
        model: class of the group.
        error: what pydantic has found.
        values: what it has read.
        source: of the values, such as the file.
        within: where in the source the group stands, such as ``controllers.PID.settings``.
        line_of: line of the file that holds the value at a path.
    """
    schema = model.model_json_schema()
    found: dict[Path, tuple[int, str]] = {}
    mistakes = [(*_found_in(values, mistake), mistake) for mistake in error.errors(include_url=False)]
    # A list or a group with wrong parts may count as wrong itself.
    groups = {path[:depth] for path, _, _ in mistakes for depth in range(len(path))}
    for path, given, mistake in mistakes:
        if path in groups:
            continue
        where = ".".join([*([within] if within else []), *(str(part)[:60] for part in path)])
        line = line_of(path, given)
        place = f"line {line}: " if line is not None else ""
        place += f"{where}{'' if mistake['type'] in ABSENT else _shown(given)}: " if where else ""
        found.setdefault(path, (line or 0, " ".join(f"{place}{_message(schema, path, given, mistake)}".split())))
    lines = [text for _, text in sorted(found.values(), key=lambda mistake: mistake[0])]
    unknown_key = any(mistake["type"] == "extra_forbidden" for _, _, mistake in mistakes)
    kind = UnknownKeyError if unknown_key else ConfigurationError
    if len(lines) == 1:
        return kind(f"{source}: {lines[0]}")
    more = [f"and {len(lines) - MOST_MISTAKES} more"] if len(lines) > MOST_MISTAKES else []
    listed = "".join(f"\n  {line}" for line in [*lines[:MOST_MISTAKES], *more])
    return kind(f"{source}: {len(lines)} mistakes{listed}")


def _found_in(values: Any, mistake: Mapping[str, Any]) -> tuple[Path, Any]:
    """Path and value of a mistake; pydantic's path also says ``[key]``, and which of several types it has tried."""
    place: Path = mistake["loc"]
    for depth, part in enumerate(place):
        try:
            values = values[part]
        except (KeyError, IndexError, TypeError):
            return place[: depth + (mistake["type"] in ABSENT)], values
    return place, values


def _message(root: Mapping[str, Any], path: Path, given: Any, mistake: Mapping[str, Any]) -> str:
    """What is wrong and what is allowed."""
    schema = _schema_at(root, path)
    unit = f" (unit: {schema['unit']})" if "unit" in schema else ""
    match mistake["type"]:
        case "extra_forbidden":
            fields = _schema_at(root, path[:-1]).get("properties", {})
            inner = {group: _schema_at(root, (*path[:-1], group)).get("properties", {}) for group in fields}
            deeper = [f"{group}.{path[-1]}" for group in fields if path[-1] in inner[group]]
            guess = f"; did you mean {' or '.join(deeper[:3])}?" if deeper else did_you_mean(path[-1], fields)
            known = f"; known here: {', '.join(fields)}"
            return f"unknown key{guess or known}"
        case "missing":
            return "is missing"
        case "invalid_key":
            return "a key must be text; decimals need a point"
        case "too_short":
            least = mistake["ctx"]["min_length"]
            return f"must hold at least {least} {'entry' if least == 1 else 'entries'}"
        case "value_error":  # of a validator of this project
            return f"{mistake['msg'].removeprefix('Value error, ')}{unit}"
    if "enum" in schema:
        return one_of(given, map(str, schema["enum"]))
    allowed = _allowed_by(schema)
    message = f"must be {allowed}" if allowed else "is not allowed here"
    hint = _other_unit(given, schema)
    if isinstance(given, str) and schema.get("type") == "object" and ":" in given:
        hint = "; a space must follow the colon"
    elif isinstance(given, str) and re.match(r"[-+\d.]*,\d", given):
        hint = "; decimals need a point"
    return f"{'is empty; ' if given is None else ''}{message}{unit}{hint}"


def _other_unit(given: Any, schema: Mapping[str, Any]) -> str:
    """``; 70 bar meant?`` for a mere ``70`` in Pa, or for ``70 MPa``, where 100 MPa are too much."""
    written = split_quantity(given)[0] if isinstance(given, str) else given
    if not isinstance(written, int | float) or isinstance(written, bool) or not 0.0 < abs(written) < 1e300:
        return ""
    low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
    units = UNITS.get(str(schema.get("unit")), {})
    fitting = [name for name, factor in units.items() if low < written * factor < high]
    return f"; {written:g} {fitting[0]} meant?" if fitting else ""


def _shown(value: Any) -> str:
    """`` = value`` if the value is short, else nothing."""
    if isinstance(value, bool):
        return f" = {str(value).lower()}"
    flat = isinstance(value, list | tuple) and len(value) < 10 and not any(isinstance(v, list | dict) for v in value)
    if isinstance(value, int) and abs(value) >= 10**30:
        return ""
    text = repr(value) if flat or isinstance(value, int | float | str) else ""
    return f" = {text}" if 0 < len(text) < 60 else ""


def _schema_at(root: Mapping[str, Any], path: Sequence[int | str]) -> dict[str, Any]:
    """The field at ``path`` in a JSON schema; empty if there is no such field."""

    def resolved(schema: Mapping[str, Any]) -> dict[str, Any]:
        own = {key: value for key, value in schema.items() if key != "$ref"}
        choices = [choice for choice in schema.get("anyOf", []) if choice.get("type") != "null"]
        if "$ref" in schema:
            return {**resolved(root["$defs"][schema["$ref"].rsplit("/", 1)[-1]]), **own}
        return {**resolved(choices[0]), **own} if len(choices) == 1 else dict(schema)

    schema = resolved(root)
    for part in path:
        entries = schema.get("prefixItems", [])
        if isinstance(part, int):
            inner = entries[part] if 0 <= part < len(entries) else schema.get("items", {})
        else:
            by_name = [*schema.get("patternProperties", {}).values(), schema.get("additionalProperties", {})]
            inner = schema.get("properties", {}).get(part, by_name[0])
        schema = resolved(inner) if isinstance(inner, dict) else {}
    return schema


def _allowed_by(schema: Mapping[str, Any]) -> str:
    """What a JSON schema allows, in words; empty if there are none."""
    kind = str(schema.get("type"))
    words = {"string": "text", "boolean": "true or false", "object": "a group of settings"}
    if kind == "array":
        entries = len(schema.get("prefixItems", []))
        return f"a list of {entries} entries" if entries else "a list"
    if kind not in ("number", "integer"):
        return words.get(kind, " or ".join(filter(None, map(_allowed_by, schema.get("anyOf", [])))))
    limits = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
    bounds = [f"{word} {_number(schema[name])}" for name, word in limits.items() if name in schema]
    bounded = f", {' and '.join(bounds)}" if bounds else ""
    if "minimum" in schema and "maximum" in schema:
        bounded = f" within {_number(schema['minimum'])} to {_number(schema['maximum'])}"
    return f"a{' whole' if kind == 'integer' else ''} number{bounded}"


def _number(value: float) -> str:
    return f"{value:g}" if float(f"{value:g}") == value else f"{value:.12g}"


def kind_of_value(value: Any) -> str:
    """The kind of a value in words, such as ``a list``."""
    names = {bool: "true or false", str: "text", int: "a number", float: "a number", list: "a list"}
    return "nothing" if value is None else names.get(type(value), type(value).__name__)
