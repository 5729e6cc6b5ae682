"""Compiled integration of one or many plants with the right-hand side of ``equations``, each with its own step.

The method is the Runge–Kutta pair of order 5(4) of Tsitouras (2011). Every step of every plant is as long as its
error estimate allows (:data:`TOLERANCE`), and ends at the next kink of the solution if that comes first.

The kernel works on ``LANES`` plants at a time: loops over lanes become vector instructions, and each plant fills one
lane. When a plant reaches its end time, its lane takes the next plant. No operation mixes lanes, so a plant's numbers
depend neither on its neighbours, nor on their number, nor on threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hydro_env.compiling import (
    SOURCES,
    compiled,
    inline,
    lane_function,
    tuple_map,
    tuple_maximum,
    tuple_reader,
    tuple_writer,
)
from hydro_env.plant.equations import Coefficients, command_changed, derivatives, hold_limits, time_to_kink
from hydro_env.plant.states import N_STATES, State
from hydro_env.types import Floats

LANES = 8
"""Plants that one vector instruction works on (eight doubles fill an AVX-512 register)."""

GROUPS = 2
"""Groups of lanes in turn: one computes while another waits for its roots and divisions."""

TOLERANCE = 1e-6
"""Largest estimated error of a step, relative to each state's size (the weights in ``states``)."""

MAXIMUM_STEP = 2e-3
"""s; no step is longer."""

MOST_STEPS_PER_PERIOD = 50_000.0
"""Largest number of inner steps per call; a plant that needs more stops, and ``peaks`` holds the number."""

FIRST_STEP = 1e-3 / 3
"""s; tried first in each hold interval."""

STABLE_PRODUCT = 3.2
"""h·|λ| up to which the method is stable for rates with at least a quarter of their size as damping."""

SHORTEST_STEP = 1e-8
"""s; a step this short is accepted with any error, so that the integration always ends."""

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
PEAK_PRESSURE, IMPACT_SPEED, STEPS = range(N_PEAKS)
"""Columns of ``peaks``: highest chamber pressure (Pa), highest speed at an end stop (m/s), number of inner steps."""


class Plants(NamedTuple):
    """Arrays of the plants that :func:`integrate` advances, one row each."""

    state: Floats  # (plants, N_STATES), changed in place
    coefficients: Floats  # (plants, N_COEFFICIENTS)
    voltage: Floats  # (plants, intervals), V, held in each interval
    durations: Floats  # (plants, intervals), s
    peaks: Floats  # (plants, N_PEAKS), written


class Accuracy(NamedTuple):
    """Accuracy of the integration."""

    maximum_step: float = MAXIMUM_STEP  # s, longest inner step
    tolerance: float = TOLERANCE  # largest estimated error of a step; infinity for steps of fixed length
    most_steps: float = MOST_STEPS_PER_PERIOD  # budget of inner steps per call


# Working memory of a group of lanes: rows of LANES numbers.
_STAGE_NAMES = [f"stage_{number}" for number in range(1, len(STAGES) + 1)]
_SIZES = {
    "state": N_STATES,
    "coefficients": N_COEFFICIENTS,
    "peaks": N_PEAKS,
    "trial": N_STATES,
    "derivative": N_STATES,
    **dict.fromkeys(_STAGE_NAMES, N_STATES),
    "error": N_STATES,
    **dict.fromkeys(("voltage", "remaining", "proposed", "step", "repeated", "plant", "interval"), 1),
}
_ROW = dict(zip(_SIZES, np.cumsum([0, *_SIZES.values()]).tolist(), strict=False))
_ROWS = sum(_SIZES.values())
_COEFFICIENTS, _PEAKS = (LANES * _ROW[name] for name in ("coefficients", "peaks"))
_VOLTAGE, _REMAINING, _PROPOSED, _STEP, _REPEATED, _PLANT, _INTERVAL = (
    LANES * _ROW[name] for name in ("voltage", "remaining", "proposed", "step", "repeated", "plant", "interval")
)
_PRESSURE_PEAK, _SPEED_PEAK, _STEP_COUNT = (_PEAKS + LANES * row for row in range(N_PEAKS))

_read_state, _read_trial, _read_derivative, _read_error = (
    tuple_reader(State, _ROW[name], LANES) for name in ("state", "trial", "derivative", "error")
)
_read_coefficients = tuple_reader(Coefficients, _ROW["coefficients"], LANES)
_write_state, _write_trial, _write_derivative = (
    tuple_writer(State, _ROW[name], LANES) for name in ("state", "trial", "derivative")
)
_read_weights = tuple_reader(State, _ROW["coefficients"] + Coefficients._fields.index("position_weight"), LANES)
_difference = tuple_map(State, "a.{name} - b.{name}", "a, b")
_choice = tuple_map(State, "a.{name} if condition else b.{name}", "condition, a, b")
_weighted_maximum = tuple_maximum(State, "abs(error.{name} * weight.{name})", "error, weight")


def _row(name: str) -> str:
    return f"work[{LANES * _ROW[name]} + place]"


def _sum(weights: Sequence[float], names: Sequence[str]) -> str:
    """Step times a weighted sum of rows, as text; numba compiles loops over a changing number of terms more slowly."""
    terms = [f"{weight!r} * {_row(name)}" for weight, name in zip(weights, names, strict=True)]
    return f"work[{_STEP} + lane] * ({' + '.join(terms)})"


def _stage(number: int) -> Any:
    """``stage(work)``: set every lane's trial state from the derivatives so far (STAGES), and keep the newest one."""
    known = [*_STAGE_NAMES[: number - 1], "derivative"]
    trial = f"{_row('trial')} = {_row('state')} + {_sum(STAGES[number - 1], known)}"
    return lane_function("work", N_STATES, LANES, trial, f"{_row(_STAGE_NAMES[number - 1])} = {_row('derivative')}")


_stage_2, _stage_3, _stage_4, _stage_5, _stage_6, _stage_7 = (_stage(number) for number in range(1, 7))
_estimate_error = lane_function(
    "work", N_STATES, LANES, f"{_row('error')} = {_sum(ERROR, [*_STAGE_NAMES, 'derivative'])}"
)


@inline
def _choose_step(work):
    """Set each lane's next step: as proposed, but no further than the end of the interval or the next kink."""
    for lane in range(LANES):
        remaining = work[_REMAINING + lane]
        proposed = min(work[_PROPOSED + lane], remaining)
        # Two equal last steps instead of a long and a very short one.
        halved = 0.5 * remaining if 2.0 * proposed > remaining and proposed < remaining else proposed
        c = _read_coefficients(work, lane)
        kink = time_to_kink(_read_state(work, lane), _read_derivative(work, lane), c)
        work[_STEP + lane] = kink if kink < halved else halved  # also taken when the state is NaN


@inline
def _accept_or_repeat(work, strictness, accuracy):
    """Accept or repeat each lane's step by its estimated error, and propose the next one."""
    _estimate_error(work)
    for lane in range(LANES):
        remaining = work[_REMAINING + lane]
        proposed = work[_PROPOSED + lane]
        step = work[_STEP + lane]
        c = _read_coefficients(work, lane)
        old = _read_state(work, lane)
        trial = _read_trial(work, lane)
        new = hold_limits(trial, c)
        other = hold_limits(_difference(trial, _read_error(work, lane)), c)
        error = strictness * _weighted_maximum(_difference(new, other), _read_weights(work, lane))
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
        _write_state(work, lane, _choice(accepted, new, old))


@inline
def _begin_interval(work, lane, voltage, duration, first_step):
    """Let a new command act in one lane."""
    s = command_changed(_read_state(work, lane), _read_coefficients(work, lane), voltage)
    _write_state(work, lane, s)
    work[_VOLTAGE + lane] = voltage
    work[_REMAINING + lane] = duration
    work[_PROPOSED + lane] = first_step


def _build(sources: int) -> Callable[..., None]:
    def integrate(plants, accuracy, first, last):
        """Advance plants in place through consecutive hold intervals.

        Args:
            plants: :class:`Plants`.
            accuracy: :class:`Accuracy`.
            first: start of the half-open range of plants to advance.
            last: end of that range.
        """
        assert sources >= 0  # keys numba's cache
        state, coefficients, voltage, durations, peaks = plants
        groups = min(GROUPS, -(-(last - first) // LANES))
        # Aligned to cache lines: a vector across two lines costs twice.
        room = np.empty(groups * _ROWS * LANES + LANES)
        room = room[(-(room.ctypes.data // 8)) % LANES :]
        room[:] = 0.0
        for group in range(groups):
            for lane in range(LANES):
                room[group * _ROWS * LANES + _PLANT + lane] = -1.0
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
                work = room[group * _ROWS * LANES :]
                for lane in range(LANES):
                    again = again or work[_REPEATED + lane] > 0.0
                    while work[_REMAINING + lane] == 0.0:
                        plant = int(work[_PLANT + lane])
                        interval = int(work[_INTERVAL + lane]) + 1
                        if plant >= 0 and interval == intervals:
                            for row in range(N_STATES):
                                state[plant, row] = work[row * LANES + lane]
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
                            for row in range(N_STATES):
                                work[row * LANES + lane] = state[plant, row]
                            for row in range(N_COEFFICIENTS):
                                work[_COEFFICIENTS + row * LANES + lane] = coefficients[plant, row]
                            work[_PRESSURE_PEAK + lane] = -1e300
                            work[_SPEED_PEAK + lane] = 0.0
                            work[_STEP_COUNT + lane] = 0.0
                        work[_INTERVAL + lane] = interval
                        duration = durations[plant, interval]
                        if duration > 0.0:
                            _begin_interval(work, lane, voltage[plant, interval], duration, first_step)
                            again = True
            # The first stage equals the last stage of the previous step, unless a lane begins or repeats a step.
            for stage in range(0 if again else 1, 7):
                for group in range(groups):
                    work = room[group * _ROWS * LANES :]
                    if stage == 0:
                        for lane in range(LANES):
                            _write_trial(work, lane, _read_state(work, lane))
                    elif stage == 1:
                        _choose_step(work)
                        _stage_2(work)
                    elif stage == 2:
                        _stage_3(work)
                    elif stage == 3:
                        _stage_4(work)
                    elif stage == 4:
                        _stage_5(work)
                    elif stage == 5:
                        _stage_6(work)
                    else:
                        _stage_7(work)
                for group in range(groups):
                    work = room[group * _ROWS * LANES :]
                    for lane in range(LANES):
                        c = _read_coefficients(work, lane)
                        s = hold_limits(_read_trial(work, lane), c)
                        _write_derivative(work, lane, derivatives(s, c, work[_VOLTAGE + lane]))
            for group in range(groups):
                _accept_or_repeat(room[group * _ROWS * LANES :], strictness, accuracy)

    return integrate


_integrate = _build(SOURCES)
integrate = compiled(_integrate)
integrate_part = inline(_integrate)
"""The same function, to be merged into another kernel."""
