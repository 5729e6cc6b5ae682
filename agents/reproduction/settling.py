"""Fig. 13: settling time after a quick stop against leakage resistance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.reproduction.oscillation import SETTLED, band_envelope, last_above, swing_envelope
from agents.reproduction.rig import LAWS, Law, Rig, quick_stop, simplified, with_leak
from agents.reproduction.signals import recorded_acceleration
from hydro_env import ConfigurationError, HydroError, PlantParameters, Trajectory, resistance_from_flow
from hydro_env.plant.linearisation import Mode, linearise
from hydro_env.plant.states import STATE_NAMES

Array = NDArray[np.float64]

LEAKS = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0)
"""l/min at 100 bar, healthy to severe."""

FRICTION_MODELS = ("none", "stribeck", "lugre")
"""``friction.model`` of each column of the figure; one more entry is one more column."""

FRICTION_WORDS = {"none": "no friction", "lugre": "LuGre friction"}
"""Heading of a friction model; of all others their name."""

NOISE_SEEDS = range(5)
EDGE = 0.1  # s at the end of the record, where the filter of the noisy signal has no future
RING_DOWN = (0.02, 0.10)  # s after the stop command; the state of the linear theory is the mean over it
FIRST_SWINGS = 0.05  # s after the stop command. All three times Rig.stretch


class Settling(NamedTuple):
    """Settling of one quick stop, seconds from the command to stop."""

    clean: float  # of the noise-free acceleration
    naive: float  # last |a| above the level, drift and all
    theory: float  # linear theory; NaN with friction
    frequency: float  # rad/s of the linearised axis; NaN where it does not oscillate
    damping: float
    start: float  # m/s², largest swing after the stop


def friction_words(model: str) -> str:
    """A friction model as the figure heads it."""
    return FRICTION_WORDS.get(model, f"{model.capitalize()} friction")


def friction_models(rig: Rig) -> tuple[str, ...]:
    """Friction models to compare: :data:`FRICTION_MODELS` and the rig's own; none alone if it has no friction."""
    if not rig.has_friction:
        return ("none",)
    models = dict.fromkeys((*FRICTION_MODELS, rig.parameters.friction.model))
    return tuple(model for model in models if _possible(rig.parameters, model))


def _possible(base: PlantParameters, model: str) -> bool:
    try:
        simplified(base, model, True)
    except ConfigurationError:  # the forces of the rig do not fit this model
        return False
    return True


def oscillation_mode(run: Trajectory, stretch: float = 1.0) -> Mode | None:
    """The mode of the axis without friction, linearised at the mean state of the first 0.1 s after the stop.

    Friction is left out: at rest its smooth sign is so steep that the linear axis would not oscillate at all.
    """
    window = (run.time >= stretch * RING_DOWN[0]) & (run.time <= stretch * RING_DOWN[1])
    state = run.states[window].mean(axis=0)
    for name in ("velocity", "spool_position", "spool_velocity", "coil_current"):
        state[STATE_NAMES.index(name)] = 0.0
    try:
        return linearise(run.parameters.replace(friction={"model": "none"}), state, 0.0).hydraulic_mode
    except ArithmeticError:
        return None


def settling_of(run: Trajectory, reference_frequency: float, stretch: float = 1.0) -> Settling:
    """Settling times of one quick stop; the drift is the mean over one period of ``reference_frequency`` (rad/s)."""
    after = run.time >= 0.0
    time, acceleration = run.time[after], run.acceleration[after]
    swing = swing_envelope(time, acceleration, reference_frequency)
    first = int(np.argmax(swing[time <= stretch * FIRST_SWINGS]))
    mode = oscillation_mode(run, stretch)
    theory = math.nan
    if mode is not None and run.parameters.friction.model == "none":
        decay = mode.damping_ratio * mode.natural_frequency
        theory = float(time[first]) + math.log(max(float(swing[first]) / SETTLED, 1.0)) / decay
    return Settling(
        last_above(time, swing),
        last_above(time, np.abs(acceleration)),
        theory,
        mode.natural_frequency if mode else math.nan,
        mode.damping_ratio if mode else math.nan,
        float(swing[first]),
    )


def settling_from_signal(run: Trajectory, reference_frequency: float, seed: int, stretch: float = 1.0) -> float:
    """Settling time in s that the accelerometer's record gives, by the envelope in a band about the oscillation."""
    sample_time = float(run.time[1] - run.time[0])
    signal = recorded_acceleration(run.acceleration, sample_time, np.random.default_rng(seed))
    outline = band_envelope(signal, sample_time, reference_frequency)
    usable = (run.time >= 0.0) & (run.time <= run.time[-1] - stretch * EDGE)
    return last_above(run.time[usable], outline[usable])


def healthy_frequency(rig: Rig) -> float:
    """Oscillation frequency in rad/s with a tight seal: where all detectors look."""
    mode = oscillation_mode(
        quick_stop(with_leak(simplified(rig.parameters, "none", False), LEAKS[0], "laminar"), rig), rig.stretch
    )
    if mode is None:
        raise ArithmeticError("the axis does not oscillate even with a tight seal and without friction")
    return mode.natural_frequency


def settling_table(rig: Rig, leaks: tuple[float, ...] = LEAKS) -> pd.DataFrame:
    """One row per friction, null leakage, law and leak: settling times in s by every method.

    Raises:
        HydroError: the stop is too gentle.
    """
    frequency = healthy_frequency(rig)
    rows = []
    for friction in friction_models(rig):
        for underlap in (False, True) if rig.parameters.valve.underlap > 0.0 else (False,):
            plain = simplified(rig.parameters, friction, underlap)
            for law in LAWS:
                rows += [_row(rig, plain, law, leak, frequency) for leak in leaks]
                need_a_swing(rows[0]["clean_s"])
    return pd.DataFrame(rows)


def need_a_swing(settling_time: float | str | bool) -> None:
    """Raise where the stop of the tight axis without friction is too gentle for a settling time.

    Raises:
        HydroError: there is nothing to settle.
    """
    if settling_time == 0.0:
        raise HydroError(
            f"the valve closes so gently, or so little moves, that no swing after the stop exceeds {SETTLED:g} m/s²: "
            f"there is nothing to settle"
        )


def _row(rig: Rig, plain: PlantParameters, law: Law, leak: float, frequency: float) -> dict[str, float | str | bool]:
    run = quick_stop(with_leak(plain, leak, law), rig)
    settling = settling_of(run, frequency, rig.stretch)
    seen = [settling_from_signal(run, frequency, seed, rig.stretch) for seed in NOISE_SEEDS]
    return {
        "friction": plain.friction.model,
        "valve_null_leakage": plain.valve.underlap > 0.0,
        "law": law,
        "leak_lpm": leak,
        "resistance_pa_s_m3": resistance_from_flow(leak),
        "clean_s": settling.clean,
        "signal_s": float(np.median(seen)),
        "signal_low_s": min(seen),
        "signal_high_s": max(seen),
        "theory_s": settling.theory,
        "naive_s": settling.naive,
        "natural_frequency_rad_s": settling.frequency,
        "damping_ratio": settling.damping,
        "first_swing_m_s2": settling.start,
    }
