"""Configuration as data: frozen validated groups, read from YAML; an error names every mistake in one line."""

import codecs
import json
import os
import re
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar, cast

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator, model_validator

from hydro_env.errors import ConfigurationError, at
from hydro_env.field_mistakes import described
from hydro_env.types import ByName
from hydro_env.units import in_si

LARGEST_FILE = 100_000  # largest size of a configuration file in bytes; the largest of this project has two thousand
MOST_ALIASES = 100  # in a YAML file; none may stand within an anchor, because nested aliases multiply


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
            raise ConfigurationError(f"{name}: takes keywords alone, not {type(arguments[0]).__name__}")
        try:
            return super().__call__(**values)
        except ValidationError as error:
            raise described(model, error, values, name) from None


whole_group = model_validator(mode="after")  # marks a check of a group whose fields are valid


class Group(BaseModel, metaclass=_Checked):
    """A frozen group of settings; unknown keys, NaN, and intervals that do not rise within their bounds are errors."""

    def __hash__(self) -> int:
        return hash(repr(self))  # a group may hold mappings

    def changed(self, **fields: Any) -> Self:
        """A copy with other fields, which are not checked again."""
        return self.model_copy(update=fields)

    def to_yaml(self, path: str | Path) -> None:
        """Write all fields as YAML; reading it gives an equal object."""
        write_yaml(path, self.model_dump(mode="json"))

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

    @whole_group
    def _intervals_rise(self) -> Self:
        for name, info in type(self).model_fields.items():
            extra = info.json_schema_extra
            if isinstance(extra, dict) and "low" in extra:
                low, high = getattr(self, name)
                if not extra["low"] <= low <= high <= extra["high"]:
                    unit = "" if extra["unit"] == "1" else f" {extra['unit']}"
                    allowed = f"{extra['low']:g} to {extra['high']:g}{unit}"
                    raise ValueError(f"{name} = [{low:g}, {high:g}]: must rise within {allowed}")
        return self


ModelType = TypeVar("ModelType", bound=BaseModel)


def validate(model: type[ModelType], values: Any, source: object, within: str = "") -> ModelType:
    """Build ``model`` from ``values``; the error names ``source``, the place ``within`` it, and every mistake.

    Raises:
        UnknownKeyError: unknown key, alone or among other mistakes; also a ``TypeError``.
        ConfigurationError: wrong type, or a value outside its bounds.
    """
    if not isinstance(values, Mapping):
        place = f"{source}: {within}" if within else source
        raise ConfigurationError(f"{place}: must be a mapping of settings, not {type(values).__name__}")
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        raise described(model, error, values, source, within) from None


def encoding_of(content: bytes) -> str:
    """UTF-16 where a text begins with its mark, as PowerShell writes it; otherwise UTF-8."""
    return "utf-16" if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"


def read_text(path: str | Path) -> str:
    """Read a text in UTF-8 or marked UTF-16 of at most :data:`LARGEST_FILE` bytes.

    Raises:
        ConfigurationError: the file is missing, unreadable, too large, or in another encoding.
    """
    if "\0" in str(path):
        raise ConfigurationError(f"{str(path)!r}: cannot be read: no path holds a zero byte")
    with at(f"{path}: cannot be read"), open(path, "rb") as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise ConfigurationError(f"{path}: is larger than {LARGEST_FILE / 1e6:g} MB")
    try:
        return content.decode(encoding_of(content))
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: cannot be read: not a text in UTF-8") from None


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


_FIRST = list("-+.0123456789")
# Numbers as people write them: YAML 1.1 reads 060 as 48 and 1:30 as 90.
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"[-+]?(0|[1-9][\d_]*|0x[\da-fA-F]+)$"), _FIRST)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?((\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$"),
    _FIRST,
)


def _problem(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)


def read_yaml(path: str | Path) -> ByName:
    """Read a YAML mapping.

    Raises:
        ConfigurationError: the file is missing, unreadable, empty or too large, is not YAML or not a mapping, repeats a
            key, or multiplies by nested aliases.
    """
    text = read_text(path)
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        values = loader.construct_document(node) if node else {}
    except yaml.MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigurationError(f"{path}: not valid YAML{line}: {' '.join(str(error.problem).split())}") from None
    except (yaml.YAMLError, ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ConfigurationError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None
    if values == {}:
        raise ConfigurationError(f"{path}: is empty")
    return _mapping(values, path)


def read_json(path: str | Path) -> ByName:
    """Read a JSON object.

    Raises:
        ConfigurationError: the file is missing, unreadable or too large, is not JSON or not an object, repeats a key,
            or nests too deeply.
    """

    def unrepeated(pairs: list[tuple[str, Any]]) -> ByName:
        values = dict(pairs)
        if len(values) < len(pairs):
            raise ValueError("a key stands twice")
        return values

    text = read_text(path)
    try:
        values = json.loads(text, object_pairs_hook=unrepeated)
    except json.JSONDecodeError as error:
        raise ConfigurationError(f"{path}: not valid JSON in line {error.lineno}: {error.msg}") from None
    except (RecursionError, ValueError) as error:  # too many levels, or a number with too many digits
        raise ConfigurationError(f"{path}: not valid JSON: {str(error).partition(';')[0]}") from None
    return _mapping(values, path)


def _mapping(values: Any, path: str | Path) -> ByName:
    if not isinstance(values, dict):
        raise ConfigurationError(f"{path}: must be a mapping of settings, not {type(values).__name__}")
    for key in values:
        if not isinstance(key, str):
            raise ConfigurationError(f"{path}: {key!r} is a key: keys must be text")
    return values


def write_yaml(path: str | Path, values: ByName) -> None:
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
    with at(f"{path}: cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.write_bytes(content)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
