"""Configuration as data: frozen validated groups, read from YAML; every mistake raises an error of one line."""

from __future__ import annotations

import difflib
import json
import os
import re
import tempfile
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from hydro_env.errors import ConfigurationError, UnknownKeyError
from hydro_env.units import in_si

LARGEST_FILE = 100_000
"""Largest size of a configuration file in bytes; the largest of this project has two thousand."""

MOST_NODES = 20_000
"""Largest number of values in a YAML file; each alias counts its values again, because nested aliases multiply."""

DEEPEST = 50
"""Largest number of levels in a YAML file; a study has five."""


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _ModelType
else:
    _ModelType = type(BaseModel)


class _OneLine(_ModelType):
    """Raises an error of one line for a wrong keyword when Python code makes a group: ``Load(mass=-1)``."""

    def __call__(self, *arguments: Any, **values: Any) -> Any:
        model = cast("type[BaseModel]", self)
        name = model.model_config.get("title") or model.__name__
        if arguments:
            raise ConfigurationError(f"{name}: takes keywords alone, not {_kind(arguments[0])}")
        try:
            return super().__call__(**values)
        except ValidationError as error:
            raise _one_line(model, error, name) from None


class Group(BaseModel, metaclass=_OneLine):
    """A frozen group of settings; unknown keys and NaN are errors."""

    def __setattr__(self, name: str, value: Any) -> None:
        raise ConfigurationError(f"{type(self).__name__}.{name}: is frozen; make a copy with another value")

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())

    @field_validator("*", mode="before")
    @classmethod
    def _plain_numbers(cls, value: Any, info: Any) -> Any:
        field = cls.model_fields[info.field_name]
        if isinstance(value, bool) and field.annotation in (int, float):
            raise ValueError("must be a number, not true/false")
        extra = field.json_schema_extra
        return in_si(value, str(extra["unit"])) if isinstance(extra, dict) and "unit" in extra else value


ModelType = TypeVar("ModelType", bound=BaseModel)


def validate(model: type[ModelType], values: Mapping[str, Any], source: str) -> ModelType:
    """Build ``model`` from ``values``; a mistake raises an error of one line that names ``source`` and the field.

    Raises:
        UnknownKeyError: unknown key; also a ``TypeError``.
        ConfigurationError: wrong type, or a value outside its bounds.
    """
    if not isinstance(values, Mapping):
        raise ConfigurationError(f"{source}: must be a mapping of settings, not {_kind(values)}")
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        raise _one_line(model, error, source) from None


def _one_line(model: type[BaseModel], error: ValidationError, source: str) -> ConfigurationError:
    first = error.errors(include_url=False)[0]
    path = first["loc"]
    schema = _schema_at(model, path)
    kind = ConfigurationError
    if first["type"] == "extra_forbidden":
        kind = UnknownKeyError
        known = list(_schema_at(model, path[:-1]).get("properties", {}))
        similar = difflib.get_close_matches(str(path[-1]), known, 1)
        message = f"unknown key; {f'did you mean {similar[0]}? ' if similar else ''}known here: {', '.join(known)}"
    elif first["type"] == "missing":
        message = "is missing"
    elif first["type"] == "value_error":  # of a validator of this project
        message = first["msg"].removeprefix("Value error, ")
    else:
        allowed = _allowed(schema)
        message = f"must be {allowed}" if allowed else "is not allowed here"
    where = ".".join(str(part)[:60] for part in path)
    unit = f" (unit: {schema['unit']})" if "unit" in schema else ""
    count = error.error_count() - 1
    more = f" (and {count} more mistake{'s' if count > 1 else ''})" if count else ""
    place = f"{source}: {where}{_shown(first.get('input'))}" if where else source
    return kind(" ".join(f"{place}: {message}{unit}{more}".split()))


def _shown(value: Any) -> str:
    """`` = value`` if the value is short, else nothing."""
    if isinstance(value, bool):
        return f" = {str(value).lower()}"
    flat = isinstance(value, list | tuple) and len(value) < 10 and not any(isinstance(v, list | dict) for v in value)
    if isinstance(value, int) and abs(value) >= 10**30:
        return ""
    text = repr(value) if flat or isinstance(value, int | float | str) else ""
    return f" = {text}" if 0 < len(text) < 60 else ""


def _schema_at(model: type[BaseModel], path: Sequence[int | str]) -> dict[str, Any]:
    """JSON schema of the field at ``path``; empty if there is no such field."""
    root = model.model_json_schema()

    def resolved(schema: dict[str, Any]) -> dict[str, Any]:
        own = {key: value for key, value in schema.items() if key != "$ref"}
        choices = [choice for choice in schema.get("anyOf", []) if choice.get("type") != "null"]
        if "$ref" in schema:
            return {**resolved(root["$defs"][schema["$ref"].rsplit("/", 1)[-1]]), **own}
        return {**resolved(choices[0]), **own} if len(choices) == 1 else schema

    schema = resolved(root)
    for part in path:
        entries = schema.get("prefixItems", [])
        if isinstance(part, int):
            inner = entries[part] if part < len(entries) else schema.get("items", {})
        else:
            by_name = [*schema.get("patternProperties", {}).values(), schema.get("additionalProperties", {})]
            inner = schema.get("properties", {}).get(part, by_name[0])
        schema = resolved(inner) if isinstance(inner, dict) else {}
    return schema


def _allowed(schema: Mapping[str, Any]) -> str:
    """Description of what a JSON schema allows."""
    if "enum" in schema or "const" in schema:
        return f"one of {', '.join(map(str, schema.get('enum', [schema.get('const')])))}"
    kind = schema.get("type")
    if kind == "array":
        entries = schema.get("prefixItems", [])
        what = _allowed(entries[0] if entries else schema.get("items", {}))
        count = f"{len(entries)} entries" if entries else "entries"
        return f"a list of {count}{f', each {what}' if what else ''}"
    if kind not in ("number", "integer"):
        return {"string": "text", "boolean": "true or false", "object": "a group of settings"}.get(str(kind), "")
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        bounds = f" within {_number(low)} to {_number(high)}"
    else:
        words = (("at least", low), ("above", above), ("at most", high), ("below", below))
        given = [f"{word} {_number(bound)}" for word, bound in words if bound is not None]
        bounds = f", {' and '.join(given)}" if given else ""
    return f"a{' whole' if kind == 'integer' else ''} number{bounds}"


def _number(value: float) -> str:
    return f"{value:g}" if float(f"{value:g}") == value else f"{value:.12g}"


def _kind(value: Any) -> str:
    """Name of the kind of a value."""
    names = {bool: "true or false", str: "text", int: "a number", float: "a number", list: "a list"}
    return "nothing" if value is None else names.get(type(value), type(value).__name__)


def read_text(path: str | Path, largest: int = LARGEST_FILE) -> str:
    """Read a UTF-8 text of at most ``largest`` bytes.

    Raises:
        ConfigurationError: the file is missing, unreadable, too large, or not UTF-8.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:  # it holds a null or a surrogate
        raise ConfigurationError(f"{str(path)!a}: is no possible file name") from None
    if len(content) > largest:
        raise ConfigurationError(f"{path}: is larger than {largest / 1e6:g} MB")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: cannot be read: not a text in UTF-8") from None


class _Loader(yaml.SafeLoader):
    """Reads only YAML's safe values; ``1e5`` is a number, a date is text, and an error names the line of its value."""

    yaml_implicit_resolvers = {
        first: [entry for entry in entries if not entry[0].endswith(":timestamp")]
        for first, entries in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise _problem(f"more than {DEEPEST} levels", self.peek_event())  # type: ignore[no-untyped-call]
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            raise _problem("a value that YAML cannot read", node) from None


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _problem(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)


def _count_nodes(node: yaml.Node, counted: dict[int, int]) -> int:
    """Number of values in a node, itself included; an alias counts each time. Refuses repeated keys."""
    if id(node) in counted:
        return counted[id(node)]
    counted[id(node)] = MOST_NODES + 1  # refuses an alias within itself
    inner: list[yaml.Node] = []
    if isinstance(node, yaml.MappingNode):
        keys = set()
        for key, value in node.value:
            name = (key.tag, key.value if isinstance(key.value, Hashable) else id(key))
            if name in keys:
                raise _problem(f"the key '{str(key.value)[:40]}' stands here twice", key)
            keys.add(name)
            inner += [key, value]
    elif isinstance(node, yaml.SequenceNode):
        inner = node.value
    total = 1
    for part in inner:
        total += _count_nodes(part, counted)
        if total > MOST_NODES:
            raise _problem(f"more than {MOST_NODES:,} values, aliases included", node)
    counted[id(node)] = total
    return total


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML mapping.

    Raises:
        ConfigurationError: the file is missing, unreadable or too large, is not YAML or not a mapping, repeats a key,
            or multiplies by nested aliases.
    """
    text = read_text(path)
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return {}
        _count_nodes(node, {})
        values = loader.construct_document(node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML"
        raise ConfigurationError(f"{path}: not valid YAML{line}: {' '.join(str(problem).split())}") from None
    return _mapping(values, path)


def read_json(path: str | Path, largest: int = LARGEST_FILE) -> dict[str, Any]:
    """Read a JSON object of at most ``largest`` bytes.

    Raises:
        ConfigurationError: the file is missing, unreadable or too large, is not JSON or not an object, repeats a key,
            or nests too deeply.
    """

    def unrepeated(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        values = dict(pairs)
        if len(values) < len(pairs):
            raise ValueError("a key stands twice")
        return values

    text = read_text(path, largest)
    try:
        values = json.loads(text, object_pairs_hook=unrepeated)
    except json.JSONDecodeError as error:
        raise ConfigurationError(f"{path}: not valid JSON in line {error.lineno}: {error.msg}") from None
    except RecursionError:
        raise ConfigurationError(f"{path}: not valid JSON: too many levels") from None
    except ValueError as error:
        problem = "a key stands twice" if "twice" in str(error) else "a number with too many digits"
        raise ConfigurationError(f"{path}: not valid JSON: {problem}") from None
    return _mapping(values, path)


def _mapping(values: Any, path: str | Path) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise ConfigurationError(f"{path}: must be a mapping of settings, not {_kind(values)}")
    wrong = next((key for key in values if not isinstance(key, str)), None)
    if wrong is not None:
        raise ConfigurationError(f"{path}: {wrong!r} is a key: keys must be text")
    return values


def write_yaml(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write a mapping as YAML, whole or not at all."""
    write_text(path, yaml.safe_dump(dict(values), sort_keys=False, allow_unicode=True))


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all; characters that UTF-8 cannot hold (in file names) are escaped."""
    write_whole(path, text.encode("utf-8", "backslashreplace"))


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file atomically: a reader sees the old content or the new content, never a part.

    Raises:
        ConfigurationError: the folder cannot be made or written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from None
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
