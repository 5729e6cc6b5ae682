"""The named numbers of a task and of an axis' episode, as compiled code keeps them."""

from __future__ import annotations

from typing import NamedTuple

from hydro_env.plant.states import State


class Settings(NamedTuple):
    """The numbers of a task that compiled code needs."""

    control_period: float
    maximum_step: float
    tolerance: float
    steps: float
    healthy_share: float
    healthy_low: float
    healthy_high: float
    faulty_low: float
    faulty_high: float
    orifice_law: float
    schedule: float
    leak_start_low: float
    leak_start_high: float
    initial_low: float
    initial_high: float
    sensors_enabled: float
    pressure_decay: float  # exp(−T/τ) of the transducers
    pressure_lag: float  # τ/T
    velocity_blend: float  # T/(T + τ)
    integral_time: float
    integral_limit: float
    tracking_weight: float
    error_scale: float
    error_limit: float
    effort_weight: float
    failure_weight: float
    end_stop_speed: float
    pressure_rating: float
    disturbance: float
    force_low: float
    force_high: float
    force_start_low: float
    force_start_high: float
    pulse_duration: float
    force_frequency_low: float
    force_frequency_high: float


class Record(NamedTuple):
    """Columns of ``record``: what an axis carries through its episode."""

    step: float
    command: float  # −1…1, last one given
    reference_family: float
    leak_flow: float  # l/min at 100 bar, now
    leak_start_flow: float
    leak_target_flow: float
    leak_start_time: float  # s
    force_amplitude: float  # N, of the disturbance
    force_start_time: float  # s
    force_frequency: float  # Hz
    force_base: float  # N, of the plant itself
    bias_position: float
    bias_a: float
    bias_b: float
    bias_spool: float
    measured_position: float  # m
    measured_a: float  # Pa
    measured_b: float  # Pa
    measured_spool: float
    velocity_estimate: float  # m/s
    error_integral: float  # m s
    true_a: float  # Pa, at the last sample
    true_b: float
    sensed_a: float  # Pa, behind the transducer's lag, before noise
    sensed_b: float
    position: float  # m, true
    velocity: float  # m/s, true
    reference: float  # m, now
    cost_tracking: float
    cost_effort: float
    cost_failure: float
    failure: float  # code, see FAILURES


FAILURES = (
    "none",
    "end stop hit at speed",
    "pressure above the rating",
    *(f"{name} outside its valid range" for name in State._fields),
    "initial position cannot be held",
    "reference beyond the force of the supply",
)
NO_FAILURE, HIT_END_STOP, OVERPRESSURE, FIRST_INVALID_STATE = range(4)
CANNOT_BE_HELD, CANNOT_BE_REACHED = len(FAILURES) - 2, len(FAILURES) - 1

N_SETTINGS = len(Settings._fields)
FIXED_OBSERVATIONS = 9
"""Observations besides the previews of the reference."""

CHANNELS, CHANNEL_COLUMNS = 4, 5
"""Shape of the table of sensors: position, both pressures, spool; noise, bias, resolution, low, high."""

DRAW_INDEX, DRAW_LOG, DRAW_LOW, DRAW_HIGH, DRAW_TIMES, DRAW_OTHERWISE, DRAW_PROBABILITY = range(7)
"""Columns of the table of randomised parameters."""
