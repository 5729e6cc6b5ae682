"""Files of channels, which may have their own time stamps: MDF4, TDMS and MAT.

A struct of a MAT file that holds a time is one channel with its own stamps; a group of an MDF4 file shares them.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_env.types import Floats

TIMES = ("time", "t", "zeit", "timestamps")
CONTENTS = ("values", "value", "data", "signals", "signal")
"""Names of the fields of a MAT struct that hold its time, and its numbers, in lower case."""


class Channel(NamedTuple):
    """A channel with or without (None) its own time stamps."""

    group: str
    name: str
    unit: str
    values: Any
    stamps: Floats | None


# MDF4 ---------------------------------------------------------------------------------------------------------------


def read_mdf(path: Path, asammdf: Any) -> list[Channel]:
    """All numeric channels."""
    channels: list[Channel] = []
    with asammdf.MDF(path) as file:
        for number in range(len(file.groups)):
            channels += _group(file, number)
    return channels


def _group(file: Any, number: int) -> list[Channel]:
    """The numeric channels of a group."""
    channels = []
    for place in range(len(file.groups[number].channels)):
        if place == file.masters_db.get(number):
            continue
        signal = file.get(group=number, index=place)
        if np.ndim(signal.samples) == 1 and np.issubdtype(signal.samples.dtype, np.number):
            # Copies: what the library gives are views of the records of all channels.
            stamps = np.array(signal.timestamps, dtype=np.float64)
            channels.append(Channel(f"group {number}", signal.name, signal.unit or "", signal.samples.copy(), stamps))
    return channels


# TDMS ---------------------------------------------------------------------------------------------------------------


def read_tdms(path: Path, nptdms: Any) -> list[Channel]:
    """All channels with values; only a waveform has stamps, otherwise a column of the file is the time."""
    channels = []
    for group in nptdms.TdmsFile.read(path).groups():
        for channel in group.channels():
            values, properties = channel[:], channel.properties
            if len(values):
                stamps = channel.time_track() if "wf_increment" in properties else None
                unit = str(properties.get("unit_string", ""))
                channels.append(Channel(group.name, channel.name, unit, values, stamps))
    return channels


# MAT ----------------------------------------------------------------------------------------------------------------


def read_mat(path: Path, scipy_io: Any) -> list[Channel]:
    """Vectors and structs of a MAT file."""
    try:
        content = scipy_io.loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        with importlib.import_module("h5py").File(path) as file:
            content = {name: _of_hdf5(item) for name, item in file.items() if not name.startswith("#")}
    channels: list[Channel] = []
    for name, value in content.items():
        if not name.startswith("__"):
            channels += _channels_of(name, value)
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
        fields = {key.lower(): part for key, part in value.items()}
        time = next((_vector(fields[key]) for key in TIMES if key in fields), None)
        stamps = time if time is not None else stamps
        unit = next((str(fields[key]) for key in ("unit", "units") if key in fields), unit)
        for key, part in value.items():
            if key.lower() not in TIMES or time is None:
                yield from _channels_of(name if key.lower() in CONTENTS else f"{name}.{key}", part, stamps, unit)
    elif isinstance(value, list):
        for number, part in enumerate(value, 1):
            label = part.get("label") if isinstance(part, dict) else None
            yield from _channels_of(str(label) if label else f"{name}.{number}", part, stamps, unit)
    else:
        values = _vector(value)
        if values is not None and (stamps is None or len(values) == len(stamps)):
            yield Channel("", name, unit, values, stamps)


def _vector(value: Any) -> Floats | None:
    """Numbers (n,), n at least 2; ``None``: something else."""
    whole = isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value)
    return np.ravel(value).astype(np.float64) if whole and value.size == max(value.shape, default=0) > 1 else None


def _time_of(channels: Sequence[Channel]) -> Floats | None:
    """The time among vectors of one length: the only one that rises throughout, or that of them with such a name."""
    rising = [channel for channel in channels if np.all(np.diff(channel.values) > 0.0)]
    if len(rising) > 1:
        rising = [channel for channel in rising if channel.name.lower() in TIMES]
    return np.asarray(rising[0].values) if len(rising) == 1 else None
