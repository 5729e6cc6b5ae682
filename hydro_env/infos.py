"""Infos of a vector environment in Gymnasium's layout: arrays of values, and masks of existing values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]


def names_of(codes: NDArray[np.int64], known: Sequence[str], present: Flags) -> NDArray[np.object_]:
    """The name of each code; None if an axis is not present.

    Filled code by code: NumPy 2.0 to 2.2.2 crash when two threads repeat an array of objects.
    """
    names = np.empty(len(codes), dtype=object)
    for code in np.bincount(codes).nonzero()[0].tolist():
        names[(codes == code) & present] = known[code]
    return names


def present_values(values: Mapping[str, NDArray[np.float64]], present: Flags) -> dict[str, Any]:
    """Each array where an axis is present and its value is not 0, and a mask of those axes; nothing without any."""
    found: dict[str, Any] = {}
    for name, array in values.items():
        exists = present & (array != 0.0)
        if exists.any():
            found |= {name: np.where(exists, array, 0.0), f"_{name}": exists}
    return found
