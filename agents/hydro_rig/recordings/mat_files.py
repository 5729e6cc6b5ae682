"""MAT files as channels: vectors, and structs that hold a channel with its own time."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_env.types import Floats

TIMES = ("time", "t", "zeit", "timestamps")
CONTENTS = ("values", "value", "data", "signals", "signal")
"""Names of the fields of a struct that hold its time, and its numbers, in lower case."""


class Channel(NamedTuple):
    """A channel with or without (None) its own time stamps."""

    group: str
    name: str
    unit: str
    values: Any
    stamps: Floats | None


def read_mat(path: Path, scipy_io: Any) -> list[Channel]:
    """Vectors and structs of a MAT file; a struct with its time is one channel with its own time stamps."""
    try:
        content = scipy_io.loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        with importlib.import_module("h5py").File(path) as file:
            content = {name: _of_hdf5(item) for name, item in file.items() if not name.startswith("#")}
    channels = [
        channel for name, value in content.items() if not name.startswith("__") for channel in _channels_of(name, value)
    ]
    lengths = {len(channel.values) for channel in channels if channel.stamps is None}
    if len(lengths) > 1:
        times = {length: _time_of([c for c in channels if len(c.values) == length]) for length in lengths}
        channels = [c if c.stamps is not None else c._replace(stamps=times[len(c.values)]) for c in channels]
    return channels


def _of_hdf5(item: Any) -> Any:
    """A group as dict, a text as str, numbers as array."""
    if hasattr(item, "items"):
        return {name: _of_hdf5(part) for name, part in item.items()}
    values = item[()]
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, np.ravel(values)))
    return np.squeeze(values)


def _channels_of(name: str, value: Any, stamps: Floats | None = None, unit: str = "") -> Iterator[Channel]:
    """The channels in a variable of a MAT file: a vector, or a struct of vectors, of structs, or of a list of them."""
    if isinstance(value, dict):
        named = {key.lower(): key for key in value}
        time = next((_vector(value[named[key]]) for key in TIMES if key in named), None)
        stamps = time if time is not None else stamps
        unit = next((str(value[named[key]]) for key in ("unit", "units") if key in named), unit)
        for key, part in value.items():
            if key.lower() in TIMES and time is not None:
                continue
            yield from _channels_of(name if key.lower() in CONTENTS else f"{name}.{key}", part, stamps, unit)
    elif isinstance(value, list):
        for number, part in enumerate(value, 1):
            own = part.get("label") if isinstance(part, dict) else None
            yield from _channels_of(str(own) if own else f"{name}.{number}", part, stamps, unit)
    else:
        values = _vector(value)
        if values is not None and (stamps is None or len(values) == len(stamps)):
            yield Channel("", name, unit, values, stamps)


def _vector(value: Any) -> Floats | None:
    """Numbers (n,), n at least 2; ``None``: something else."""
    whole = isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value)
    return np.ravel(value).astype(np.float64) if whole and value.size == max(value.shape, default=0) > 1 else None


def _time_of(channels: list[Channel]) -> Floats | None:
    """The time among vectors of one length: the only one that rises throughout, or that of them with such a name."""
    rising = [channel for channel in channels if np.all(np.diff(channel.values) > 0.0)]
    if len(rising) > 1:
        rising = [channel for channel in rising if channel.name.lower() in TIMES]
    return np.asarray(rising[0].values) if len(rising) == 1 else None
