"""Wrong fields of a configuration in words: where, which value, what is allowed, and what was probably meant."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hydro_env.errors import ConfigurationError, UnknownKeyError
from hydro_env.mistakes import did_you_mean, one_of

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

Path = tuple[int | str, ...]
Schema = Mapping[str, Any]


def described(
    model: "type[BaseModel]", error: "ValidationError", values: Mapping[str, Any], source: object, within: str = ""
) -> ConfigurationError:
    """The error that names every mistake of a group: one in one line, several in one line each below a heading.

    ``source`` is that of the values, such as the file; the group stands ``within`` it, as ``controllers.PID.settings``.
    """
    schema = model.model_json_schema()
    lines = {}
    kind = ConfigurationError
    mistakes = [(*_found_in(values, mistake), mistake) for mistake in error.errors(include_url=False)]
    # A list or a group with wrong parts may count as wrong itself.
    wholes = {path[:depth] for path, _, _ in mistakes for depth in range(len(path))}
    for path, given, mistake in mistakes:
        if path in wholes or path in lines:
            continue
        where = ".".join(filter(None, [within, *(str(part)[:60] for part in path)]))
        if where and mistake["type"] != "missing":
            where += _shown(given)
        message = _message(schema, path, given, mistake)
        lines[path] = " ".join((f"{where}: {message}" if where else message).split())
        if mistake["type"] == "extra_forbidden":
            kind = UnknownKeyError
    if len(lines) == 1:
        return kind(f"{source}: {next(iter(lines.values()))}")
    return kind("\n  ".join([f"{source}: {len(lines)} mistakes", *lines.values()]))


def _found_in(values: Any, mistake: Mapping[str, Any]) -> tuple[Path, Any]:
    """Path and value of a mistake; pydantic's path also says ``[key]``, and which of several types it has tried."""
    place = mistake["loc"]
    for depth, part in enumerate(place):
        try:
            values = values[part]
        except (KeyError, IndexError, TypeError):
            return place[: depth + (mistake["type"] == "missing")], values
    return place, values


def _message(root: Schema, path: Path, given: Any, mistake: Mapping[str, Any]) -> str:
    kind = mistake["type"]
    schema = _schema_at(root, path)
    unit = f" (unit: {schema['unit']})" if "unit" in schema else ""
    if kind == "extra_forbidden":
        fields = _schema_at(root, path[:-1]).get("properties", {})
        known = f"; known here: {', '.join(fields)}" if fields else ""
        return f"unknown key{did_you_mean(path[-1], fields) or known}"
    if kind == "missing":
        return "is missing"
    if kind == "value_error":  # of a validator of this project
        return f"{mistake['msg'].removeprefix('Value error, ')}{unit}"
    if "enum" in schema:
        return one_of(given, [*map(str, schema["enum"])])
    if schema.get("type") in ("number", "integer"):
        return f"must be {_number_allowed(schema)}{unit}"
    if kind in ("model_type", "dict_type"):
        return "must be a group of settings"
    return str(mistake["msg"]).replace("Input should", "must")


def _shown(value: Any) -> str:
    """`` = value`` if the value is short, else nothing."""
    if isinstance(value, bool):
        return f" = {str(value).lower()}"
    if not isinstance(value, int | float | str | list | tuple):
        return ""
    text = repr(value)
    return f" = {text}" if len(text) < 60 else ""


def _schema_at(root: Schema, path: Sequence[int | str]) -> Schema:
    """The field at ``path`` in a JSON schema; empty if there is no such field."""
    schema = _resolved(root, root)
    for part in path:
        if isinstance(part, int):
            entries = schema.get("prefixItems", [])
            inner = entries[part] if 0 <= part < len(entries) else schema.get("items")
        else:
            named = [*schema.get("patternProperties", {}).values(), schema.get("additionalProperties")]
            inner = schema.get("properties", {}).get(part, named[0])
        schema = _resolved(root, inner) if isinstance(inner, Mapping) else {}
    return schema


def _resolved(root: Schema, schema: Schema) -> Schema:
    """A schema with what it refers to, and without the choice of nothing."""
    if "$ref" in schema:
        return {**_resolved(root, root["$defs"][schema["$ref"].rsplit("/", 1)[-1]]), **schema}
    choices = [choice for choice in schema.get("anyOf", []) if choice.get("type") != "null"]
    return {**_resolved(root, choices[0]), **schema} if len(choices) == 1 else schema


def _number_allowed(schema: Schema) -> str:
    """The numbers that a JSON schema allows, in words."""
    kind = "a whole number" if schema["type"] == "integer" else "a number"
    if "minimum" in schema and "maximum" in schema:
        return f"{kind} within {schema['minimum']:.12g} to {schema['maximum']:.12g}"
    limits = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
    bounds = [f"{word} {schema[name]:.12g}" for name, word in limits.items() if name in schema]
    return f"{kind}, {' and '.join(bounds)}" if bounds else kind
