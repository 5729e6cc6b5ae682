"""Numbers as text, the same in all tables, messages and pages."""

from __future__ import annotations

import numpy as np

MOST_DECIMALS = 9


def number(value: float, decimals: int | None = None, digits: int = 3, signed: bool = False) -> str:
    """A number with ``digits`` significant digits, or with ``decimals`` decimals; without exponent; – for NaN.

    The minus is a minus sign (−), and zero has no sign; ``signed`` adds a plus to positive numbers.
    """
    if not np.isfinite(value):
        return "–" if np.isnan(value) else "∞" if value > 0 else "−∞"
    text = f"{value:{'+' if signed else ''}.{decimals_for(value, digits) if decimals is None else decimals}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text.replace("-", "−")


def decimals_for(size: float, digits: int = 3) -> int:
    """Number of decimals for ``digits`` significant digits of a value of this size."""
    if size == 0.0 or not np.isfinite(size):
        return 0
    return min(max(digits - 1 - int(np.floor(np.log10(abs(size)))), 0), MOST_DECIMALS)
