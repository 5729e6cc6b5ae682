"""The data of each axis in compiled code: a record with named fields, and arrays."""

from typing import Any, NamedTuple

import numpy as np

from hydro_env.compiling import numba
from hydro_env.plant.kernel import N_COEFFICIENTS, N_PEAKS
from hydro_env.plant.states import N_ALL_STATES, STATE_NAMES
from hydro_env.task.faults import FAULT_KINDS, FAULTS
from hydro_env.task.rewards import REWARD_TERMS
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import Array, Floats, Indices, Singles

MOST_LATE = 5  # largest latency of a command in control periods


def numbers(*names: str) -> list[tuple[str, str]]:
    """Fields of a record that hold one number each."""
    return [(name, "f8") for name in names]


RECORD = np.dtype(
    [
        *numbers(
            "step",  # control periods since the start of the episode
            "command",  # −1…1, last one given
            "change",  # of the command since the previous period
            "rig",  # number of the rig among those of the task
            "reference_family",  # index into REFERENCE_FAMILIES
            "latency",  # s, from sampling to the new command
            "redraws",  # rejected draws of this episode
            "leak_flow",  # l/min at 100 bar, now
            "leak_class",  # index into LEAKAGE_CLASSES
            "leak_schedule",  # index of the schedule
            "leak_start_flow",
            "leak_target_flow",
            "leak_start_time",  # s
            "force_kind",  # index of the disturbance's kind
            "force_amplitude",  # N, of the disturbance
            "force_start_time",  # s
            "force_frequency",  # Hz
            "force_base",  # N, of the plant itself and the steady part of the disturbance
        ),
        ("bias", "f8", (len(CHANNELS),)),  # unit of each sensor
        ("measured", "f8", (len(CHANNELS),)),  # unit of each sensor
        *numbers(
            "velocity_estimate",  # m/s
            "error_integral",  # m s
            "true_a",  # Pa, at the last sample
            "true_b",
            "sensed_a",  # Pa, behind the transducer's lag, before noise
            "sensed_b",
            "position",  # m, true
            "velocity",  # m/s, true
            "reference",  # m, now
        ),
        ("costs", "f8", (len(REWARD_TERMS),)),
        *numbers(
            "reward",
            "failure",  # index into FAILURES
            "faulty",  # 1 if the episode has a fault
        ),
        ("noise_key", "u8"),
        ("drive", "f8"),  # −1…1, command that the valve's drive follows
        ("fault", "f8", (len(FAULTS),)),  # magnitude of each fault now
        ("fault_target", "f8", (len(FAULTS),)),
        ("fault_schedule", "f8", (len(FAULT_KINDS),)),  # index of the schedule
        ("fault_start", "f8", (len(FAULT_KINDS),)),  # s
        ("sound", "f8", (5,)),  # coefficients of the plant without faults
        ("late", "f8"),  # whole control periods by which a command is late
        ("sent", "f8", (MOST_LATE - 1,)),  # drives of earlier periods that may still have to act, newest first
    ]
)
"""State of an axis during its episode, except the state of its plant."""

SEEDS = np.dtype([("root", "u8"), ("episode", "i8")])  # root of an axis's random numbers, and number of its episode


COMMANDS = 2  # commands in a control period: the previous one acts during the latency, the new one during the rest

FIRST_COEFFICIENT = N_ALL_STATES
FIRST_VOLTAGE = FIRST_COEFFICIENT + N_COEFFICIENTS
FIRST_DURATION = FIRST_VOLTAGE + COMMANDS
FIRST_PEAK = FIRST_DURATION + COMMANDS
PLANT_COLUMNS = FIRST_PEAK + N_PEAKS
"""Columns of the integrator's array: states, coefficients, voltages, durations and peaks of an axis, in one row.

There is a place for the states of every part (``ALL_STATES``); those of absent parts stay as they began.

It is one array instead of four, because passing an array to compiled code takes a tenth of a microsecond.
"""


class AxisArrays(NamedTuple):
    """Arrays of N axes that a step reads and writes."""

    record: Array  # (N,), RECORD
    plant: Floats  # (N, PLANT_COLUMNS)
    reference: Floats  # (N, samples), m
    observation: Singles  # (N, observations)


class Chances(NamedTuple):
    """Seeds and distributions of the episodes of N axes."""

    seeds: Array  # (N,), SEEDS
    plant: Floats  # (rigs, parameters), nominal values
    draws: Array  # (rigs, drawn parameters), DRAW
    family_weights: Floats  # (families,)


class Fixed(NamedTuple):
    """Values that the caller has fixed in the next episode of N axes; NaN, or family −1, means drawn."""

    parameters: Floats  # (N, parameters)
    leakage_flow_lpm: Floats  # (N,), l/min at 100 bar
    initial_position: Floats  # (N,), m
    rig: Indices  # (N,), −1 means drawn
    family: Indices  # (N,)
    user_reference: Floats  # (N, samples), m
    faults: Floats  # (N, faults), magnitudes


OPTION_NAMES = ("leakage_flow_lpm", "reference", "parameters", "initial_position", "rig", "faults", "reset_mask")
"""Names of the options of ``reset``."""

FAILURES = (
    "none",
    "end stop hit at speed",
    "pressure above the rating",
    *(f"{name} outside its valid range" for name in STATE_NAMES),
    "integration budget exceeded",
    "initial position cannot be held",
    "reference beyond the force of the supply",
)
"""Reasons for the end of an episode; the last two prevent its start."""

NO_FAILURE, HIT_END_STOP, OVERPRESSURE, FIRST_INVALID_STATE = range(4)
OVER_BUDGET, CANNOT_BE_HELD, CANNOT_BE_REACHED = range(len(FAILURES) - 3, len(FAILURES))


def table(count: int, kind: np.dtype[Any]) -> Array:
    """Rows of zeros with fields that kernels access by name, even with numba's compiler switched off."""
    rows = np.zeros(count, kind)
    return rows.view(np.recarray) if numba().config.DISABLE_JIT else rows
