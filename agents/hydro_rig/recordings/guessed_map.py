"""A map of columns guessed from headings that are not those of this project: from their units, words and values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
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

PRESSURE = r"p\w{0,2}|pressure|druck\w*|press|pt\d*"  # words that say that a column holds a pressure
WANTED = r"soll\w*|ref\w*|setpoint|desired|target|demand|führung\w*"  # of wanted values, which are not measured ones
UNDECIDED = 1.0  # least score of a guess


class UnknownHeadingsError(ConfigurationError):
    """A file without the headings of this project.

    ``guess`` is a map in YAML, guessed from the headings; ready to be saved and given with ``--map``.
    """

    def __init__(self, message: str, guess: str) -> None:
        super().__init__(message)
        self.guess = guess


class _Guess(NamedTuple):
    place: int  # of the column
    unit: str | None  # assumed; None: that of the heading


def guessed_map(headings: Sequence[str], cells: Sequence[pd.Series], source: str) -> str:
    """A map as YAML: one line per signal that a heading names, and comments on what is assumed or left over.

    Args:
        headings: of the columns, (C,).
        cells: of the columns; numbers decide where no unit is written.
        source: of the file.
    """
    scores = {
        (signal, place): score
        for signal in WORDS
        if signal in UNITS
        for place, heading in enumerate(headings)
        if (score := _score(signal, heading, cells[place])) >= UNDECIDED
    }
    found: dict[str, _Guess] = {}
    while scores:
        signal, place = max(scores, key=lambda pair: (scores[pair], -pair[1]))
        found[signal] = _Guess(place, _assumed_unit(signal, headings[place], cells[place]))
        scores = {pair: score for pair, score in scores.items() if signal != pair[0] and place != pair[1]}
    lines = [
        f"# Guessed from the headings of {_plain(source)}. Check columns, units and signs.",
        "# If zero is at the end of the stroke, an offset of minus half the stroke moves it to mid-stroke.",
    ]
    lines += [_line(signal, found, headings) for signal in UNITS if signal in found]
    lines += [f"# {signal}: which column? It is needed." for signal in ("time", "command") if signal not in found]
    left = [heading for place, heading in enumerate(headings) if place not in {guess.place for guess in found.values()}]
    lines += [f"# not used: {_plain(', '.join(left))}"] if left else []
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Text for a comment, in one line."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _line(signal: str, found: Mapping[str, _Guess], headings: Sequence[str]) -> str:
    place, unit = found[signal]
    heading = headings[place]
    alone = list(headings).count(heading) == 1 and heading.isprintable()
    column: str | int = heading if alone else place + 1
    entry = {"column": column} | ({} if unit is None else {"unit": unit})
    text = yaml.safe_dump(entry, default_flow_style=True, allow_unicode=True, width=10_000, sort_keys=False).strip()
    remark = "" if unit is None else "  # the unit is assumed from the values"
    return f"{signal}: {text}{remark}" + (f"  # {_plain(heading)}" if isinstance(column, int) else "")


def _score(signal: str, heading: str, cells: pd.Series) -> float:
    """How well a heading fits a signal: its words and its unit; negative if the unit contradicts."""
    name, unit = split_heading(heading)
    name = re.sub(r"(?<=[a-zäöü])(?=[A-Z])", " ", name)  # PressureA
    words = [word for word in re.split(r"[^a-z0-9äöüß]+", name.lower()) if word]
    if unit is not None and _known_unit(signal, unit) is None:
        return -1.0
    hits = sum(bool(re.fullmatch(WORDS[signal], word)) for word in words)
    hits += bool(re.fullmatch(WORDS[signal], "".join(words))) if len(words) > 1 else 0
    pressure = any(re.fullmatch(PRESSURE, word) for word in words) or (
        unit is not None and signal.startswith("pressure")
    )
    if signal.startswith("pressure") and not pressure:
        return -1.0
    if signal == "load_pressure" and not pressure and "dp" not in words:
        return -1.0
    if not hits:
        return 0.9 if unit is not None and signal == "time" and _rises(cells) else 0.0
    wanted = any(re.fullmatch(WANTED, word) for word in words) and signal not in ("time", "command")
    exact = len(words) == 1
    return hits + 0.5 * (unit is not None) + 0.25 * exact + 0.5 * (signal == "time" and _rises(cells)) - 2.0 * wanted


def _known_unit(signal: str, unit: str) -> str | None:
    plain = unit.replace("μ", "u").replace("µ", "u").strip()
    return plain if plain in UNITS[signal] else None


def _assumed_unit(signal: str, heading: str, cells: pd.Series) -> str | None:
    """The unit that fits the values if the heading has none."""
    if split_heading(heading)[1] is not None:
        return None
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    values = values[np.isfinite(values)]
    if not len(values):  # time stamps in words
        return None if signal == "time" else next(iter(UNITS[signal]))
    largest = float(np.abs(values).max())
    if signal == "time":
        step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
        return "s" if step < 0.1 else "ms" if step < 100.0 else "us"
    if signal in ("command", "spool_position"):
        return "-" if largest <= 1.0 else "V" if largest <= 10.5 else "%"
    if signal == "position":
        return "m" if largest < 2.0 else "mm"
    if signal.endswith("pressure") or signal.startswith("pressure"):
        return "MPa" if largest < 5.0 else "bar" if largest < 600.0 else "psi" if largest < 1e4 else "Pa"
    return next(iter(UNITS[signal]))


def _rises(cells: pd.Series) -> bool:
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    return bool(len(values) > 1 and np.all(np.diff(values) > 0.0))
