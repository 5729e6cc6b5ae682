"""Compiled integration of one or many plants with the right-hand side of ``equations``, each with its own step.

The method is the Runge–Kutta pair of order 5(4) of Tsitouras (2011). Every step of every plant is as long as its
error estimate allows (:data:`TOLERANCE`), and ends at the next kink of the solution if that comes first.

The kernel works on ``LANES`` plants at a time: loops over lanes become vector instructions, and each plant fills one
lane. When a plant reaches its end time, its lane takes the next plant. No operation mixes lanes, so a plant's numbers
depend neither on its neighbours, nor on their number, nor on threads.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from hydro_env.compiling import (
    SOURCES,
    Kernel,
    compiled,
    inline,
    lane_function,
    lane_loader,
    lane_storer,
    tuple_map,
    tuple_maximum,
    tuple_reader,
    tuple_writer,
)
from hydro_env.plant.equations import (
    Coefficients,
    Parts,
    command_changed,
    derivatives,
    hold_limits,
    parts_of,
    time_to_kink,
    weights,
)
from hydro_env.plant.states import RIGID, Structure, columns_of, state_kind
from hydro_env.types import Floats

LANES = 8  # plants that one vector instruction works on (eight doubles fill an AVX-512 register)
GROUPS = 2  # groups of lanes in turn: one computes while another waits for its roots and divisions
TOLERANCE = 1e-6  # largest estimated error of a step, relative to each state's size (the weights in states)
MAXIMUM_STEP = 2e-3  # s; no step is longer
MOST_STEPS_PER_PERIOD = 50_000.0  # inner steps per call; a plant that needs more stops, and peaks holds the number
FIRST_STEP = 1e-3 / 3  # s; tried first in each hold interval
STABLE_PRODUCT = 3.2  # h·|λ| up to which the method is stable for rates with at least a quarter of it as damping
SHORTEST_STEP = 1e-8  # s; a step this short is accepted with any error, so that the integration always ends

STAGES = (
    (0.161,),
    (-0.008480655492356989, 0.335480655492357),
    (2.8971530571054935, -6.359448489975075, 4.3622954328695815),
    (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
    (5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383),
    (0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774),
)
"""Coefficients a_ij of stages 2 to 7 (Tsitouras 2011, table 1); the last row gives the new state as well."""

ERROR = (
    -0.00178001105222577714,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    0.015151515151515152,
)
"""Weights of the stages in the error estimate, order 5 minus order 4 (same table)."""

N_COEFFICIENTS = len(Coefficients._fields)
N_PEAKS = 3
PEAK_PRESSURE, IMPACT_SPEED, STEPS = range(N_PEAKS)  # columns of peaks: Pa; m/s at an end stop; number of inner steps


class Plants(NamedTuple):
    """Arrays of the plants that :func:`integrate` advances, one row each."""

    state: Floats  # (plants, states in the order of ALL_STATES), those of the structure changed in place
    coefficients: Floats  # (plants, N_COEFFICIENTS)
    voltage: Floats  # (plants, intervals), V, held in each interval
    durations: Floats  # (plants, intervals), s
    peaks: Floats  # (plants, N_PEAKS), written


class Accuracy(NamedTuple):
    """Accuracy of the integration."""

    maximum_step: float = MAXIMUM_STEP  # s, longest inner step
    tolerance: float = TOLERANCE  # largest estimated error of a step; infinity for steps of fixed length
    most_steps: float = MOST_STEPS_PER_PERIOD  # budget of inner steps per call


# Working memory of a group of lanes: rows of LANES numbers. The rows of states come last: their number depends on the
# structure.
_STAGE_NAMES = [f"stage_{number}" for number in range(1, len(STAGES) + 1)]
_SIZES = {
    **dict.fromkeys(("voltage", "remaining", "proposed", "step", "repeated", "plant", "interval"), 1),
    "coefficients": N_COEFFICIENTS,
    "peaks": N_PEAKS,
}
_ROW = dict(zip([*_SIZES, "states"], np.cumsum([0, *_SIZES.values()]).tolist(), strict=True))
_COEFFICIENTS, _PEAKS = (LANES * _ROW[name] for name in ("coefficients", "peaks"))
_VOLTAGE, _REMAINING, _PROPOSED, _STEP, _REPEATED, _PLANT, _INTERVAL = (
    LANES * _ROW[name] for name in ("voltage", "remaining", "proposed", "step", "repeated", "plant", "interval")
)
_PRESSURE_PEAK, _SPEED_PEAK, _STEP_COUNT = (_PEAKS + LANES * row for row in range(N_PEAKS))

_read_coefficients = tuple_reader(Coefficients, _ROW["coefficients"], LANES)


class Lanes(NamedTuple):
    """Memory of the lanes for one structure: what reads, writes and combines the states of its axes."""

    parts: Parts
    rows: int
    load: Any  # (work, lane, state, plant) and store: between an array and a lane
    store: Any
    read_state: Any  # (work, lane) → state; likewise the trial state, its derivative and the error
    read_trial: Any
    read_derivative: Any
    read_error: Any
    write_state: Any  # (work, lane, state)
    write_trial: Any
    write_derivative: Any
    stage_2: Any  # (work): set every lane's trial state from the derivatives so far, and keep the newest one
    stage_3: Any
    stage_4: Any
    stage_5: Any
    stage_6: Any
    stage_7: Any
    estimate_error: Any  # (work)
    difference: Any  # (a, b) → state
    choice: Any  # (condition, a, b) → state
    largest: Any  # (error, weights) → largest weighted error


@cache
def lanes_of(structure: Structure) -> Lanes:
    """The memory of lanes whose axes have this structure."""
    kind = state_kind(structure)
    size = len(kind._fields)
    names = ["state", "trial", "derivative", *_STAGE_NAMES, "error"]
    row = {name: _ROW["states"] + size * number for number, name in enumerate(names)}
    place = {name: f"work[{LANES * row[name]} + place]" for name in names}

    def total(factors: Sequence[float], terms: Sequence[str]) -> str:
        """Step times a weighted sum of rows, as text; numba compiles loops over a varying number of terms slowly."""
        sums = " + ".join(f"{factor!r} * {place[term]}" for factor, term in zip(factors, terms, strict=True))
        return f"work[{_STEP} + lane] * ({sums})"

    def stage(number: int) -> Any:
        known = [*_STAGE_NAMES[: number - 1], "derivative"]
        trial = f"{place['trial']} = {place['state']} + {total(STAGES[number - 1], known)}"
        return lane_function("work", size, LANES, trial, f"{place[_STAGE_NAMES[number - 1]]} = {place['derivative']}")

    columns = columns_of(structure)
    error = f"{place['error']} = {total(ERROR, [*_STAGE_NAMES, 'derivative'])}"
    reads = {f"read_{name}": tuple_reader(kind, row[name], LANES) for name in ("state", "trial", "derivative", "error")}
    writes = {f"write_{name}": tuple_writer(kind, row[name], LANES) for name in ("state", "trial", "derivative")}
    stages = {f"stage_{number + 1}": stage(number) for number in range(1, len(STAGES) + 1)}
    return Lanes(
        parts=parts_of(structure),
        rows=_ROW["states"] + size * len(names),
        load=lane_loader(columns, row["state"], LANES),
        store=lane_storer(columns, row["state"], LANES),
        estimate_error=lane_function("work", size, LANES, error),
        difference=tuple_map(kind, "a.{name} - b.{name}", "a, b"),
        choice=tuple_map(kind, "a.{name} if condition else b.{name}", "condition, a, b"),
        largest=tuple_maximum(kind, "abs(error.{name} * weight.{name})", "error, weight"),
        **reads,
        **writes,
        **stages,
    )


@inline
def _choose_step(work, lanes):
    """Set each lane's next step: as proposed, but no further than the end of the interval or the next kink."""
    for lane in range(LANES):
        remaining = work[_REMAINING + lane]
        proposed = min(work[_PROPOSED + lane], remaining)
        # Two equal last steps instead of a long and a very short one.
        halved = 0.5 * remaining if 2.0 * proposed > remaining and proposed < remaining else proposed
        c = _read_coefficients(work, lane)
        kink = time_to_kink(lanes.read_state(work, lane), lanes.read_derivative(work, lane), c, lanes.parts)
        work[_STEP + lane] = kink if kink < halved else halved  # also taken when the state is NaN


@inline
def _accept_or_repeat(work, strictness, accuracy, lanes):
    """Accept or repeat each lane's step by its estimated error, and propose the next one."""
    lanes.estimate_error(work)
    for lane in range(LANES):
        remaining = work[_REMAINING + lane]
        proposed = work[_PROPOSED + lane]
        step = work[_STEP + lane]
        c = _read_coefficients(work, lane)
        old = lanes.read_state(work, lane)
        trial = lanes.read_trial(work, lane)
        new = hold_limits(trial, c, lanes.parts)
        other = hold_limits(lanes.difference(trial, lanes.read_error(work, lane)), c, lanes.parts)
        error = strictness * lanes.largest(lanes.difference(new, other), weights(c, lanes.parts))
        within_tolerance = error <= 1.0
        moving = remaining > 0.0
        accepted = moving and (within_tolerance or step <= SHORTEST_STEP)
        # err^(-3/16), close to the theoretical -1/5, needs only square roots.
        root = math.sqrt(math.sqrt(math.sqrt(math.sqrt(max(error, 1e-12)))))
        factor = min(max(0.9 / (root * root * root), 0.2), 4.0) if error < 1e300 else 0.2
        grown = min(step * factor, accuracy.maximum_step)
        # A step that ends early at a kink or at the end of the interval does not shorten the next one.
        work[_PROPOSED + lane] = max(grown, proposed) if within_tolerance and step < proposed else grown
        left = remaining - step if accepted else remaining
        broken = accepted and not error < 1e300  # the caller detects the NaN
        given_up = work[_STEP_COUNT + lane] > accuracy.most_steps
        work[_REMAINING + lane] = 0.0 if broken or given_up or left <= 1e-12 else left
        work[_REPEATED + lane] = 1.0 if moving and not accepted and not given_up else 0.0
        # Peak pressure over all steps; peak speed on entering an end stop.
        highest = max(new.pressure_a, new.pressure_b) if accepted else -1e300
        work[_PRESSURE_PEAK + lane] = max(work[_PRESSURE_PEAK + lane], highest)
        beyond = accepted and abs(new.position) > c.end_stop_position
        outwards = max(old.velocity, 0.0) if new.position > 0.0 else max(-old.velocity, 0.0)
        work[_SPEED_PEAK + lane] = max(work[_SPEED_PEAK + lane], outwards if beyond else 0.0)
        work[_STEP_COUNT + lane] += 1.0 if moving else 0.0
        lanes.write_state(work, lane, lanes.choice(accepted, new, old))


@inline
def _begin_interval(work, lane, voltage, duration, first_step, lanes):
    c = _read_coefficients(work, lane)
    lanes.write_state(work, lane, command_changed(lanes.read_state(work, lane), c, voltage, lanes.parts))
    work[_VOLTAGE + lane] = voltage
    work[_REMAINING + lane] = duration
    work[_PROPOSED + lane] = first_step


def _build(sources: int, lanes: Lanes) -> Callable[..., None]:
    def integrate(plants, accuracy, first, last):
        """Advance :class:`Plants` from ``first`` up to ``last`` in place through consecutive hold intervals."""
        assert sources >= 0  # keys numba's cache
        state, coefficients, voltage, durations, peaks = plants
        groups = min(GROUPS, -(-(last - first) // LANES))
        # Aligned to cache lines: a vector across two lines costs twice.
        room = np.empty(groups * lanes.rows * LANES + LANES)
        room = room[(-(room.ctypes.data // 8)) % LANES :]
        room[:] = 0.0
        for group in range(groups):
            for lane in range(LANES):
                room[group * lanes.rows * LANES + _PLANT + lane] = -1.0
        strictness = 1.0 / accuracy.tolerance
        first_step = min(FIRST_STEP, accuracy.maximum_step)
        intervals = durations.shape[1]
        following = first
        active = 0
        begun = True
        while begun or active > 0:
            # Lanes at the end of their interval take the next interval, or the next plant.
            begun = False
            again = False
            for group in range(groups):
                work = room[group * lanes.rows * LANES :]
                for lane in range(LANES):
                    again = again or work[_REPEATED + lane] > 0.0
                    while work[_REMAINING + lane] == 0.0:
                        plant = int(work[_PLANT + lane])
                        interval = int(work[_INTERVAL + lane]) + 1
                        if plant >= 0 and interval == intervals:
                            lanes.store(work, lane, state, plant)
                            for row in range(N_PEAKS):
                                peaks[plant, row] = work[_PEAKS + row * LANES + lane]
                            active -= 1
                            plant = -1
                        if plant < 0:
                            plant = following if following < last else -1
                            work[_PLANT + lane] = plant
                            if plant < 0:
                                break
                            interval = 0
                            following += 1
                            active += 1
                            lanes.load(work, lane, state, plant)
                            for row in range(N_COEFFICIENTS):
                                work[_COEFFICIENTS + row * LANES + lane] = coefficients[plant, row]
                            work[_PRESSURE_PEAK + lane] = -1e300
                            work[_SPEED_PEAK + lane] = 0.0
                            work[_STEP_COUNT + lane] = 0.0
                        work[_INTERVAL + lane] = interval
                        duration = durations[plant, interval]
                        if duration > 0.0:
                            _begin_interval(work, lane, voltage[plant, interval], duration, first_step, lanes)
                            again = True
            # The first stage equals the last stage of the previous step, unless a lane begins or repeats a step.
            for stage in range(0 if again else 1, 7):
                for group in range(groups):
                    work = room[group * lanes.rows * LANES :]
                    if stage == 0:
                        for lane in range(LANES):
                            lanes.write_trial(work, lane, lanes.read_state(work, lane))
                    elif stage == 1:
                        _choose_step(work, lanes)
                        lanes.stage_2(work)
                    elif stage == 2:
                        lanes.stage_3(work)
                    elif stage == 3:
                        lanes.stage_4(work)
                    elif stage == 4:
                        lanes.stage_5(work)
                    elif stage == 5:
                        lanes.stage_6(work)
                    else:
                        lanes.stage_7(work)
                for group in range(groups):
                    work = room[group * lanes.rows * LANES :]
                    for lane in range(LANES):
                        c = _read_coefficients(work, lane)
                        s = hold_limits(lanes.read_trial(work, lane), c, lanes.parts)
                        rate = derivatives(s, c, work[_VOLTAGE + lane], lanes.parts)
                        lanes.write_derivative(work, lane, rate)
            for group in range(groups):
                _accept_or_repeat(room[group * lanes.rows * LANES :], strictness, accuracy, lanes)

    return integrate


@cache
def integrators(structure: Structure) -> tuple[Kernel, Any]:
    """The compiled integrator of axes with a structure, and the same to be merged into another kernel."""
    function = _build(SOURCES + structure.number, lanes_of(structure))
    return compiled(function), inline(function)


integrate, integrate_part = integrators(RIGID)
