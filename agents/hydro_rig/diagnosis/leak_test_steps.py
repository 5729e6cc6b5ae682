"""The forms of a leak test, and the steps of the valve opening that each of them takes within some limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hydro_env import PlantParameters
from hydro_env.plant.analysis import speed_limits
from hydro_env.types import Floats

MOVE = 0.5  # s, of each part of a short move
RAMP = 2.0  # full strokes per second with which the opening changes: a sudden change makes the axis swing


class Allowed(NamedTuple):
    """What the test may do, SI; the settings with the limits of the task where none is given."""

    duration: float
    opening: float
    speed: float
    pressure: float
    stop: str
    low: float  # −inf: no limit
    high: float
    start: float
    leak: float
    plants: int


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
    reach: float = 0.0  # of moves without a stop: share of the way to the nearer limit


FORMS = (
    Form("pressed at one opening", (1.0,), 0),
    Form("pressed at three openings", (1.0, 0.3, 0.1), 0),
    Form("pressed at one opening, then the valve closed", (1.0, 0.0), 0),
    Form("pressed at three openings, then closed", (1.0, 0.3, 0.1, 0.0), 0),
    Form("pressed at two openings, then closed, and short moves", (1.0, 0.2, 0.0), 2),
    Form("pressed at three openings, then closed, and short moves", (1.0, 0.3, 0.1, 0.0), 2),
)
AROUND = tuple(
    Form(
        f"moves at {count} openings over {100 * reach:.0f} % of the way, the valve closed between them",
        shares,
        2,
        reach,
    )
    for reach in (0.15, 0.35, 0.7)
    for count, shares in (("two", (1.0, 0.3)), ("three", (1.0, 0.5, 0.2)))
)
"""Forms of a test without a stop: moves to both sides of the start."""

STOPS = {"both": (1.0, -1.0), "extended": (1.0,), "retracted": (-1.0,), "none": ()}


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
    form: Form, plant: PlantParameters, allowed: Allowed, opening: float, travel: tuple[float, ...]
) -> tuple[Step, ...]:
    """The steps of a form of the test; shares of the opening count from the end of the valve's dead band."""
    dead = plant.valve.overlap

    def opened(share: float) -> float:
        return dead + share * (opening - dead) if share > 0.0 and opening > dead else share * opening

    signs = STOPS[allowed.stop]
    if not signs:
        return _around(form, plant, allowed, opened)
    steps = []
    moving = 2 * MOVE * form.moves
    rest = (allowed.duration - sum(travel)) / len(signs) - moving
    for sign, seconds in zip(signs, travel, strict=True):
        each = rest / len(form.shares)
        name = "extended" if sign > 0.0 else "retracted"
        steps.append(Step(sign * opening, seconds + each, f"press against the {name} stop"))
        for share in form.shares[1:]:
            steps.append(Step(sign * opened(share), each, "press less" if share > 0.0 else "valve closed"))
        for _ in range(form.moves):
            steps += [
                Step(-0.5 * sign * opening, MOVE, "move off the stop"),
                Step(0.5 * sign * opening, MOVE, "and back"),
            ]
    return tuple(steps)


def rounded(steps: tuple[Step, ...], period: float) -> tuple[Step, ...]:
    """The steps with whole control periods, and openings of at most four decimals."""
    return tuple(
        Step(round(step.opening, 4) + 0.0, float(f"{max(round(step.seconds / period), 1) * period:.9g}"), step.what)
        for step in steps
    )


def _around(form: Form, plant: PlantParameters, allowed: Allowed, opened: Callable[[float], float]) -> tuple[Step, ...]:
    """Moves to both sides of the start, each back again; the valve is closed between them."""
    out, back = speed_limits(plant)
    count, start, half = len(form.shares) * form.moves, allowed.start, 0.5 * plant.cylinder.stroke
    reach = form.reach * min(min(allowed.high, half) - start, start - max(allowed.low, -half))
    steps = []
    for number in range(count):
        opening = opened(form.shares[number // form.moves])
        sign = 1.0 if number % 2 == 0 else -1.0
        longest = allowed.duration / (4.0 * count)
        out_time = min(reach / (opening * out), longest)
        forth, home = (out_time, out_time * out / back) if sign > 0.0 else (out_time * out / back, out_time)
        wait = 0.5 * max(allowed.duration / count - forth - home, 0.1)
        steps += [Step(sign * opening, forth, "move"), Step(0.0, wait, "valve closed")]
        steps += [Step(-sign * opening, home, "move back"), Step(0.0, wait, "valve closed")]
    return tuple(steps)
