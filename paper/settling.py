"""Fig. 13: settling time after a quick stop over the leak."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pandas as pd

from hydro_env import PlantParameters, Trajectory, resistance_from_flow
from hydro_env.plant.linearisation import Mode, linearise
from hydro_env.plant.states import STATE_NAMES
from paper.rig import LAWS, PLANT, TIGHT, Law, quick_stop, simplified, with_leak
from paper.signals import SETTLED, last_above, swing_envelope

FRICTION_MODELS = ("none", "stribeck", "lugre")
"""``friction.model`` of each column of the figure; one more entry is one more column."""

SETTLING_LEAKS = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0)  # l/min at 100 bar
RING_DOWN = (0.02, 0.10)  # s after the stop command; the state of the linear theory is the mean over it
FIRST_SWINGS = 0.05  # s after the stop command


def friction_words(model: str) -> str:
    """A friction model as a heading."""
    return {"none": "no friction", "lugre": "LuGre friction"}.get(model, f"{model.capitalize()} friction")


def oscillation_mode(run: Trajectory) -> Mode | None:
    """The mode of the axis without friction, linearised at the mean state of the first 0.1 s after the stop.

    Friction is left out: at rest the slope of its smooth sign would suppress any oscillation of the linear axis.
    """
    window = (run.time >= RING_DOWN[0]) & (run.time <= RING_DOWN[1])
    state = run.states[window].mean(axis=0)
    for name in ("velocity", "spool_position", "spool_velocity", "coil_current"):
        state[STATE_NAMES.index(name)] = 0.0
    try:
        return linearise(run.parameters.replace(friction={"model": "none"}), state, 0.0).hydraulic_mode
    except ArithmeticError:
        return None


def settling_of(run: Trajectory, reference_frequency: float) -> tuple[float, float]:
    """Settling time of one quick stop, s, noise-free, and by linear theory: NaN with friction.

    The drift is the mean over one period of ``reference_frequency`` (rad/s).
    """
    after = run.time >= 0.0
    time, acceleration = run.time[after], run.acceleration[after]
    swing = swing_envelope(time, acceleration, reference_frequency)
    first = int(np.argmax(swing[time <= FIRST_SWINGS]))
    mode = oscillation_mode(run) if run.parameters.friction.model == "none" else None
    theory = math.nan
    if mode is not None:
        decay = mode.damping_ratio * mode.natural_frequency
        theory = float(time[first]) + math.log(max(float(swing[first]) / SETTLED, 1.0)) / decay
    return last_above(time, swing), theory


@cache
def healthy_frequency() -> float:
    """Oscillation frequency in rad/s with a tight seal."""
    plant = with_leak(simplified(PLANT, "none", False), TIGHT, "laminar")
    mode = oscillation_mode(quick_stop(plant))
    assert mode is not None
    return mode.natural_frequency


def settling_table(leaks: tuple[float, ...] = SETTLING_LEAKS) -> pd.DataFrame:
    """One row per friction, null leakage, law and leak: settling times in s by every method."""
    rows = [
        _row(simplified(PLANT, friction, underlap), law, leak)
        for friction in FRICTION_MODELS
        for underlap in (False, True)
        for law in LAWS
        for leak in leaks
    ]
    return pd.DataFrame(rows)


def _row(plant: PlantParameters, law: Law, leak: float) -> dict[str, float | str | bool]:
    run, frequency = quick_stop(with_leak(plant, leak, law)), healthy_frequency()
    clean, theory = settling_of(run, frequency)
    return {
        "friction": plant.friction.model,
        "valve_null_leakage": plant.valve.underlap > 0.0,
        "law": law,
        "leak_lpm": leak,
        "resistance_pa_s_m3": resistance_from_flow(leak),
        "clean_s": clean,
        "theory_s": theory,
    }


def trends(table: pd.DataFrame) -> pd.DataFrame:
    """One row per friction model, valve and law: noise-free settling times (s) by leak.

    ``falls``: whether settling falls at every step from leak to leak.
    """
    names = ["friction", "valve_null_leakage", "law"]
    times = table.pivot(index=names, columns="leak_lpm", values="clean_s")
    times = times.reindex(table[names].drop_duplicates().itertuples(index=False, name=None))
    return times.assign(falls=(times.diff(axis=1).iloc[:, 1:] < 0).all(axis=1))
