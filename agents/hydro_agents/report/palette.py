"""The colours of all figures and pages, each in a light and a dark theme.

Figures are drawn in the light colours. On a page each colour becomes a CSS variable that follows the reader's theme;
files beside the page keep the light colours.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import cycle
from typing import Any, NamedTuple


class Colour(NamedTuple):
    """A colour in both themes, as ``#rrggbb``."""

    light: str
    dark: str


NEUTRALS = {
    "paper": Colour("#ffffff", "#15171c"),
    "ink": Colour("#1d1d1f", "#e8e8ec"),
    "grey": Colour("#5c5c63", "#a9a9b2"),
    "line": Colour("#dcdce0", "#3b3d45"),
    "pale": Colour("#f6f6f8", "#1f2128"),
}

SERIES = {
    "blue": Colour("#0072b2", "#56b4e9"),
    "orange": Colour("#d55e00", "#f58f3c"),
    "green": Colour("#00805c", "#3fc196"),
    "purple": Colour("#b3508a", "#e592c1"),
    "gold": Colour("#8a6d00", "#d6b53c"),
    "violet": Colour("#6a4fb3", "#ab97ec"),
}
"""Controllers, detectors and other things side by side: after Okabe and Ito, for colour-blind readers."""

LEAKS = {
    0.01: Colour("#14213d", "#6f82c4"),
    0.1: Colour("#47207a", "#9d80d8"),
    0.3: Colour("#8a2387", "#cf86d0"),
    1.0: Colour("#bf2f5f", "#ef94a4"),
    2.0: Colour("#d1493a", "#f7b08c"),
    4.0: Colour("#de6a10", "#fbd58a"),
}
"""By leak in l/min at 100 bar: from a tight seal (dark) to a severe leak (light)."""

MEANINGS = {
    "better": SERIES["blue"],
    "worse": SERIES["orange"],
    "good": SERIES["green"],
    "doubtful": SERIES["gold"],
}
"""Judgements in tables and verdicts."""

STRONGEST = 50
"""Largest percentage of a colour in a table cell; with more, text loses its contrast."""


# Participants --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Look:
    """Colour, marker and line of a controller or a leak in all figures."""

    colour: str
    marker: str
    line: Any  # a linestyle of matplotlib

    @property
    def stroke(self) -> dict[str, Any]:
        """Options of a line."""
        return {"color": self.colour, "linestyle": self.line}


COLOURS = {name: colour.light for name, colour in SERIES.items()}
"""The light colours of SERIES, by name."""

MARKERS, LINES = "osD^vP", ("-", "--", "-.", ":")

_DASHES: tuple[Any, ...] = ("-", (0, (7, 1.5)), (0, (4, 1.2)), (0, (5, 1.2, 1, 1.2)), (0, (1.5, 1)), "-")

LEAK_LOOKS = {
    leak: Look(colour.light, marker, line)
    for (leak, colour), marker, line in zip(LEAKS.items(), MARKERS, _DASHES, strict=True)
}
"""By leak, from a tight seal (dark) to a severe leak (light); neighbours differ in their dashes too."""


def looks_of(names: Iterable[Any]) -> dict[Any, Look]:
    """The look of each controller, by its position in the list."""
    looks = zip(cycle(COLOURS.values()), cycle(MARKERS), cycle(LINES))
    return {name: Look(*look) for name, look in zip(names, looks, strict=False)}


# Themes --------------------------------------------------------------------------------------------------------------


def _variables() -> dict[str, Colour]:
    """Every colour by the name of its CSS variable."""
    series = {f"series-{number}": colour for number, colour in enumerate(SERIES.values(), 1)}
    leaks = {f"leak-{number}": colour for number, colour in enumerate(LEAKS.values(), 1)}
    return {**NEUTRALS, **series, **leaks, **MEANINGS}


VARIABLES = _variables()


def css_rules() -> str:
    """Rules of a style that declare all variables in both themes."""
    light, dark = (
        " ".join(f"--{name}: {getattr(colour, theme)};" for name, colour in VARIABLES.items())
        for theme in ("light", "dark")
    )
    return f":root {{ {light} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"


def themed(svg: str) -> str:
    """A drawing with CSS variables instead of its light colours."""
    names = {colour.light: name for name, colour in reversed(VARIABLES.items())}
    names |= {"#000000": "ink"}
    return re.sub(r"#[0-9a-f]{6}\b", lambda m: f"var(--{names[m[0]]})" if m[0] in names else m[0], svg)
