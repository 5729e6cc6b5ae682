"""The largest stable gain of a rig, and of the plants within its ranges; the gains of a PID that follow from it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.registry import make_controller
from hydro_agents.controllers.sampled_loop import SampledLoop, places_in_reach, sampled_loop
from hydro_agents.learning.opponents import gains_file, shipped, usual_gains
from hydro_env import HydroError, PlantParameters, TaskConfig
from hydro_env.files import Group, read_yaml
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.parameters import from_vector, to_vector
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.task.settings import draws_of

HEALTHY_LEAK = 0.01  # l/min at 100 bar
DRAWN = 128
"""Number of plants that are drawn from the ranges of a rig; the rare ones beyond them are left to the gain margin."""

SHARE_OF_STABLE = 0.5  # proportional gain over the largest stable one: a gain margin of 6 dB
FEW_UNSTABLE = 0.02
"""Share of loops within the ranges that tuned gains may leave unstable without friction, and start a search."""

INTEGRAL_SHARE = 0.1  # rate of the integral over the crossover frequency: it costs 6° of phase there


class Weakest(NamedTuple):
    """The loop with the smallest of the largest stable gains."""

    gain: float  # 1/m; infinite if no gain makes a loop unstable
    loop: SampledLoop

    @property
    def recommended(self) -> float:
        """Recommended proportional gain, 1/m: half of the largest stable one."""
        return SHARE_OF_STABLE * self.gain

    def gain_margin(self, gain: float) -> float:
        """Gain margin of the loop with a proportional gain (1/m), dB."""
        return 20.0 * math.log10(self.gain / gain)


def weakest(loops: Iterable[SampledLoop]) -> Weakest | None:
    """The loop with the smallest of the largest stable gains; ``None`` without a loop."""
    found = None
    for loop in loops:
        limit = found.gain if found is not None and math.isfinite(found.gain) else 1e6
        gain = loop.largest_stable_gain(limit) if limit > 0.0 else math.inf
        if found is None or gain < found.gain:
            found = Weakest(gain, loop)
    return found


def nominal_loops(task: TaskConfig, leak: float = HEALTHY_LEAK) -> Iterator[SampledLoop]:
    """Loops around the task's own plant over its reach, with a leak in l/min at 100 bar."""
    plant = beyond_dead_band(leaking(task.plant, leak))
    return _loops(plant, places_in_reach(plant), task)


def loops_within_ranges(task: TaskConfig) -> Iterator[SampledLoop]:
    """Loops around the task's own plant and around plants drawn from its ranges, with healthy seals."""
    yield from nominal_loops(task)
    for drawn in drawn_plants(task) if task.randomisation else ():
        plant = beyond_dead_band(leaking(drawn, HEALTHY_LEAK))
        yield from _loops(plant, places_in_reach(plant)[::2], task)


def _loops(plant: PlantParameters, places: list[float], task: TaskConfig) -> Iterator[SampledLoop]:
    for place in places:
        try:
            yield sampled_loop(plant, place, task.control_period, task.command_latency)
        except HydroError:  # the plant cannot be held there
            continue


def drawn_plants(task: TaskConfig) -> Iterator[PlantParameters]:
    """Plants drawn from the ranges of a task, as at the start of its episodes; the leak past the piston stays."""
    generator, draws = np.random.default_rng(0), draws_of(task)
    for _ in range(DRAWN):
        vector = to_vector(task.plant)
        for draw in draws:
            low, high = draw["low"], draw["high"]
            logarithmic = draw["logarithmic"]
            value = math.exp(generator.uniform(*np.log([low, high]))) if logarithmic else generator.uniform(low, high)
            if draw["times"] >= 0:
                value *= vector[draw["times"]]
            rare = generator.random() < draw["otherwise_probability"]
            vector[draw["parameter"]] = draw["otherwise"] if rare else value
        yield from_vector(vector)


def beyond_dead_band(parameters: PlantParameters) -> PlantParameters:
    """The rig with a controller that jumps over the dead band of its valve; without an overlap the rig itself.

    Within the dead band the valve passes next to nothing, so that almost any gain seems stable there. Each edge opens
    as before, from where its overlap ends: y = (o + √(o² + x_0²)) / 2 with o = x_s / (1 − x_d).
    """
    valve = parameters.valve
    if valve.overlap == 0.0:
        return parameters
    rest = 1.0 - valve.overlap
    return parameters.replace(
        valve={"overlap": 0.0, "rated_flow": valve.rated_flow / rest, "underlap": valve.underlap * rest}
    )


def leaking(parameters: PlantParameters, leak: float) -> PlantParameters:
    """The rig with another leak past the piston, in l/min at 100 bar."""
    return parameters.replace(leakage=leak_past_piston(leak, "laminar"))


def pid_from_figures(task: TaskConfig, loops: Iterable[SampledLoop] | None = None) -> PIDGains | None:
    """Half of the largest stable gain of the weakest plant within the task's ranges, and feed-forward; no derivative.

    The feed-forward is the inverse of the no-load speeds; the overlap of the valve is compensated. ``None`` if no gain
    makes a loop unstable, or each gain does.
    ``loops`` are those of :func:`loops_within_ranges`, if they are known.
    """
    found = weakest(loops_within_ranges(task) if loops is None else loops)
    out, back = speed_limits(beyond_dead_band(task.plant))
    if found is None or not 0.0 < found.gain < math.inf or min(out, back) <= 0.0:
        return None
    crossover = found.recommended * 0.5 * (out + back)
    return PIDGains(
        proportional=found.recommended,
        integral=INTEGRAL_SHARE * crossover * found.recommended,
        feedforward_extending=1.0 / out,
        feedforward_retracting=1.0 / back,
        overlap_compensation=1.0 if task.plant.valve.overlap else 0.0,
        lead_in_integral=False,
    )


def stable_start(task: TaskConfig, given: Group) -> Group:
    """The given gains; for a PID that would be unstable on this rig and its ranges, those from the rig's figures.

    On a rig with an overlapped valve a PID begins with compensation of the whole overlap.
    """
    if not isinstance(given, PIDGains):
        return given
    if task.plant.valve.overlap and not given.overlap_compensation:
        given = given.model_copy(update={"overlap_compensation": 1.0})
    loops = list(loops_within_ranges(task))
    if sum(not loop.is_stable(given.proportional) for loop in loops) <= FEW_UNSTABLE * len(loops):
        return given
    return pid_from_figures(task, loops) or given


def stable_pid(task: TaskConfig) -> tuple[Controller, str]:
    """The shipped PID, or, where its gains are unstable on this rig, one from the rig's figures; and what was done.

    The text is empty on a rig with gains of its own.
    """
    controller = shipped("pid", task)
    if task.plant == PlantParameters() or gains_file("pid", task) is not None:
        return controller, ""
    given = PIDGains.model_validate(read_yaml(usual_gains("pid")))
    start = stable_start(task, given)
    if start == given:
        return controller, "the gains of the PID were tuned for another rig; they are stable here"
    what = "no PID was tuned for this rig, and the usual gains are unstable here: half of the largest stable gain acts"
    return make_controller("pid", task, start.model_dump()), what
