"""The leak levels of all pages in l/min at 100 bar, and the look of each, the same in all figures."""

from __future__ import annotations

from agents.report.canvas import Look

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

LOOKS = {
    0.01: Look("#14213d", "o", "-"),
    0.1: Look("#47207a", "s", (0, (7, 1.5))),
    0.3: Look("#8a2387", "D", (0, (4, 1.2))),
    1.0: Look("#bf2f5f", "^", (0, (5, 1.2, 1, 1.2))),
    2.0: Look("#d1493a", "v", (0, (1.5, 1))),
    4.0: Look("#de6a10", "P", "-"),
}
"""From a tight seal (dark) to a severe leak (light)."""


def flow(leak: float) -> str:
    """A leak with its unit."""
    return f"{leak:g} l/min"
