"""The axes of the challenge, and the table of all that an engineer at the machine knows about them.

The law of drawn rigs (:mod:`hydro_env.task.law`) draws them. Axes ``0`` to :data:`KNOWN` − 1 occur in every split,
those from :data:`FIRST_NEW` on in the test split alone.
"""

import json
from functools import cache

import pandas as pd

from hydro_agents.detection.sheet import leak_scale
from hydro_env import TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.drawn_rigs import drawn_task
from hydro_env.task.law import FIRST_SEEDS, RigLaw
from hydro_env.task.paces import full_speed

KNOWN, NEW, FIRST_NEW = 24, 12, 1000  # axes of every split, of the test split alone, and the number of their first
NEW_AXES = range(FIRST_NEW, FIRST_NEW + NEW)
LAW = RigLaw(periods={5.0: 0.6, 10.0: 0.4}, preview_paces=())
FIRST_SEED = FIRST_SEEDS["test"] + 20_000  # no training, choice or test of this project draws rigs from here


@cache
def task_of(axis: int) -> TaskConfig:
    """The task on the rig that the law draws for an axis; what counts as a leak grows with the flow of the axis."""
    task = drawn_task(TaskConfig(), LAW, FIRST_SEED + axis)
    scale = leak_scale(task)
    sizes = {}
    for name in ("healthy_range", "faulty_range", "class_bounds"):
        sizes[name] = tuple(min(scale * size, LEAKAGE_LIMIT) for size in getattr(task.leakage, name))
    return task_config(task, leakage=sizes)


def axes_table() -> pd.DataFrame:
    """A row per axis: the figures of its nameplate in SI units (README.md), and its task as JSON."""
    rows = []
    for axis in (*range(KNOWN), *NEW_AXES):
        task = task_of(axis)
        plant, coefficients = task.plant, plant_coefficients(task.plant)
        area = float(coefficients.area_a)
        row = {
            "axis": axis,
            "control_period": task.control_period,
            "command_latency": task.command_latency,
            "stroke": plant.cylinder.stroke,
            "area_a": area,
            "area_b": float(coefficients.area_b),
            "supply_pressure": plant.supply.pressure,
            "rated_flow": plant.valve.rated_flow,
            "overlap": plant.valve.overlap,
            "mass": plant.load.mass,
            "external_force": plant.load.external_force,
            "full_flow": area * full_speed(plant),
            "smallest_leak": task.leakage.class_bounds[0],
            "task": json.dumps(task.model_dump()),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def read_task(text: str) -> TaskConfig:
    """The task of a row of :func:`axes_table`."""
    return TaskConfig.model_validate(json.loads(text))
