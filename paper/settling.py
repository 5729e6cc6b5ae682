"""Fig. 13: settling time after a quick stop over the leak, and the friction that hides its trend."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

from hydro_env import ConfigurationError, HydroError, PlantParameters, Trajectory, resistance_from_flow
from hydro_env.plant.linearisation import Mode, linearise
from hydro_env.plant.states import STATE_NAMES
from paper.leaks import FINE_BELOW, MODERATE, SCAN, TIGHT
from paper.rig import LAWS, Law, Rig, quick_stop, simplified, with_friction_share, with_leak
from paper.signals import SETTLED, band_envelope, last_above, recorded_acceleration, swing_envelope

FRICTION_MODELS = ("none", "stribeck", "lugre")
"""``friction.model`` of each column of the figure; one more entry is one more column."""

FRICTION_SHARES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Friction of the scan relative to the assumed friction."""

METHODS = {"clean_s": "noise-free", "signal_s": "accelerometer", "theory_s": "linear theory"}
NOISE_SEEDS = range(5)
EDGE = 0.1  # s at the end of the record, where the filter of the noisy signal has no future
RING_DOWN = (0.02, 0.10)  # s after the stop command; the state of the linear theory is the mean over it
FIRST_SWINGS = 0.05  # s after the stop command. All three times Rig.stretch


class Settling(NamedTuple):
    """Settling of one quick stop, by the columns of its table; seconds from the command to stop."""

    clean_s: float  # of the noise-free acceleration
    theory_s: float  # linear theory; NaN with friction
    naive_s: float  # last |a| above the level, including the drift
    natural_frequency_rad_s: float  # of the linearised axis; NaN where it does not oscillate
    damping_ratio: float
    first_swing_m_s2: float  # largest after the stop


def friction_words(model: str) -> str:
    """A friction model as a heading."""
    return {"none": "no friction", "lugre": "LuGre friction"}.get(model, f"{model.capitalize()} friction")


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

    Friction is left out: at rest the slope of its smooth sign would suppress any oscillation of the linear axis.
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
        theory,
        last_above(time, np.abs(acceleration)),
        mode.natural_frequency if mode else math.nan,
        mode.damping_ratio if mode else math.nan,
        float(swing[first]),
    )


def settling_from_signal(run: Trajectory, reference_frequency: float, seed: int, stretch: float = 1.0) -> float:
    """Settling time in s from the accelerometer's record, by the envelope in a band about the oscillation."""
    sample_time = float(run.time[1] - run.time[0])
    signal = recorded_acceleration(run.acceleration, sample_time, np.random.default_rng(seed))
    outline = band_envelope(signal, sample_time, reference_frequency)
    usable = (run.time >= 0.0) & (run.time <= run.time[-1] - stretch * EDGE)
    return last_above(run.time[usable], outline[usable])


def healthy_frequency(rig: Rig) -> float:
    """Oscillation frequency in rad/s with a tight seal; all detectors use it.

    Raises:
        ArithmeticError: the axis does not oscillate.
    """
    plant = with_leak(simplified(rig.parameters, "none", False), TIGHT, "laminar")
    mode = oscillation_mode(quick_stop(plant, rig), rig.stretch)
    if mode is None:
        raise ArithmeticError("the axis does not oscillate even with a tight seal and without friction")
    return mode.natural_frequency


def settling_table(rig: Rig, leaks: tuple[float, ...] = FINE_BELOW) -> pd.DataFrame:
    """One row per friction, null leakage, law and leak: settling times in s by every method.

    Raises:
        HydroError: the stop is too gentle.
    """
    frequency, rows = healthy_frequency(rig), []
    for friction in friction_models(rig):
        for underlap in (False, True) if rig.parameters.valve.underlap > 0.0 else (False,):
            plant = simplified(rig.parameters, friction, underlap)
            for law in LAWS:
                rows += [_row(rig, plant, law, leak, frequency) for leak in leaks]
                need_a_swing(rows[0]["clean_s"])
    return pd.DataFrame(rows)


def need_a_swing(settling_time: float | str | bool) -> None:
    """Check that the stop of the tight axis without friction is abrupt enough for a settling time.

    Raises:
        HydroError: there is nothing to settle.
    """
    if settling_time == 0.0:
        raise HydroError(
            f"the valve closes so gently, or the move is so small, that no swing after it exceeds {SETTLED:g} m/s²: "
            f"there is nothing to settle"
        )


def _row(rig: Rig, plant: PlantParameters, law: Law, leak: float, frequency: float) -> dict[str, float | str | bool]:
    run = quick_stop(with_leak(plant, leak, law), rig)
    settling = settling_of(run, frequency, rig.stretch)
    from_signal = [settling_from_signal(run, frequency, seed, rig.stretch) for seed in NOISE_SEEDS]
    return {
        "friction": plant.friction.model,
        "valve_null_leakage": plant.valve.underlap > 0.0,
        "law": law,
        "leak_lpm": leak,
        "resistance_pa_s_m3": resistance_from_flow(leak),
        "clean_s": settling.clean_s,
        "signal_s": float(np.median(from_signal)),
        "signal_low_s": min(from_signal),
        "signal_high_s": max(from_signal),
        **settling._asdict(),
    }


def chosen(table: pd.DataFrame, law: str, model: str, underlap: bool) -> pd.DataFrame:
    """The rows of one law, friction model and valve, by leak."""
    rows = (table["law"] == law) & (table["friction"] == model) & (table["valve_null_leakage"] == underlap)
    return table[rows].set_index("leak_lpm", drop=False)


def trends(table: pd.DataFrame) -> pd.DataFrame:
    """One row per friction model, valve, law and method: whether settling falls at every step from leak to leak.

    ``ratio``: settling with the tight seal over settling at the largest leak; ``falls``: at every step.
    """
    rows = []
    for keys, part in table.groupby(["friction", "valve_null_leakage", "law"], sort=False):
        for method in METHODS:
            times = part.set_index("leak_lpm")[method]
            if times.isna().all():
                continue
            first, last = times.iloc[0], times.iloc[-1]
            row = dict(zip(("friction", "valve_null_leakage", "law"), keys, strict=True)) | {"method": method}
            row |= {"first_s": first, "moderate_s": times[MODERATE], "last_s": last}
            row |= {"ratio": first / last if last > 0.0 else math.inf, "falls": bool((times.diff().iloc[1:] < 0).all())}
            rows.append(row)
    return pd.DataFrame(rows)


def friction_scan_table(
    rig: Rig, leaks: tuple[float, ...] = SCAN, shares: tuple[float, ...] = FRICTION_SHARES
) -> pd.DataFrame:
    """Settling time (s) of the quick stop over friction and leak; laminar leak.

    Raises:
        HydroError: the rig has no dry friction, or its stop is too gentle.
    """
    if not rig.has_friction:
        raise HydroError("it has no dry friction that could hide the trend")
    frequency, rows = healthy_frequency(rig), []
    for leak in leaks:
        for share in shares:
            run = quick_stop(with_leak(with_friction_share(rig.parameters, share), leak, "laminar"), rig)
            time = settling_of(run, frequency, rig.stretch).clean_s
            rows.append({"friction_share": share, "leak_lpm": leak, "settling_s": time})
            need_a_swing(rows[0]["settling_s"])
    return pd.DataFrame(rows)
