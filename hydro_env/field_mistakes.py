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
        message = _message(schema, path, given, mistake, brief=len(mistakes) > 1)
        found.setdefault(path, (line or 0, " ".join(f"{place}{message}".split())))
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


def _message(root: Mapping[str, Any], path: Path, given: Any, mistake: Mapping[str, Any], brief: bool) -> str:
    """What is wrong and what is allowed; ``brief``: a likely name instead of all names."""
    schema = _schema_at(root, path)
    unit = f" (unit: {schema['unit']})" if "unit" in schema else ""
    if mistake["type"] == "extra_forbidden":
        fields = _schema_at(root, path[:-1]).get("properties", {})
        deeper = [f"{group}.{path[-1]}" for group in fields if path[-1] in _fields(root, (*path[:-1], group))]
        guess = f"; did you mean {' or '.join(deeper[:3])}?" if deeper else did_you_mean(path[-1], fields)
        known = "" if brief and guess else f"{'' if guess else ';'} known here: {', '.join(fields)}"
        return f"unknown key{guess}{known}"
    if mistake["type"] in ABSENT:
        return "is missing" if mistake["type"] == "missing" else "a key must be text; decimals need a point"
    if mistake["type"] == "too_short":
        least = mistake["ctx"]["min_length"]
        return f"must hold at least {least} {'entry' if least == 1 else 'entries'}"
    if mistake["type"] == "value_error":  # of a validator of this project
        return f"{mistake['msg'].removeprefix('Value error, ')}{unit}"
    if "enum" in schema:
        return one_of(given, map(str, schema["enum"]))
    schema, own_unit, meant = _in_unit_of(given, schema)
    unit = f" {own_unit}" if own_unit else unit
    allowed = allowed_by(schema)
    message = f"must be {allowed}" if allowed else "is not allowed here"
    hint = f"; {meant} meant?" if meant else ""
    if isinstance(given, str) and schema.get("type") == "object" and ":" in given:
        hint = "; a space must follow the colon"
    elif (isinstance(given, str) and re.match(r"[-+\d.]*,\d", given)) or _doubled(given, schema):
        hint = "; decimals need a point"
    return f"{'is empty; ' if given is None else ''}{message}{unit}{hint}"


def _in_unit_of(given: Any, schema: dict[str, Any]) -> tuple[dict[str, Any], str, str]:
    """The bounds of a number in the unit in which the user wrote it, this unit, and the quantity probably meant.

    ``120 MPa`` where at most 100 MPa are allowed is probably ``120 bar``, and a mere ``70`` in Pa ``70 bar``.
    """
    bounds = [key for key in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum") if key in schema]
    written, own = split_quantity(given) if isinstance(given, str) else (given, "")
    anywhere = next((known for known in UNITS.values() if own in known), {})  # a sensor's field has the signal's unit
    units = UNITS.get(str(schema.get("unit")), anywhere)
    if not bounds or not units or isinstance(given, bool):
        return schema, "", ""
    if not isinstance(written, int | float) or abs(written) > 1e300 or (isinstance(given, str) and own not in units):
        return schema, "", ""
    low = max(schema.get("minimum", -math.inf), schema.get("exclusiveMinimum", -math.inf))
    high = min(schema.get("maximum", math.inf), schema.get("exclusiveMaximum", math.inf))
    fitting = [name for name, factor in units.items() if name != own and low < written * factor < high]
    meant = f"{written:g} {fitting[0]}" if fitting and written else ""
    if not own:
        return schema, "", meant
    return schema | {key: float(f"{schema[key] / units[own]:.12g}") for key in bounds}, own, meant


def _doubled(given: Any, schema: Mapping[str, Any]) -> bool:
    """Whether a list has twice the entries that it may have, as ``[0,9, 1,1]``."""
    return isinstance(given, list) and 0 < 2 * len(schema.get("prefixItems", [])) == len(given)


def _fields(root: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    fields: Mapping[str, Any] = _schema_at(root, path).get("properties", {})
    return fields


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


def allowed_by(schema: Mapping[str, Any]) -> str:
    """What a JSON schema allows, in words; empty if there are none."""
    if "enum" in schema or "const" in schema:
        return f"one of {', '.join(map(str, schema.get('enum', [schema.get('const')])))}"
    kind = schema.get("type")
    if kind == "array":
        entries = schema.get("prefixItems", [])
        what = allowed_by(entries[0] if entries else schema.get("items", {}))
        count = f"{len(entries)} entries" if entries else "entries"
        return f"a list of {count}{f', each {what}' if what else ''}"
    if kind not in ("number", "integer"):
        words = {"string": "text", "boolean": "true or false", "object": "a group of settings"}
        return words.get(str(kind), " or ".join(filter(None, map(allowed_by, schema.get("anyOf", [])))))
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        bounds = f" within {_number(low)} to {_number(high)}"
    else:
        limits = (("at least", low), ("above", above), ("at most", high), ("below", below))
        given = [f"{word} {_number(bound)}" for word, bound in limits if bound is not None]
        bounds = f", {' and '.join(given)}" if given else ""
    return f"a{' whole' if kind == 'integer' else ''} number{bounds}"


def _number(value: float) -> str:
    return f"{value:g}" if float(f"{value:g}") == value else f"{value:.12g}"


def kind_of_value(value: Any) -> str:
    """The kind of a value in words, such as ``a list``."""
    names = {bool: "true or false", str: "text", int: "a number", float: "a number", list: "a list"}
    return "nothing" if value is None else names.get(type(value), type(value).__name__)
