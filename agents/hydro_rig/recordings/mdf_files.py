"""Channels of MDF4 files: each group of channels has its own time stamps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hydro_env.types import Floats
from hydro_rig.recordings.mat_files import Channel

PIECE = 8_000_000  # bytes of a group that are in memory at once


def read_mdf(file: Any) -> list[Channel]:
    """All numeric channels of an open file."""
    return [channel for number in range(len(file.groups)) for channel in _group(file, number)]


def mdf_pieces(file: Any) -> Iterator[list[Channel]]:
    """Pieces of the group with most records, and of the others what lies between their stamps."""
    file.configure(read_fragment_size=PIECE)
    counts = [int(group.channel_group.cycles_nr) for group in file.groups]
    order = sorted((number for number, count in enumerate(counts) if count), key=lambda number: -counts[number])
    if not order:
        return
    others = {number: (_fragments(file, number), list[Channel]()) for number in order[1:]}
    for lead in _fragments(file, order[0]):
        if not lead or lead[0].stamps is None:
            continue
        begin, end = lead[0].stamps[0], lead[0].stamps[-1]
        found = list(lead)
        for number, (fragments, held) in others.items():
            while not held or _stamps(held)[-1] <= end:
                more = next(fragments, None)
                if more is None:
                    break
                held = [_after(one, two) for one, two in zip(held, more, strict=True)] if held else more
            if held:
                # Beyond both ends another sample, between which values are interpolated.
                first = max(int(np.searchsorted(_stamps(held), begin)) - 1, 0)
                last = int(np.searchsorted(_stamps(held), end, side="right"))
                found += [_some(channel, first, last + 1) for channel in held]
                held = [_some(channel, max(last - 1, 0), len(_stamps(held))) for channel in held]
            others[number] = fragments, held
        yield found


def _fragments(file: Any, number: int) -> Iterator[list[Channel]]:
    """The channels of a group, some records at a time; ``MDF.get`` with a range of records would read all of them."""
    inner = getattr(file, "_mdf", file)
    for fragment in inner._load_data(inner.groups[number]):
        yield _group(file, number, data=fragment)


def _stamps(channels: Sequence[Channel]) -> Floats:
    stamps = channels[0].stamps
    assert stamps is not None
    return stamps


def _some(channel: Channel, first: int, end: int) -> Channel:
    return channel._replace(values=channel.values[first:end], stamps=_stamps([channel])[first:end])


def _after(one: Channel, two: Channel) -> Channel:
    values, stamps = np.concatenate([one.values, two.values]), np.concatenate([_stamps([one]), _stamps([two])])
    return one._replace(values=values, stamps=stamps)


def _group(file: Any, number: int, **records: Any) -> list[Channel]:
    """The numeric channels of a group; ``records``: a part of them, as in ``MDF.get``."""
    found = []
    for place in range(len(file.groups[number].channels)):
        if place == file.masters_db.get(number):
            continue
        signal = file.get(group=number, index=place, **records)
        if np.ndim(signal.samples) == 1 and np.issubdtype(signal.samples.dtype, np.number):
            # Copies: what the library gives are views of the records of all channels.
            stamps = np.array(signal.timestamps, dtype=np.float64)
            found.append(Channel(f"group {number}", signal.name, signal.unit or "", signal.samples.copy(), stamps))
    return found
