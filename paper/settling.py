"""Fig. 13: settling time after a quick stop over the leak, and the recorded signals of the rig."""

import math
from functools import cache

import numpy as np
import pandas as pd

from hydro_env import PlantParameters, Trajectory, resistance_from_flow
from hydro_env.plant.linearisation import Mode, linearise
from hydro_env.plant.states import STATE_NAMES
from hydro_env.task.sensors import Sensor
from hydro_env.types import Floats
from paper.rig import LAWS, PLANT, TIGHT, Law, quick_stop, simplified, with_leak

SETTLED = 0.1  # m/s²; the paper calls the axis settled below this (ε_a)
FRICTION_MODELS = ("none", "stribeck", "lugre")
"""``friction.model`` of each column of the figure; one more entry is one more column."""

SETTLING_LEAKS = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0)  # l/min at 100 bar
RING_DOWN = (0.02, 0.10)  # s after the stop command; the state of the linear theory is the mean over it
FIRST_SWINGS = 0.05  # s after the stop command


def recorded(true: Floats, sensor: Sensor, generator: np.random.Generator) -> Floats:
    """The signal that the acquisition stores: bias (drawn once), noise, range, 16-bit steps; as in the environment."""
    bias = sensor.bias * generator.uniform(-1.0, 1.0)
    value = np.clip(true + bias + sensor.noise * generator.standard_normal(true.shape), sensor.low, sensor.high)
    if sensor.resolution > 0.0:
        value = sensor.low + sensor.resolution * np.round((value - sensor.low) / sensor.resolution)
    return np.clip(value, sensor.low, sensor.high)


def drift(values: Floats, sample_time: float, frequency: float) -> Floats:
    """The drift: the mean over one period of the oscillation (``frequency`` in rad/s)."""
    width = max(round(2 * np.pi / frequency / sample_time), 1)
    before = width // 2
    padded = np.pad(values, (before, width - 1 - before), mode="edge")
    sums = np.cumsum(np.concatenate([[0.0], padded]))
    mean: Floats = (sums[width:] - sums[:-width]) / width
    return mean


def swing_envelope(time: Floats, values: Floats, frequency: float) -> Floats:
    """Envelope of the oscillation in ``values`` at about ``frequency`` (rad/s), without the drift.

    The logarithm of |values| is interpolated between its peaks; after the last peak the envelope is constant.
    """
    size = np.abs(values - drift(values, float(time[1] - time[0]), frequency))
    peaks = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])) + 1
    if len(peaks) == 0:
        return size
    outline: Floats = np.exp(np.interp(time, time[peaks], np.log(size[peaks] + 1e-12)))
    return outline


def last_above(time: Floats, values: Floats, level: float = SETTLED) -> float:
    """Last time at which ``values`` exceeds ``level``; 0 if it never does."""
    above = np.flatnonzero(values > level)
    return float(time[above[-1]]) if len(above) else 0.0


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
