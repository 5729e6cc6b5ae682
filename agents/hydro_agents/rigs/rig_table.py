"""Rigs from a table of nameplates: a row per axis, a column per figure."""

import csv
import re
from pathlib import Path

from hydro_agents.rigs.rig_file import QUESTIONS
from hydro_env import ConfigurationError
from hydro_env.files import read_text
from hydro_env.units import split_heading

AXIS = "axis"
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")


def figures_of_table(path: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    """The answers of each axis by the keys of the questions, and the headings that are no question.

    A column ``axis`` names the axes; a heading may hold a unit, ``bore [mm]``. An empty cell is no answer.

    Raises:
        ConfigurationError: the file is no such table, or names an axis twice.
    """
    text = read_text(path)
    rows = [row for row in csv.reader(text.splitlines(), delimiter=max(";\t,", key=text.count)) if any(row)]
    keys = {question.name: question.key for question in QUESTIONS}
    numbers = {question.key for question in QUESTIONS if question.unit}
    columns, others = {}, []  # key and unit of a figure by place
    for place, heading in enumerate(rows[0] if rows else []):
        name, unit = split_heading(heading)  # bore [mm]
        name = re.sub(r"[\s_]+", "-", name.lower())
        if name == AXIS or name in keys:
            columns[place] = keys.get(name, AXIS), unit or ""
        else:
            others.append(heading.strip())
    if AXIS not in [key for key, _ in columns.values()]:
        raise ConfigurationError(f"{path}: no column has the heading '{AXIS}'")
    axes: dict[str, dict[str, str]] = {}
    for row in rows[1:]:
        answers = {}
        for place, (key, unit) in columns.items():
            cell = row[place].strip() if place < len(row) else ""
            if key in numbers:  # commas part the points of a curve and words
                cell = _DECIMAL_COMMA.sub(".", cell)
                if unit and cell[-1:].isdigit():
                    cell = f"{cell} {unit}"
            if cell:
                answers[key] = cell
        name = answers.pop(AXIS, "")
        if not name or name in axes:
            raise ConfigurationError(
                f"{path}: row {len(axes) + 2}: axis '{name[:60]}': each row needs a name of its own"
            )
        axes[name] = answers
    return axes, others
