"""Weights as safetensors with a JSON file, checkpoints as one file; loading runs no code."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env import ConfigurationError
from hydro_env.errors import at
from hydro_env.files import write_whole
from hydro_env.types import Array, Arrays, ByName

Tensors = Mapping[str, Array]
CHECKPOINT_VERSION, WEIGHTS_VERSION = 1, 2
_DESCRIPTION, _DIGEST = "description", "digest"


def save_weights(path: str | Path, kind: str, tensors: Tensors, settings: ByName) -> Path:
    """Write ``path``.safetensors and ``path``.json, each atomically; the JSON holds a digest of both, and the settings.

    A suffix ``.safetensors`` or ``.json`` of the path is removed; any other dot belongs to the name.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    weights, description = weight_files(path)
    content = _packed(tensors)
    stored = {"format": f"hydro_env {kind}", "format_version": WEIGHTS_VERSION, **settings}
    stored[_DIGEST] = digest_of_weights(content, stored)
    write_whole(weights, content)
    write_whole(description, (json.dumps(stored, indent=2) + "\n").encode())
    return weights


def load_weights(path: str | Path, kind: str) -> tuple[Arrays, ByName]:
    """Read weights and settings; ``path`` is their name.

    Raises:
        ConfigurationError: a file is missing, unreadable, damaged, changed since it was written, or of another kind.
    """
    weights, description = weight_files(path)
    settings = _described(_content(description), kind, description, WEIGHTS_VERSION)
    content, digest = _content(weights), settings.pop(_DIGEST, None)
    if digest != digest_of_weights(content, settings):
        raise ConfigurationError(f"{weights}: damaged: it and {description.name} differ from their digest")
    return _unpacked(content, weights), settings


def kind_of_weights(path: str | Path) -> str:
    """The kind that the JSON of weights names; empty: there are no weights with this name."""
    weights, description = weight_files(path)
    if not (weights.is_file() and description.is_file()):
        return ""
    with suppress(ValueError, AttributeError, RecursionError):  # no JSON, or no mapping
        return str(json.loads(_content(description)).get("format", "")).removeprefix("hydro_env ")
    return ""


def weight_files(path: str | Path) -> tuple[Path, Path]:
    """The file of tensors and the file of settings of a name.

    Raises:
        ConfigurationError: the path has no file name, such as ``.`` or ``/``.
    """
    path = Path(path)
    name = path.name.removesuffix(".safetensors").removesuffix(".json") if path.name else ""
    if name in ("", "..") or "\0" in str(path):
        raise ConfigurationError(f"{str(path)!r}: must be the name of weights, with or without .safetensors")
    return path.with_name(f"{name}.safetensors"), path.with_name(f"{name}.json")


def save_checkpoint(path: Path, kind: str, tensors: Tensors, description: ByName) -> None:
    """Write arrays and their description (JSON) into one safetensors file, which keeps them together.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    text = json.dumps({"format": f"hydro_env {kind}", "format_version": CHECKPOINT_VERSION, **description})
    content = {**tensors, _DESCRIPTION: np.frombuffer(text.encode(), np.uint8)}
    write_whole(path, _packed({**content, _DIGEST: _digest(content)}))


def load_checkpoint(path: Path, kind: str) -> tuple[Arrays, ByName]:
    """Read what :func:`save_checkpoint` wrote.

    Raises:
        ConfigurationError: the file is missing, unreadable, damaged, or of another kind.
    """
    tensors = _unpacked(_content(path), path)
    digest = tensors.pop(_DIGEST, None)
    if digest is None or _DESCRIPTION not in tensors or not np.array_equal(digest, _digest(tensors)):
        raise ConfigurationError(f"{path}: damaged, or not a checkpoint of this version")
    return tensors, _described(tensors.pop(_DESCRIPTION).tobytes(), kind, path, CHECKPOINT_VERSION)


def _packed(tensors: Tensors) -> bytes:
    from safetensors.numpy import save

    return save({name: np.ascontiguousarray(array).reshape(array.shape) for name, array in tensors.items()})


def _digest(tensors: Tensors) -> NDArray[np.uint8]:
    return np.frombuffer(hashlib.sha256(_packed(tensors)).digest(), np.uint8)


def digest_of_weights(content: bytes, settings: ByName) -> str:
    """Digest of the file of tensors and of the settings, whatever the layout of their JSON."""
    text = json.dumps(json.loads(json.dumps(settings)), sort_keys=True)
    return hashlib.sha256(hashlib.sha256(content).digest() + text.encode()).hexdigest()


def _content(path: Path) -> bytes:
    with at(f"{path}: cannot be read"):
        return path.read_bytes()


def _unpacked(content: bytes, path: Path) -> Arrays:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return dict(load(content))
    except (SafetensorError, KeyError, TypeError, ValueError, OverflowError) as error:  # KeyError: BF16 and the like
        reason = str(error).replace("\n", " ")
        raise ConfigurationError(f"{path}: damaged or not a safetensors file of NumPy arrays ({reason})") from None


def _described(text: bytes, kind: str, path: Path, version: int) -> ByName:
    try:
        settings = json.loads(text.decode())
    except (ValueError, RecursionError):  # ValueError: also for bytes that are not text, and integers of 5000 digits
        raise ConfigurationError(f"{path}: not a JSON file") from None
    named = settings.get("format") if isinstance(settings, dict) else None
    if named != f"hydro_env {kind}" or settings.get("format_version") != version:
        must = f"'hydro_env {kind}' of format {version}"
        raise ConfigurationError(f"{path}: holds {str(named)[:60]!r}: must be {must}")
    return dict(settings)


# The state of a training ----------------------------------------------------------------------------------------------


def flat(state: Any, name: str) -> Arrays:
    """Copies of the arrays and tensors of nested mappings and tuples by name, ``name.key.field``; ``None`` has none.

    An array with named fields becomes bytes, which safetensors holds.
    """
    if state is None:
        return {}
    arrays: Arrays = {}
    if isinstance(state, Mapping | tuple):
        for key, part in _parts(state).items():
            arrays |= flat(part, f"{name}.{key}")
        return arrays
    if hasattr(state, "detach"):
        state = state.detach().cpu().numpy()
    array = np.array(state)
    if array.dtype.names:
        array = np.frombuffer(array.tobytes(), np.uint8)
    return {name: array}


def restored(like: Any, arrays: Tensors, name: str) -> Any:
    """A state with the structure of ``like`` and copies of the arrays of :func:`flat`."""
    if like is None:
        return None
    if isinstance(like, Mapping | tuple):
        parts = {key: restored(part, arrays, f"{name}.{key}") for key, part in _parts(like).items()}
        if isinstance(like, Mapping):
            return parts
        return getattr(like, "_make", tuple)(parts.values())
    if hasattr(like, "new_tensor"):
        return like.new_tensor(arrays[name])
    return arrays[name].view(like.dtype).reshape(like.shape).copy()


def _parts(state: Mapping[Any, Any] | tuple[Any, ...]) -> Mapping[Any, Any]:
    """The parts of a mapping, a named tuple or a tuple by key, field or number."""
    if isinstance(state, Mapping):
        return state
    return dict(zip(getattr(state, "_fields", range(len(state))), state, strict=True))


def restore_optimiser(optimiser: Any, arrays: Tensors, name: str) -> None:
    """Restore the state of a torch optimiser, of which :func:`flat` made arrays; before its first step it has none."""
    import torch

    state: dict[int, ByName] = {}
    for place, array in arrays.items():
        if place.startswith(f"{name}."):
            index, key = place.removeprefix(f"{name}.").split(".")
            state.setdefault(int(index), {})[key] = torch.from_numpy(array.copy())
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
