"""The forms of a leak test, and the steps of the valve opening that each of them takes within some limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from hydro_env import PlantParameters, TaskConfig
from hydro_env.files import Group, validate
from hydro_env.types import Floats

MOVE = 0.5  # s, of each part of a short move
RAMP = 2.0  # full strokes per second with which the opening changes: a sudden change makes the axis swing


class LeakTestSettings(Group):
    """Limits of the test, SI."""

    duration: float = Field(60.0, ge=2.0, le=600.0, description="s")
    opening: float = Field(0.3, gt=0.0, le=1.0, description="largest opening of the valve, of full stroke")
    speed: float = Field(gt=0.0, le=100.0, description="m/s, also against an end stop")
    pressure: float = Field(gt=0.0, le=2e8, description="Pa")
    stop: Literal["both", "extended", "retracted"] = Field("both", description="stops that it presses against")
    low: float = Field(-math.inf, description="m, lowest position that the axis may reach")
    high: float = Field(math.inf, description="m")
    plants: int = Field(6, ge=2, le=1000, description="simulated ones, of the training seeds")

    @classmethod
    def of(cls, config: TaskConfig, **given: Any) -> LeakTestSettings:
        """Some of the settings; the others are as usual, speed and pressure those of the task.

        Raises:
            ConfigurationError: a value is out of its bounds.
        """
        usual = {"speed": config.failure.end_stop_speed, "pressure": config.failure.pressure_rating}
        return validate(cls, usual | given, "leak-test")


class Step(NamedTuple):
    """A constant opening."""

    opening: float  # of full stroke; positive extends the axis
    seconds: float
    what: str


class Form(NamedTuple):
    """What a test does at each stop, after the axis has been pressed against it."""

    name: str
    shares: tuple[float, ...]  # of the largest opening, one after the other; 0: the valve is closed
    moves: int  # short moves off the stop


FORMS = (
    Form("pressed at one opening", (1.0,), 0),
    Form("pressed at three openings", (1.0, 0.3, 0.1), 0),
    Form("pressed at one opening, then the valve closed", (1.0, 0.0), 0),
    Form("pressed at three openings, then closed", (1.0, 0.3, 0.1, 0.0), 0),
    Form("pressed at two openings, then closed, and short moves", (1.0, 0.2, 0.0), 2),
    Form("pressed at three openings, then closed, and short moves", (1.0, 0.3, 0.1, 0.0), 2),
)
STOPS = {"both": (1.0, -1.0), "extended": (1.0,), "retracted": (-1.0,)}


def commands_of(steps: Sequence[Step], period: float) -> Floats:
    """Openings, one per control period, (T,); each step begins with a ramp from the opening before."""
    ends = np.round(np.cumsum([step.seconds for step in steps]) / period).astype(int)
    openings, before, begin = np.zeros(int(ends[-1])), 0.0, 0
    for step, end in zip(steps, ends.tolist(), strict=True):
        most = RAMP * period * np.arange(end - begin + 1)
        course = before + np.clip(step.opening - before, -most, most)
        openings[begin:end], before, begin = course[:-1], float(course[-1]), end
    return openings


def steps_of(
    form: Form, plant: PlantParameters, settings: LeakTestSettings, opening: float, travel: Sequence[float]
) -> tuple[Step, ...]:
    """The steps of a form of the test; shares of the opening count from the end of the valve's dead band.

    Args:
        form: of the test.
        plant: the rig.
        settings: the limits.
        opening: the largest one.
        travel: s, to each stop in order.
    """
    dead = plant.valve.overlap if plant.valve.overlap < opening else 0.0
    openings = [dead + share * (opening - dead) if share > 0.0 else 0.0 for share in form.shares]
    signs = STOPS[settings.stop]
    steps = []
    rest = (settings.duration - sum(travel)) / len(signs) - 2 * MOVE * form.moves
    each = rest / len(openings)
    for sign, seconds in zip(signs, travel, strict=True):
        name = "extended" if sign > 0.0 else "retracted"
        steps.append(Step(sign * opening, seconds + each, f"press against the {name} stop"))
        steps += [Step(sign * less, each, "press less" if less > 0.0 else "valve closed") for less in openings[1:]]
        off = Step(-0.5 * sign * opening, MOVE, "move off the stop"), Step(0.5 * sign * opening, MOVE, "and back")
        steps += off * form.moves
    return tuple(steps)


def rounded(steps: Sequence[Step], period: float) -> tuple[Step, ...]:
    """The steps with whole control periods, and openings of at most four decimals."""
    return tuple(
        Step(round(step.opening, 4) + 0.0, float(f"{max(round(step.seconds / period), 1) * period:.9g}"), step.what)
        for step in steps
    )
