"""The axes of the challenge by their nameplates: a table that says all that an engineer at the machine knows.

The law of drawn rigs (:mod:`hydro_env.task.law`) draws them. Axes ``0`` to :data:`KNOWN` − 1 occur in every split,
those from :data:`FIRST_NEW` on in the test split alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import pandas as pd

from hydro_agents.detection.sheet import leak_scale
from hydro_agents.rigs.rig_file import QUESTIONS, answers_from, written_answers
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.drawn_rigs import TRIES, drawn_figures, with_steps_of_the_supply
from hydro_env.task.law import FIRST_SEEDS, RigLaw
from hydro_env.task.nameplates import rig_of
from hydro_env.task.paces import full_speed
from hydro_env.task.rig import moved

KNOWN, NEW, FIRST_NEW = 24, 12, 1000
"""Axes of every split, axes of the test split alone, and the number of the first of these."""

NEW_AXES = range(FIRST_NEW, FIRST_NEW + NEW)
"""Numbers of the axes of the test split alone."""

LAW = RigLaw(periods={5.0: 0.6, 10.0: 0.4})
FIRST_SEED = FIRST_SEEDS["test"] + 20_000  # no training, choice or test of this project draws rigs from here
SECRET_SEED = FIRST_SEEDS["test"] + 100_000  # rigs that follow from a key begin here
SECRET_SEEDS = 800_000_000

TIMING = {"control_period": "s; from one row to the next", "command_latency": "s; from a row to its command's effect"}
DERIVED = {
    "area_a": "m²; of the piston in chamber a, which extends the rod",
    "area_b": "m²; in chamber b",
    "full_flow": "m³/s; into chamber a at full opening without load, for the nominal figures",
    "smallest_leak": "l/min at 100 bar; a seal that passes more leaks",
}
"""Columns beside those of the nameplate."""


class Plate(NamedTuple):
    """What stands on an axis."""

    texts: dict[str, str]  # answers to the questions of ``hydro new-rig`` by key, as a person writes them
    timing: dict[str, float]  # by the keys of TIMING, s


@cache
def plate_of(seed: int) -> Plate:
    """The plate of the rig that the law draws from a seed; one that cannot work is drawn again."""
    for attempt in range(TRIES):
        figures, timing = drawn_figures(LAW, seed, attempt)
        plate = Plate(written_answers(figures), timing)
        try:
            task_of(TaskConfig(), plate)
        except ConfigurationError:
            continue
        return plate
    raise ConfigurationError(f"challenge: none of {TRIES} drawn rigs can work")


def task_of(config: TaskConfig, plate: Plate) -> TaskConfig:
    """A task on the axis of a plate: what the plate does not say is typical, with its range.

    What counts as a leak grows with the flow of the axis.

    Raises:
        ConfigurationError: the figures contradict each other, or the axis cannot work.
    """
    rig = rig_of(answers_from(plate.texts), "nameplate")
    values = moved(config.model_dump(), TaskConfig().model_dump(), with_steps_of_the_supply(rig)) | plate.timing
    task = TaskConfig.model_validate(values | {"law": None, "command_latency_range": None})
    scale = leak_scale(task)
    sizes = {
        name: tuple(min(scale * size, LEAKAGE_LIMIT) for size in getattr(task.leakage, name))
        for name in ("healthy_range", "faulty_range", "class_bounds")
    }
    return task_config(task, leakage=sizes)


def seed_of(axis: int, key: str = "") -> int:
    """The seed of an axis by its number; those of the test split alone follow from the key, if there is one."""
    if axis < FIRST_NEW or not key:
        return FIRST_SEED + axis
    digest = hashlib.sha256(f"{key}/axis {axis}".encode()).digest()
    return SECRET_SEED + int.from_bytes(digest[:4]) % SECRET_SEEDS


def plates_table(key: str = "") -> pd.DataFrame:
    """A row per axis: every figure in SI and, with the ending `` plate``, as it stands on the machine."""
    rows = []
    for axis in (*range(KNOWN), *NEW_AXES):
        plate = plate_of(seed_of(axis, key))
        task = task_of(TaskConfig(), plate)
        coefficients = plant_coefficients(task.plant)
        derived = {
            "area_a": float(coefficients.area_a),
            "area_b": float(coefficients.area_b),
            "full_flow": float(coefficients.area_a * full_speed(task.plant)),
            "smallest_leak": task.leakage.class_bounds[0],
        }
        answers = answers_from(plate.texts)
        written = {f"{name} plate": text for name, text in plate.texts.items()}
        rows.append({"axis": axis, **plate.timing, **answers, **derived, **written})
    table = pd.DataFrame(rows)
    keys = [question.key for question in QUESTIONS if question.key in table]
    return table[["axis", *TIMING, *keys, *DERIVED, *(f"{key} plate" for key in keys)]]


def read_plate(row: Mapping[str, Any]) -> Plate:
    """The plate of a row of :func:`plates_table`."""
    plates = {name: text for name, text in row.items() if name.endswith(" plate") and isinstance(text, str)}
    texts = {name.removesuffix(" plate"): text for name, text in plates.items()}
    return Plate(texts, {name: float(row[name]) for name in TIMING})


def columns_described() -> dict[str, str]:
    """What the columns of :func:`plates_table` hold."""
    questions = {q.key: f"{q.unit + '; ' if q.unit else ''}{q.what}" for q in QUESTIONS}
    return {"axis": "number", **TIMING, **questions, **DERIVED}
