"""Inner steps and error of the integrator on one rig, from a short run at full voltage with two tolerances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_env.errors import InvalidStateError
from hydro_env.plant.arrays import coefficient_array, equilibrium, plant_coefficients
from hydro_env.plant.kernel import N_PEAKS, STEPS, TOLERANCE, Accuracy, Plants, integrate
from hydro_env.plant.parameters import PlantParameters
from hydro_env.plant.states import EMPHASIS, STATE_NAMES
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

PERIOD = 5e-3
"""s; each voltage is held for whole periods, and steps are counted per period."""

HELD = (8, 8, 4, 4, 4, 4, 2, 2, 2, 2)
"""Numbers of periods for which +10 V and −10 V act in turn: 0.2 s in all."""

EXACT_TOLERANCE = 1e-3
"""Tolerance of the reference run, relative to that of the tested run."""

ALLOWED_ERROR = 1e-4
"""Largest allowed error of any state, relative to its range."""

LEAST_RANGE = 0.01
"""Smallest range of a state, relative to its full scale."""


class Probe(NamedTuple):
    """Work and error of the integrator."""

    mean_steps: float  # per PERIOD, repeated ones included
    most_steps: int
    error: float  # largest of any state, relative to its range
    state: str  # the state with that error


def state_ranges(parameters: PlantParameters, states: Floats) -> Floats:
    """Range of each state along a run, states (samples, N_STATES), at least 1 % of its full scale."""
    c = plant_coefficients(parameters)
    full_scale = EMPHASIS / np.array([getattr(c, f"{name}_weight") for name in STATE_NAMES])
    ranges: Floats = np.maximum(np.ptp(states, axis=0), LEAST_RANGE * full_scale)
    return ranges


def probe(parameters: PlantParameters, position: float = 0.0, tolerance: float = TOLERANCE) -> Probe:
    """Apply ±10 V in turn for 0.2 s from rest at a position (m), with ``tolerance`` and a thousandth of it.

    Raises:
        HydroError: the position cannot be held.
        InvalidStateError: a state becomes NaN.
    """
    steps, states = _run(parameters, position, tolerance)
    _, exact = _run(parameters, position, EXACT_TOLERANCE * tolerance)
    if not (np.isfinite(states).all() and np.isfinite(exact).all()):
        raise InvalidStateError("a state becomes NaN under full voltage")
    errors = np.abs(states - exact).max(axis=0) / state_ranges(parameters, exact)
    worst = int(np.argmax(errors))
    return Probe(float(steps.mean()), int(steps.max()), float(errors[worst]), STATE_NAMES[worst])


def _run(parameters: PlantParameters, position: float, tolerance: float) -> tuple[Floats, Floats]:
    """Steps in each period, (periods,), and states at their ends, (periods, N_STATES)."""
    start, _ = equilibrium(parameters, position)
    plants = Plants(
        state=np.array([[start[name] for name in STATE_NAMES]]),
        coefficients=coefficient_array(parameters)[None],
        voltage=np.empty((1, 1)),
        durations=np.full((1, 1), PERIOD),
        peaks=np.empty((1, N_PEAKS)),
    )
    steps, states = [], []
    for number, periods in enumerate(HELD):
        plants.voltage[:] = FULL_VOLTAGE if number % 2 == 0 else -FULL_VOLTAGE
        for _ in range(periods):
            integrate(plants, Accuracy(tolerance=tolerance), 0, 1)
            steps.append(plants.peaks[0, STEPS])
            states.append(plants.state[0].copy())
    return np.array(steps), np.array(states)
