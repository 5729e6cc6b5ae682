"""Numbers, lists and durations as text, the same on all pages; and the templates of pages."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from hydro_agents.running.text import decimals_for as decimals_for
from hydro_agents.running.text import number as number


def setting(value: float) -> str:
    """A setting in its shortest form: 0.01, 4, −30."""
    return f"{value:g}".replace("-", "−")


def span(low: float, high: float, decimals: int = 0) -> str:
    """A range: 1 to 4."""
    return f"{number(low, decimals)} to {number(high, decimals)}"


def listed(parts: Sequence[str]) -> str:
    """Parts as a list in a sentence: a, b and c."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def duration(seconds: float) -> str:
    """A duration in seconds, minutes or hours, as text."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def unbroken(text: str) -> str:
    """The text with every number kept on one line with its unit."""
    return re.sub(r"(?<=[\d×]) (?=(%|mm|l/min)(?!\w)|\d)", "\u00a0", text)


FAMILY_NAMES = {
    "step": "steps",
    "point_to_point": "point-to-point moves",
    "ramp": "ramps",
    "sine": "sines",
    "multi_sine": "sums of sines",
    "start_stop": "start–stop runs",
    "user": "own reference",
}


def family_name(family: str) -> str:
    """Readable name of a family of references."""
    return FAMILY_NAMES.get(family, family)


def correction_name(name: str, base: str) -> str:
    """The name of a policy that corrects another controller: "PPO on flow linearisation", "PPO on PID"."""
    return f"{name} on {base if base[:2].isupper() else base[:1].lower() + base[1:]}"


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column names its rows."""

    caption: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    groups: tuple[tuple[str, int], ...] = ()  # (title, columns) above the header, after the first column


def templates(*folders: Path, prose: bool = False) -> jinja2.Environment:
    """Templates of some folders and of this one: HTML, or prose with free line breaks.

    Filters: ``n`` is :func:`number`, ``s`` is :func:`setting`.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([*folders, Path(__file__).parent]),
        autoescape=not prose,
        undefined=jinja2.StrictUndefined,
        trim_blocks=not prose,
        lstrip_blocks=not prose,
    )
    environment.filters.update({"n": number, "s": setting})
    return environment
