"""The leak levels of the figures in l/min at 100 bar."""

from __future__ import annotations

TIGHT, MODERATE, SEVERE = 0.01, 1.0, 4.0
"""A new seal; the bound between moderate and severe; the largest leak of the task."""

LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
"""Levels for a curve over the leak."""

FINE_BELOW = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0)
FINE_ABOVE = (0.01, 0.03, 0.1, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0)
"""More levels in a range where a result changes fast: among incipient leaks, or among severe ones."""

LINES = (0.01, 0.3, 1.0, 2.0, 4.0)
"""Levels for the lines of a figure."""

FEW_LINES = (0.01, 0.3, 1.0, 4.0)
SCAN = (0.01, 0.1, 0.3, 1.0, 4.0)
"""Like LINES, for figures with room for fewer lines, or with more weight on incipient leaks."""


def flow(leak: float) -> str:
    """A leak with its unit."""
    return f"{leak:g} l/min"
