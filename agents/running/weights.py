"""Weights as safetensors with a JSON beside them: loading runs no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hydro_env import ConfigurationError
from hydro_env.files import write_whole

FORMAT_VERSION = 1


def save_weights(path: str | Path, kind: str, tensors: Mapping[str, NDArray[Any]], settings: Mapping[str, Any]) -> Path:
    """Write ``path``.safetensors and ``path``.json, each whole or not at all.

    Args:
        path: without suffix (a suffix ``.safetensors`` is taken off).
        kind: what the weights are of; ``load_weights`` checks it.
        tensors: arrays by name.
        settings: everything else that inference needs, as JSON.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    path = _stem(path)
    arrays = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
    description = {"format": f"hydro_env {kind}", "format_version": FORMAT_VERSION, **settings}
    write_whole(path.with_suffix(".safetensors"), save_tensors(arrays))
    write_whole(path.with_suffix(".json"), (json.dumps(description, indent=2) + "\n").encode())
    return path.with_suffix(".safetensors")


def load_weights(path: str | Path, kind: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read weights and settings.

    Raises:
        ConfigurationError: a file is missing, unreadable, damaged, or of something else.
    """
    path = _stem(path)
    description = path.with_suffix(".json")
    try:
        settings = json.loads(description.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{description}: cannot be read: {error.strerror}") from None
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise ConfigurationError(f"{description}: not a JSON file") from None
    found = settings.get("format") if isinstance(settings, dict) else None
    if found != f"hydro_env {kind}" or settings.get("format_version") != FORMAT_VERSION:
        raise ConfigurationError(f"{description}: holds {found!r}, not the 'hydro_env {kind}' of format 1 asked for")
    weights = path.with_suffix(".safetensors")
    try:
        tensors = load_tensors(weights.read_bytes())
    except OSError as error:
        raise ConfigurationError(f"{weights}: cannot be read: {error.strerror}") from None
    except SafetensorError as error:
        raise ConfigurationError(f"{weights}: damaged or not a safetensors file ({error})") from None
    return tensors, settings


def require(tensors: Mapping[str, NDArray[Any]], shapes: Mapping[str, tuple[int, ...]], where: str | Path) -> None:
    """Check that the tensors are those of the network that is to be built.

    Raises:
        ConfigurationError: one is missing, of another shape, or holds NaN.
    """
    for name, shape in shapes.items():
        if name not in tensors:
            raise ConfigurationError(f"{where}: holds no tensor '{name}'")
        if tensors[name].shape != shape:
            raise ConfigurationError(f"{where}: tensor '{name}' has shape {tensors[name].shape}, needed is {shape}")
        if not np.isfinite(tensors[name]).all():
            raise ConfigurationError(f"{where}: tensor '{name}' holds values that are not finite")


def optimiser_tensors(optimiser: Any) -> dict[str, NDArray[Any]]:
    """The memory of a torch optimiser as arrays, ``optimiser.<parameter>.<name>``."""
    return {
        f"optimiser.{index}.{name}": np.asarray(value.detach().cpu().numpy())
        for index, entry in optimiser.state_dict()["state"].items()
        for name, value in entry.items()
    }


def restore_optimiser(optimiser: Any, tensors: Mapping[str, NDArray[Any]]) -> None:
    """Put back what :func:`optimiser_tensors` took."""
    import torch

    state: dict[int, dict[str, Any]] = {}
    for name, value in tensors.items():
        if name.startswith("optimiser."):
            _, index, key = name.split(".")
            state.setdefault(int(index), {})[key] = torch.from_numpy(np.array(value))
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def _stem(path: str | Path) -> Path:
    path = Path(path)
    return path.with_suffix("") if path.suffix in (".safetensors", ".json") else path
