"""Parts that an axis may have and its file does not tell: what a model lacks whose residuals are not mere noise.

Each is tried on a window that the model does not explain; that one is believed by which the readings gain most
likelihood, and then the next one. A window that is explained does not pay for them.
"""

import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import NamedTuple

from hydro_env import TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.types import ByName, Mask
from hydro_rig.estimation.result import SHORT, Estimate
from hydro_rig.estimation.unknowns import Prior, Priors, course_of, prior_of

LEAST_GAIN = 10.0  # of twice the log-likelihood per unknown of a part, by which the part is believed
LEAST_GAIN_OF_STEP = 3.0  # the same per step of a moving supply: each changes a part of the window alone
MOST_PARTS = 3  # of one window
YIELD = 1e-4  # m, median of the way that a seal yields before it slides


class Part(StrEnum):
    """What an axis may have."""

    SUPPLY = "a supply that moves"
    LOAD = "a load that differs with its place"
    SEAL = "a seal that yields before it slides"
    TIP = "a second mass behind a spring"


LAP, USUAL_LAP = "valve.overlap", 0.01
"""The lap of the valve's edges, and its standard deviation where no range is known, of full stroke."""


class Lacking(NamedTuple):
    """A part that the model of a rig lacks: the unknowns that it adds, and what changes in the task."""

    priors: Priors
    changes: ByName = {}
    least_gain: float = LEAST_GAIN


def lacking(task: TaskConfig, duration: float, supply_recorded: bool) -> dict[Part, Lacking]:
    """The parts that windows of ``duration`` s may show on the rig of a task, in the order in which they are tried."""
    plant = task.plant
    force, stiffness = plant.supply.pressure * plant_coefficients(plant).area_a, plant.friction.breakaway_force / YIELD
    course = {name: prior_of(task, name) for name in course_of(duration)}
    load = {
        "load.mass": Prior(plant.load.mass, 0.5, True),
        "load.external_force": Prior(plant.load.external_force, 0.1 * force),
        "load.spring_stiffness": Prior(plant.load.spring_stiffness, force / plant.cylinder.stroke),
    }
    bristles = {
        "friction.bristle_stiffness": Prior(stiffness, 1.0, True),
        "friction.bristle_damping": Prior(2e-3 * stiffness, 1.0, True),
        "start.bristle_deflection": Prior(0.0, YIELD),
    }
    tip = {
        "load.tip_share": Prior(0.5, 0.2),
        "load.tip_frequency": Prior(2.0 * math.pi * 8.0, 0.8, True),
        "load.tip_damping_ratio": Prior(0.02, 0.8, True),
        "start.tip_position": prior_of(task, "start.tip_position"),
        "start.tip_velocity": prior_of(task, "start.tip_velocity"),
    }
    found = {}
    if not plant.structure.tip:
        found[Part.TIP] = Lacking(tip)
    found[Part.LOAD] = Lacking(load)
    if plant.friction.model == "stribeck" and stiffness > 0.0:
        found[Part.SEAL] = Lacking(bristles, {"plant": {"friction": {"model": "lugre"}}})
    if not supply_recorded:  # last: a course explains a little of everything
        found[Part.SUPPLY] = Lacking(course, least_gain=LEAST_GAIN_OF_STEP)
    return found


def unexplained(found: Estimate) -> Mask:
    """Windows whose readings differ from the model by more than noise, (N,)."""
    return ~found.holds | ((found.slow > 0.0) & (found.memory > SHORT)).any(axis=1)


Fit = Callable[[tuple[Part, ...], Estimate], Estimate]  # of a window with parts, from an estimate of it on


def with_parts(rigid: Estimate, possible: Mapping[Part, Lacking], usual: tuple[Part, ...], fit: Fit) -> Estimate:
    """The estimate of a window with the ``possible`` parts that it shows; ``rigid``: that without parts.

    The ``usual`` parts of this axis in other windows are tried first.
    """
    best = rigid
    for attempt in range(MOST_PARTS + 1):
        if not unexplained(best)[0]:
            break
        held, gained = best.parts[0], 0.0
        tried = [(*held, part) for part in possible if part not in held]
        if attempt == 0:
            tried = [usual] if usual else []
        for parts in tried:
            more = fit(parts, best)
            least = sum(possible[part].least_gain * len(possible[part].priors) for part in parts if part not in held)
            gain = best.unlikelihood[0] - more.unlikelihood[0] - least
            if gain > gained and (more.holds[0] or not best.holds[0]):
                gained, following = gain, more
                following.parts[0] = parts
                if not unexplained(more)[0]:
                    break
        if gained > 0.0:
            best = following
        elif attempt > 0:
            break
    return best
