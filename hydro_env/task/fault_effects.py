"""Effects of the faults of an episode on plant, drive and sensors, in compiled code."""

import math

import numpy as np

from hydro_env.compiling import inline
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.leakage import ROD_SEAL
from hydro_env.task.faults import FAULT_KINDS, FAULTS, Fault, faults_of
from hydro_env.task.random_numbers import between, uniform
from hydro_env.task.sensors import CHANNELS
from hydro_env.task.settings import choice
from hydro_env.units import LITRE_PER_MINUTE

NULL_SHIFT, UNDERLAP, FLOW, HYSTERESIS, TANK, EXTERNAL_LEAK, OFFSET, GAIN, FREEZE, DROPOUT = (
    FAULTS.index(faults_of(kind)[0]) for kind in FAULT_KINDS
)
"""Index of each fault in the record; those of the other sensors follow the first sensor's."""

_CONSTANT, _ONSET, _MIXED = (choice(Fault, "schedule", name) for name in ("constant", "onset", "mixed"))
_SCHEDULES = 3.0  # constant, onset, growth come before "mixed"
_NUMBERS = 6  # number of random numbers per kind of fault
_LOST_SAMPLES = 2_000_000_000  # index of the first drop-out among the numbers of the noise key, beyond noise and biases

FAULT_COLUMNS = tuple(
    Coefficients._fields.index(name)
    for name in ("null_shift", "underlap_squared", "edge_gain", "tank_pressure", ROD_SEAL.coefficient)
)
"""Coefficients of the plant that faults change."""

_NULL_SHIFT, _UNDERLAP, _EDGE_GAIN, _TANK, _EXTERNAL = FAULT_COLUMNS
_ROD_SEAL_AT_TEST = ROD_SEAL.at_test


@inline
def draw_faults(row, coefficient, key, fixed, settings):
    """Draw the faults of an episode; ``fixed``, one per fault, replaces the draw where it is not NaN."""
    row.faulty = 0.0
    duration = settings.steps * settings.control_period
    for kind in range(len(FAULT_KINDS)):
        chance = settings.fault_table[kind]
        number = _NUMBERS * kind
        size = between(key, number, chance.low, chance.high)
        if chance.signed and uniform(key, number + 1) < 0.5:
            size = -size
        hit = -1
        if uniform(key, number + 2) < chance.probability:
            # The drawn one of the sensors that the task allows.
            left = math.floor(uniform(key, number + 3) * chance.sensors)
            for entry in range(chance.first, chance.last):
                if chance.allowed[entry - chance.first] > 0.0:
                    hit = entry if left == 0.0 else hit
                    left -= 1.0
        row.fault_schedule[kind] = chance.schedule
        if chance.schedule == _MIXED:
            row.fault_schedule[kind] = math.floor(_SCHEDULES * uniform(key, number + 4))
        row.fault_start[kind] = duration * between(key, number + 5, chance.start_low, chance.start_high)
        for entry in range(chance.first, chance.last):
            target = size if entry == hit else 0.0
            if not math.isnan(fixed[entry]):
                target = fixed[entry]
            row.fault_target[entry] = target
            row.faulty = 1.0 if target != 0.0 else row.faulty
    for index in range(len(FAULT_COLUMNS)):
        row.sound[index] = coefficient[FAULT_COLUMNS[index]]
    set_faults(row, coefficient, 0.0, settings)


@inline
def _part(schedule, time, begin, end, period):
    """Fraction of its magnitude that a fault has reached at a time."""
    if schedule == _CONSTANT:
        return 1.0
    if time < begin:
        return 0.0
    return 1.0 if schedule == _ONSET else min((time - begin) / max(end - begin, period), 1.0)


@inline
def set_faults(row, coefficient, time, settings):
    """Set the faults at a time, s, in the record and in the coefficients of the plant."""
    if row.faulty == 0.0:
        return
    end = settings.steps * settings.control_period
    for kind in range(len(FAULT_KINDS)):
        chance = settings.fault_table[kind]
        part = _part(row.fault_schedule[kind], time, row.fault_start[kind], end, settings.control_period)
        for entry in range(chance.first, chance.last):
            row.fault[entry] = part * row.fault_target[entry]
    sound = row.sound
    underlap = math.sqrt(sound[1]) + row.fault[UNDERLAP]
    coefficient[_NULL_SHIFT] = sound[0] + row.fault[NULL_SHIFT]
    coefficient[_UNDERLAP] = underlap * underlap
    coefficient[_EDGE_GAIN] = sound[2] * (1.0 + row.fault[FLOW])
    coefficient[_TANK] = sound[3] + row.fault[TANK]
    coefficient[_EXTERNAL] = sound[4] + row.fault[EXTERNAL_LEAK] * LITRE_PER_MINUTE / _ROD_SEAL_AT_TEST


@inline
def driven(command, before, row):
    """Command that the valve's drive follows, −1 to 1: play of the width of the hysteresis."""
    half = 0.5 * row.fault[HYSTERESIS]
    return min(max(before, command - half), command + half)


@inline
def misread(true, channel, row, sensor):
    """Value of a sensor with wrong gain or offset for a true value; unit of the signal."""
    return true * (1.0 + row.fault[GAIN + channel]) + row.fault[OFFSET + channel] * (sensor.high - sensor.low)


@inline
def read_truly(reading, channel, row, sensor):
    """True value for a reading of such a sensor; the inverse of :func:`misread`."""
    return (reading - row.fault[OFFSET + channel] * (sensor.high - sensor.low)) / (1.0 + row.fault[GAIN + channel])


@inline
def lost_or_frozen(value, channel, row, sensor):
    """Reading of this sample: the previous one if the sensor is frozen, the lower end of its range if lost."""
    if row.fault[FREEZE + channel] > 0.0 and row.step > 0.0:
        value = row.measured[channel]
    share = row.fault[DROPOUT + channel]
    if share > 0.0:
        index = _LOST_SAMPLES + len(CHANNELS) * np.int64(row.step) + channel
        if uniform(row.noise_key, index) < share:
            value = sensor.low
    return value
