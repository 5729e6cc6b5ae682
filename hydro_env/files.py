"""Configuration as data: frozen validated groups, read from YAML; an error names every mistake in one line."""

from __future__ import annotations

import contextlib
import json
import os
import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from hydro_env.errors import ConfigurationError
from hydro_env.field_mistakes import described, kind_of_value
from hydro_env.units import in_si

LARGEST_FILE = 100_000
"""Largest size of a configuration file in bytes; the largest of this project has two thousand."""

MOST_ALIASES = 100
"""Largest number of aliases in a YAML file; none may stand within an anchor, because nested aliases multiply."""


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _ModelType
else:
    _ModelType = type(BaseModel)


class _Checked(_ModelType):
    """Raises this project's error for a wrong keyword when Python code makes a group: ``Load(mass=-1)``."""

    def __call__(self, *arguments: Any, **values: Any) -> Any:
        model = cast("type[BaseModel]", self)
        name = model.model_config.get("title") or model.__name__
        if arguments:
            raise ConfigurationError(f"{name}: takes keywords alone, not {kind_of_value(arguments[0])}")
        try:
            return super().__call__(**values)
        except ValidationError as error:
            raise described(model, error, values, name) from None


class Group(BaseModel, metaclass=_Checked):
    """A frozen group of settings; unknown keys and NaN are errors."""

    def __setattr__(self, name: str, value: Any) -> None:
        raise ConfigurationError(f"{type(self).__name__}.{name}: is frozen; make a copy with another value")

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())

    @field_validator("*", mode="before")
    @classmethod
    def _plain_numbers(cls, value: Any, info: Any) -> Any:
        field = cls.model_fields[info.field_name]
        if isinstance(value, bool) and field.annotation in (int, float, int | None, float | None):
            raise ValueError("must be a number, not true/false")
        extra = field.json_schema_extra
        return in_si(value, str(extra["unit"])) if isinstance(extra, dict) and "unit" in extra else value


ModelType = TypeVar("ModelType", bound=BaseModel)


def validate(model: type[ModelType], values: Mapping[str, Any], source: str, within: str = "") -> ModelType:
    """Build ``model`` from ``values``; the error names ``source`` and every mistake, one per line.

    Args:
        model: class of the group.
        values: its settings.
        source: where they come from; if it is a YAML file, the error names the lines.
        within: where in the source they stand, such as ``controllers.PID.settings``.

    Raises:
        UnknownKeyError: unknown key, alone or among other mistakes; also a ``TypeError``.
        ConfigurationError: wrong type, or a value outside its bounds.
    """
    if not isinstance(values, Mapping):
        raise ConfigurationError(
            f"{source}{': ' * bool(within)}{within}: must be a mapping of settings, not {kind_of_value(values)}"
        )
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        raise described(model, error, values, source, within, _lines_of(source, within)) from None


def _lines_of(file: str, within: str) -> Callable[[Sequence[int | str], Any], int | None]:
    """A function that finds the line of a YAML file in which a value stands, by its path below ``within``.

    It gives ``None`` if the file does not hold this value: keywords may replace what a file says.
    """
    loader, root = _Loader(""), None
    if file.endswith((".yaml", ".yml")):
        with contextlib.suppress(ConfigurationError, yaml.YAMLError, RecursionError):
            loader = _Loader(read_text(file))
            root = loader.get_single_node()

    def line_of(path: Sequence[int | str], value: Any) -> int | None:
        node, line = root, None
        for part in [*(within.split(".") if within else []), *path]:
            if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                key = node = node.value[part]
            else:
                pairs = node.value if isinstance(node, yaml.MappingNode) else []
                key, node = next(((key, inner) for key, inner in pairs if key.value == part), (None, None))
            if key is None:  # a missing field belongs to the line of its group
                return line if isinstance(value, Mapping | list) else None
            line = key.start_mark.line + 1
        same = not isinstance(node, yaml.ScalarNode) or repr(loader.construct_object(node)) == repr(value)
        return line if same else None

    return line_of


def read_text(path: str | Path, largest: int = LARGEST_FILE, other_encoding: str | None = None) -> str:
    """Read a UTF-8 text of at most ``largest`` bytes; one that is not UTF-8 is read in the other encoding, if given.

    Raises:
        ConfigurationError: the file is missing, unreadable, too large, or in neither encoding.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        name = str(path) if len(str(path)) < 1000 else f"{str(path)[:100]}…{str(path)[-100:]}"
        raise ConfigurationError(f"{name}: cannot be read: {error.strerror}") from None
    except ValueError:  # it holds a null or a surrogate
        raise ConfigurationError(f"{str(path)!a}: is no possible file name") from None
    if len(content) > largest:
        raise ConfigurationError(f"{path}: is larger than {largest / 1e6:g} MB")
    for encoding in ("utf-8-sig", other_encoding):
        if encoding is not None:
            with contextlib.suppress(UnicodeDecodeError):
                return content.decode(encoding)
    raise ConfigurationError(f"{path}: cannot be read: not a text in UTF-8")


class _Loader(yaml.SafeLoader):
    """Reads only YAML's safe values; ``1e5`` and ``060`` are decimals, a date is text; an error names the line."""

    yaml_implicit_resolvers = {
        first: [entry for entry in entries if not entry[0].endswith((":timestamp", ":int", ":float"))]
        for first, entries in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    anchored = aliases = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        alias = isinstance(event, yaml.AliasEvent)
        anchor = not alias and event.anchor is not None
        self.aliases += alias
        if alias and (self.anchored or self.aliases > MOST_ALIASES):
            raise _problem(f"more than {MOST_ALIASES} aliases, or one within an anchor", event)
        self.anchored += anchor
        node = super().compose_node(parent, index)
        self.anchored -= anchor
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = set()
        for key, _ in node.value:
            name = (key.tag, str(key.value))
            if name in names:
                raise _problem(f"the key '{name[1][:40]}' stands here twice", key)
            names.add(name)
        return super().construct_mapping(node, deep)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            value = super().construct_object(node, deep)
            if isinstance(value, int):
                float(value)  # beyond the largest number that a setting can have, text of it may be impossible
            return value
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            raise _problem("a value that YAML cannot read", node) from None


_FIRST = list("-+.0123456789")
# Numbers as people write them: YAML 1.1 reads 060 as 48 and 1:30 as 90.
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"[-+]?(0|[1-9][\d_]*|0x[\da-fA-F]+)$"), _FIRST)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?((\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$"),
    _FIRST,
)

_IN_PLAIN_WORDS = (
    (r"found character '\\t'", "a tab; indent with spaces", False),
    (r"mapping values are not allowed here", "a colon where none can stand; is the indentation right?", False),
    (r"expected <block end>", "wrong indentation, or a bracket too many", False),
    (r"expected ',' or '[}\]]'", "the bracket that opens here is not closed, or a comma is missing", True),
    (r"could not find expected ':'", "a colon with a space after it is missing", True),
    (r"found unexpected end of stream", "the quotation mark that opens here is not closed", True),
)
"""Patterns of what PyYAML says, what an engineer understands, and whether the line is where the faulty part begins."""


def _problem(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML mapping.

    Raises:
        ConfigurationError: the file is missing, unreadable, empty or too large, is not YAML or not a mapping, repeats a
            key, or multiplies by nested aliases.
    """
    text = read_text(path)
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        values = loader.construct_document(node) if node is not None else {}
    except RecursionError:
        raise ConfigurationError(f"{path}: not valid YAML: too many levels") from None
    except yaml.YAMLError as error:
        problem = str(getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML")
        known = ((words, begins) for pattern, words, begins in _IN_PLAIN_WORDS if re.search(pattern, problem))
        words, begins = next(known, (problem, False))
        mark = getattr(error, "context_mark" if begins else "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise ConfigurationError(f"{path}: not valid YAML{line}: {' '.join(words.split())}") from None
    if values == {}:
        raise ConfigurationError(f"{path}: is empty")
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
    except (RecursionError, ValueError) as error:  # too many levels, or a number with too many digits
        raise ConfigurationError(f"{path}: not valid JSON: {str(error).partition(';')[0]}") from None
    return _mapping(values, path)


def _mapping(values: Any, path: str | Path) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise ConfigurationError(f"{path}: must be a mapping of settings, not {kind_of_value(values)}")
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
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from None
