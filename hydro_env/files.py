"""Configuration is data: frozen validated groups, read from YAML, wrong ones answered with one line."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from hydro_env.errors import ConfigurationError, UnknownKeyError


class Group(BaseModel):
    """A frozen group of settings; unknown keys and NaN are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())


ModelType = TypeVar("ModelType", bound=BaseModel)


def validate(model: type[ModelType], values: Mapping[str, Any], source: str) -> ModelType:
    """Build ``model`` from ``values``; a wrong one is answered with one line that names ``source`` and the field.

    Raises:
        UnknownKeyError: unknown key; also a ``TypeError``.
        ConfigurationError: wrong type, or a value outside its bounds.
    """
    if not isinstance(values, Mapping):
        raise ConfigurationError(f"{source}: a mapping of settings is needed, not {type(values).__name__}")
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        unknown = error.errors(include_url=False)[0]["type"] == "extra_forbidden"
        kind = UnknownKeyError if unknown else ConfigurationError
        raise kind(_one_line(model, error, source)) from None


def _one_line(model: type[BaseModel], error: ValidationError, source: str) -> str:
    first = error.errors(include_url=False)[0]
    path = [str(part) for part in first["loc"]]
    where = ".".join(path)
    if first["type"] == "extra_forbidden":
        known = ", ".join(_fields_at(model, path[:-1])) or "none"
        message = f"unknown key; known here: {known}"
    elif first["type"] == "missing":
        message = "is missing"
    else:
        message = first["msg"].removeprefix("Value error, ")
        message = message[0].lower() + message[1:]
        message = _both_bounds(model, path, first["type"]) or message
    value = first.get("input")
    shown = f" = {value!r}" if isinstance(value, (int, float, str, bool, list)) and len(repr(value)) < 60 else ""
    unit = _unit_at(model, path)
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    line = f"{source}: {where}{shown}: {message}{f' (unit: {unit})' if unit else ''}{more}"
    return line.replace(": :", ":").replace("\n", " ")


BOUNDS = {
    "ge": ("greater_than_equal", "greater than or equal to"),
    "gt": ("greater_than", "greater than"),
    "le": ("less_than_equal", "less than or equal to"),
    "lt": ("less_than", "less than"),
}
"""By the name of a bound: pydantic's type of error, and the words for it."""


def _both_bounds(model: type[BaseModel], path: list[str], error: str) -> str | None:
    """All finite bounds of the field, where one of them was broken; pydantic tells that one alone."""
    if error not in (kind for kind, _ in BOUNDS.values()):
        return None
    found = []
    for name, (_, words) in BOUNDS.items():
        for constraint in _constraints_at(model, path):
            bound = getattr(constraint, name, None)
            if bound is not None and math.isfinite(bound):
                found.append(f"{words} {bound:.12g}")
    return f"input should be {' and '.join(found)}" if found else None


def _constraints_at(model: type[BaseModel], path: list[str]) -> list[Any]:
    """The constraints of a field, or of the entries of a field that holds many (``references.weights.step``)."""
    _, info = _field_at(model, path)
    if info is not None:
        return list(info.metadata)
    _, info = _field_at(model, path[:-1])
    entries = get_args(getattr(info, "annotation", None))
    constraints: list[Any] = []
    for part in getattr(entries[-1], "__metadata__", ()) if entries else ():
        constraints += getattr(part, "metadata", [part])
    return constraints


def _field_at(model: type[BaseModel], path: list[str]) -> tuple[Any, Any]:
    """The model and the field that ``path`` leads to; (None, None) where it leads into something else."""
    current: Any = model
    info = None
    for part in path:
        fields = getattr(current, "model_fields", None)
        if fields is None or part not in fields:
            return None, None
        info = fields[part]
        current = info.annotation
    return current, info


def _fields_at(model: type[BaseModel], path: list[str]) -> list[str]:
    found, _ = _field_at(model, path)
    return list(getattr(found, "model_fields", {}))


def _unit_at(model: type[BaseModel], path: list[str]) -> str | None:
    _, info = _field_at(model, path)
    extra = getattr(info, "json_schema_extra", None)
    return extra.get("unit") if isinstance(extra, dict) else None


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML mapping.

    Raises:
        ConfigurationError: the file is missing, unreadable, not YAML, or not a mapping.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise ConfigurationError(f"{path}: cannot be read: {reason}") from None
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or "not YAML").replace("\n", " ")
        raise ConfigurationError(f"{path}: not valid YAML{line}: {problem}") from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigurationError(f"{path}: a mapping of settings is needed, not {type(values).__name__}")
    return values


def write_yaml(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write a mapping as YAML, whole or not at all."""
    write_whole(path, yaml.safe_dump(dict(values), sort_keys=False, allow_unicode=True).encode())


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file so that a reader finds the old content or the new one, never a part.

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
