"""A map of columns guessed from headings that are not those of this project: from their words and units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import yaml

from hydro_env import ConfigurationError
from hydro_rig.recordings.columns import UNITS, split_heading

WORDS = {
    "time": r"time|t|zeit|timestamp|zeitstempel|datum|clock|sekunden|seconds",
    "command": r"command|cmd|voltage|spannung|control|u|ao\w*|valve|ventil|servo|stell\w*|ansteuer\w*|output|dac|input",
    "position": r"position|pos|x|dis\w*|weg|wegsensor|hub|stroke|lage|kolbenweg|kolbenposition|piston|extension",
    "pressure_a": r"(?:p|pressure|druck|press|pt)(?:a|1)|a|bore|cap|head|kolbenseit\w*|bodenseit\w*|1",
    "pressure_b": r"(?:p|pressure|druck|press|pt)(?:b|2)|b|rod|ringseit\w*|stangenseit\w*|ring|2",
    "load_pressure": r"(?:delta|diff\w*|load|last)(?:p|pressure|druck)|delta|dp|diff\w*",
    "spool_position": r"spool|schieber\w*|ventilschieber|lvdt|xv|ventilhub|kolbenschieber|ventilposition",
    "supply_pressure": r"(?:p|pressure|druck)(?:s|0)|supply|versorgung\w*|system\w*|pumpe\w*|pump",
    "tank_pressure": r"(?:p|pressure|druck)t|tank|return|rücklauf\w*|ruecklauf\w*",
    "flow": r"flow|q|durchfluss|volumenstrom|förderstrom",
    "oil_temperature": r"temperature|temp|temperatur|öltemperatur|oeltemperatur",
}
"""Usual words of headings, English and German, by signal."""

PRESSURE = r"p\w{0,2}|dp|pressure|druck\w*|press|pt\d*"  # words that say that a column holds a pressure
WANTED = r"soll\w*|ref\w*|setpoint|desired|target|demand|führung\w*"  # of wanted values, which are not measured ones
OF_CHAMBERS = ("pressure_a", "pressure_b", "load_pressure")
NEEDED = ("time", "command")
GUESSED = """# Guessed from the headings. Check columns, units and signs; a unit that no heading gives is assumed.
# If zero is at the end of the stroke, an offset of minus half the stroke moves it to mid-stroke.
"""


class UnknownHeadingsError(ConfigurationError):
    """A file without the headings of this project.

    ``guess`` is a map in YAML, guessed from the headings; ready to be saved and given with ``--map``.
    """

    def __init__(self, message: str, guess: str) -> None:
        super().__init__(message)
        self.guess = guess


def guessed_map(headings: list[str]) -> str:
    """A map as YAML: one line per signal that a heading names, and comments on what is assumed.

    A wrong unit among the assumed ones is found when the recording is checked: no value then fits the rig.
    """
    found: dict[str, int] = {}
    for signal in WORDS:
        for place, heading in enumerate(headings):
            if place not in found.values() and _fits(signal, heading):
                found[signal] = place
                break
    lines = [GUESSED]
    entries: dict[str, dict[str, Any]] = {}
    for signal, units in UNITS.items():
        if signal not in found:
            if signal in NEEDED:
                lines.append(f"# {signal}: which column? It is needed.\n")
            continue
        place = found[signal]
        heading = headings[place]
        plain = heading.isprintable() and headings.count(heading) == 1
        entries[signal] = entry = {"column": heading if plain else place + 1}
        if split_heading(heading)[1] is None and signal != "time":
            entry["unit"] = next(iter(units))
    if entries:
        how: Any = {"default_flow_style": None, "allow_unicode": True, "sort_keys": False, "width": 10_000}
        lines.append(yaml.safe_dump(entries, **how))
    return "".join(lines).rstrip()


def _fits(signal: str, heading: str) -> bool:
    """Whether a word of a heading, or all together, names a signal, and its unit does not contradict."""
    name, unit = split_heading(heading)
    name = re.sub(r"(?<=[a-zäöü])(?=[A-Z])", " ", name)  # PressureA
    words = [word for word in re.split(r"[^a-z0-9äöüß]+", name.lower()) if word]
    if unit is not None and unit.replace("μ", "u").replace("µ", "u").strip() not in UNITS[signal]:
        return False
    if signal in OF_CHAMBERS and unit is None and not _any_is(words, PRESSURE):
        return False
    if signal not in NEEDED and _any_is(words, WANTED):
        return False
    return _any_is([*words, "".join(words)], WORDS[signal])


def _any_is(words: Sequence[str], pattern: str) -> bool:
    return any(re.fullmatch(pattern, word) for word in words)
