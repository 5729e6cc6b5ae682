"""The largest stable gain of a rig, linearised and simulated, and of the plants within its ranges; PIDs from them."""

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from hydro_agents.controllers.pid import PID, PIDGains
from hydro_agents.controllers.sampled_loop import SampledLoop, places_in_reach, sampled_loop
from hydro_agents.running.limit_cycles import comes_to_rest, counted_at_rest
from hydro_agents.running.seeds import STANDSTILLS
from hydro_env import ConfigurationError, HydroError, PlantParameters, TaskConfig, task_config
from hydro_env.files import Group
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.parameters import from_vector, to_vector
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.task.paces import full_speed
from hydro_env.task.settings import draws_of

HEALTHY_LEAK = 0.01  # l/min at 100 bar
DRAWN = 128  # plants from the ranges of a rig; the rare ones beyond them are left to the gain margin
SHARE_OF_STABLE = 0.5  # proportional gain over the largest stable or quiet one: a gain margin of 6 dB
FEW_UNSTABLE = 0.02  # share of loops within the ranges that tuned gains may leave unstable without friction
PLANTS = 32  # drawn ones that must come to rest with a gain
MEDIUM, LOWEST, HIGHEST = 10.0, 1e-2, 1e4  # 1/s, 1/s, 1/m: where the search for the largest quiet gain begins and ends
CLOSE = 1.1  # ratio of gains at which it ends

INTEGRAL_SHARE = 0.1  # rate of the integral over the crossover frequency: it costs 6° of phase there


class Weakest(NamedTuple):
    """The loop with the smallest of the largest stable gains."""

    gain: float  # 1/m; infinite if no gain makes a loop unstable
    loop: SampledLoop


def weakest(loops: Iterable[SampledLoop]) -> Weakest | None:
    """The loop with the smallest of the largest stable gains; ``None`` without a loop."""
    found = None
    for loop in loops:
        limit = 1e6 if found is None else min(found.gain, 1e6)
        if limit == 0.0:
            break
        gain = loop.largest_stable_gain(limit)
        if found is None or gain < found.gain:
            found = Weakest(gain, loop)
    return found


def loops_over_reach(
    task: TaskConfig, plant: PlantParameters, leak: float = HEALTHY_LEAK, every: int = 1
) -> Iterator[SampledLoop]:
    """Loops around a plant, with the timing of a task and a leak in l/min at 100 bar, at ``every`` so many places."""
    plant = beyond_dead_band(leaking(plant, leak))
    for place in places_in_reach(plant)[::every]:
        with suppress(HydroError):  # the plant cannot be held there
            yield sampled_loop(plant, place, task.control_period, task.command_latency)


def loops_within_ranges(task: TaskConfig) -> Iterator[SampledLoop]:
    """Loops around the task's own plant and around plants drawn from its ranges, with healthy seals."""
    yield from loops_over_reach(task, task.plant)
    if task.randomisation:
        for plant in drawn_plants(task):
            yield from loops_over_reach(task, plant, every=2)


def drawn_plants(task: TaskConfig) -> Iterator[PlantParameters]:
    """Plants drawn from the ranges of a task, as at the start of its episodes; the leak past the piston stays."""
    generator, draws = np.random.default_rng(0), draws_of(task)
    for _ in range(DRAWN):
        vector = to_vector(task.plant)
        for draw in draws:
            low, high = draw["low"], draw["high"]
            if draw["logarithmic"]:
                value = math.exp(generator.uniform(*np.log([low, high])))
            else:
                value = generator.uniform(low, high)
            if draw["times"] >= 0:
                value *= vector[draw["times"]]
            if generator.random() < draw["otherwise_probability"]:
                value = draw["otherwise"]
            vector[draw["parameter"]] = value
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


class QuietGains(NamedTuple):
    """The largest proportional gains of a PID with which simulated axes come to rest after a step and back."""

    own: float  # 1/m, of the file's own values
    worst: float  # 1/m, of all of :data:`PLANTS` plants drawn from their ranges


def quiet_gains(task: TaskConfig) -> QuietGains:
    """The largest quiet gains of a rig, with its friction, sampling and latency, a healthy seal and no sensor noise.

    The linearised loop has no dry friction, with which an axis stays quiet far above the largest stable gain, unless a
    hard kick sets it in motion: the feed-forward of a step is one.

    Raises:
        HydroError: no gain is quiet, or the axis cannot be held or moved.
    """
    speed = max(full_speed(beyond_dead_band(task.plant)), 1e-6)
    exact, lowest = task_config(task, randomisation={}), LOWEST / speed
    own = worst = _largest_quiet_gain(exact, 1, MEDIUM / speed, lowest)
    if task.randomisation:
        worst = min(own, _largest_quiet_gain(task, PLANTS, own, lowest))
    return QuietGains(own, worst)


def _largest_quiet_gain(task: TaskConfig, plants: int, begin: float, lowest: float) -> float:
    def quiet(gain: float) -> bool:
        controller = PID(pid_with_gain(task, gain), task)
        return comes_to_rest(counted_at_rest(controller, task, STANDSTILLS, plants, HEALTHY_LEAK))

    low = high = begin
    if quiet(begin):
        while high < HIGHEST and quiet(high := min(2.0 * low, HIGHEST)):
            low = high
    else:
        while not quiet(low := 0.5 * high):
            high = low
            if low < lowest:
                raise HydroError(f"no proportional gain down to {low:.2g} 1/m lets the axis come to rest")
    while high / low > CLOSE:
        middle = math.sqrt(low * high)
        if quiet(middle):
            low = middle
        else:
            high = middle
    return low


def pids_from_figures(task: TaskConfig) -> list[PIDGains]:
    """PIDs of a rig that nobody tuned: with the recommended gain, and that of :func:`pid_from_figures`.

    Raises:
        ConfigurationError: neither exists.
    """
    found = []
    reason = ""
    try:
        found.append(pid_with_gain(task, SHARE_OF_STABLE * quiet_gains(task).worst))
    except HydroError as error:
        reason = str(error)
    from_figures = pid_from_figures(task)
    if from_figures is not None:
        found.append(from_figures)
    if not found:
        raise ConfigurationError(f"pid: no gains for this rig: {reason}; give a file of gains")
    return found


def pid_from_figures(task: TaskConfig, loops: Iterable[SampledLoop] | None = None) -> PIDGains | None:
    """Half of the largest stable gain of the weakest plant within the task's ranges, and feed-forward; no derivative.

    Without friction in its figures it is a careful start. ``None`` if no gain makes a loop unstable, or each does.
    ``loops`` are those of :func:`loops_within_ranges`, if they are known.
    """
    found = weakest(loops_within_ranges(task) if loops is None else loops)
    moves = min(speed_limits(beyond_dead_band(task.plant))) > 0.0
    if found is None or not moves or not 0.0 < found.gain < math.inf:
        return None
    return pid_with_gain(task, SHARE_OF_STABLE * found.gain)


def pid_with_gain(task: TaskConfig, gain: float) -> PIDGains:
    """A PID with a proportional gain (1/m), and the inverse of the no-load speeds as feed-forward; no derivative.

    Raises:
        HydroError: the axis cannot move.
    """
    out, back = speed_limits(beyond_dead_band(task.plant))
    if min(out, back) <= 0.0:
        raise HydroError("the supply cannot move the axis")
    return PIDGains(
        proportional=gain,
        integral=INTEGRAL_SHARE * gain * 0.5 * (out + back) * gain,
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
