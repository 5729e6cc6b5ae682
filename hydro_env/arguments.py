"""Checks of the arguments that callers pass to the environments; a wrong one raises an error of one line."""

import reprlib
from typing import Any

import numpy as np

from hydro_env.errors import ConfigurationError
from hydro_env.types import Floats


def shown(value: Any) -> str:
    """A value in one short line."""
    return " ".join(reprlib.repr(value).split())


def whole_number(name: str, value: Any, low: int, high: int | None = None) -> int:
    """A whole number, of Python or NumPy, within its bounds.

    Raises:
        ConfigurationError: the value is not a whole number (``True`` is not one), too small or too large.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        number = int(value)
        if number >= low and (high is None or number <= high):
            return number
    allowed = f"of at least {low}" if high is None else f"within {low} to {high}"
    raise ConfigurationError(f"{name} = {shown(value)}: must be a whole number {allowed}")


def numbers(values: Any) -> Floats | None:
    """A new array of numbers; None if ``values`` are anything else (text, truth values, objects, ragged rows)."""
    try:
        given = np.asarray(values)
    except (TypeError, ValueError, RuntimeError):
        return None
    return given.astype(np.float64) if given.dtype.kind in "fiu" else None
