"""Draws and schedules of an episode: the leak past the piston, and the external force."""

import math
from typing import get_args

from hydro_env.compiling import inline
from hydro_env.plant.arrays import read_coefficients
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.leakage import LEAK_LAWS, LeakLaw
from hydro_env.task.configuration import Disturbance, LeakageDraw
from hydro_env.task.fault_effects import set_faults
from hydro_env.task.random_numbers import log_within, uniform, within
from hydro_env.task.reference_signals import supply_forces
from hydro_env.task.settings import choice
from hydro_env.units import LITRE_PER_MINUTE

_CONSTANT, _ONSET, _MIXED_SCHEDULE = (choice(LeakageDraw, "schedule", name) for name in ("constant", "onset", "mixed"))
_SCHEDULES = 3.0  # constant, onset, growth come before "mixed"
_NONE, _PULSE, _SINE, _MIXED = (choice(Disturbance, "kind", name) for name in ("none", "pulse", "sine", "mixed"))
_CHANGING = 3.0  # kinds of a changing force: step, pulse, sine, in this order after "none"

_LAWS = tuple(LEAK_LAWS[name] for name in get_args(LeakLaw))
_AT_TEST = tuple(law.at_test for law in _LAWS)
LEAK_COLUMNS = tuple(Coefficients._fields.index(law.coefficient) for law in _LAWS)  # that the leak changes, by law

_EXTERNAL_FORCE = Coefficients._fields.index("external_force")


@inline
def draw_leak(row, key, fixed, settings):
    """Draw the leak, healthy or faulty, and the start of its change; ``fixed`` (l/min at 100 bar) replaces the draw."""
    leakage = settings.leakage
    healthy = log_within(key, 0, leakage.healthy_range)
    faulty = log_within(key, 1, leakage.faulty_range)
    target = healthy if uniform(key, 2) < leakage.healthy_share else faulty
    if not math.isnan(fixed):
        target = fixed
        healthy = min(healthy, target)
    row.leak_start_flow = healthy
    row.leak_target_flow = target
    row.leak_schedule = leakage.schedule
    if leakage.schedule == _MIXED_SCHEDULE:
        row.leak_schedule = math.floor(_SCHEDULES * uniform(key, 4))
    duration = settings.steps * settings.control_period
    row.leak_start_time = duration * within(key, 3, leakage.start_range)


@inline
def _leak_flow(row, time, settings):
    """Leakage of the schedule at a time, l/min at 100 bar: constant, sudden onset, or log-linear growth."""
    start, target, begin = row.leak_start_flow, row.leak_target_flow, row.leak_start_time
    if row.leak_schedule == _CONSTANT:
        return target
    if time < begin:
        return start
    if row.leak_schedule == _ONSET or target == start:  # both may be 0
        return target
    end = settings.steps * settings.control_period
    share = min((time - begin) / max(end - begin, settings.control_period), 1.0)
    return start * (target / start) ** share


@inline
def set_leak(row, coefficient, time, settings):
    """Write the leak at a time, s, to the record and to the coefficients of the plant."""
    flow = _leak_flow(row, time, settings)
    row.leak_flow = flow
    row.leak_class = 0.0
    for index in range(settings.class_limits.shape[0]):
        row.leak_class += 1.0 if flow > settings.class_limits[index] else 0.0
    for law in range(len(LEAK_COLUMNS)):
        own = law == settings.leakage.law
        coefficient[LEAK_COLUMNS[law]] = flow * LITRE_PER_MINUTE / _AT_TEST[law] if own else 0.0


@inline
def _disturbed(key, settings):
    return uniform(key, 7) < settings.disturbance.share


@inline
def draw_steady_force(row, coefficient, key, settings):
    """Add the constant part of the disturbance to the plant's own external force: a share of what that leaves."""
    c = read_coefficients(coefficient)
    out, back = supply_forces(c)
    part = within(key, 4, settings.disturbance.steady_share) if _disturbed(key, settings) else 0.0
    own = c.external_force
    row.force_base = own + (part * (out - own) if uniform(key, 5) < 0.5 else -part * (back + own))
    coefficient[_EXTERNAL_FORCE] = row.force_base


@inline
def draw_changing_force(row, coefficient, key, settings):
    """Draw kind, amplitude, start and frequency of the changing part of the disturbance of an episode."""
    disturbance = settings.disturbance
    row.force_kind, row.force_amplitude = disturbance.kind, 0.0
    if disturbance.kind == _NONE:
        return
    if not _disturbed(key, settings):
        row.force_kind = _NONE
        return
    if disturbance.kind == _MIXED:
        row.force_kind = 1.0 + math.floor(_CHANGING * uniform(key, 6))
    force = within(key, 0, disturbance.force_range)
    inwards = uniform(key, 1) < 0.5
    if disturbance.force_share[1] > 0.0:
        out, back = supply_forces(read_coefficients(coefficient))
        limit = min(out, back) if row.force_kind == _SINE else out if inwards else back
        force = limit * within(key, 0, disturbance.force_share)
    row.force_amplitude = force if inwards else -force
    duration = settings.steps * settings.control_period
    row.force_start_time = duration * within(key, 2, disturbance.start_range)
    row.force_frequency = within(key, 3, disturbance.frequency_range)


@inline
def _external_force(row, time, settings):
    """External force in N: the plant's own plus the disturbance."""
    after = time - row.force_start_time
    if after < 0.0:
        return row.force_base
    force = row.force_amplitude
    if row.force_kind == _PULSE and after >= settings.disturbance.pulse_duration:
        force = 0.0
    if row.force_kind == _SINE:
        force *= math.sin(2.0 * math.pi * row.force_frequency * after)
    return row.force_base + force


@inline
def follow_schedules(row, coefficient, settings):
    """Set leak, faults and external force for the control period that begins."""
    time = row.step * settings.control_period
    set_faults(row, coefficient, time, settings)
    if row.leak_schedule != _CONSTANT:
        set_leak(row, coefficient, time, settings)
    if settings.disturbance.kind != _NONE:
        coefficient[_EXTERNAL_FORCE] = _external_force(row, time + 0.5 * settings.control_period, settings)
