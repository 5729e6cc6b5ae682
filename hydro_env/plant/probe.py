"""Error of the integrator on one rig, from a short run at full voltage with two tolerances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_env.plant.arrays import equilibrium, plant_coefficients
from hydro_env.plant.kernel import TOLERANCE
from hydro_env.plant.parameters import PlantParameters
from hydro_env.plant.simulate import simulate
from hydro_env.plant.states import EMPHASIS, STATE_NAMES
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

PERIOD = 5e-3
"""s; each voltage is held for whole periods."""

HELD = (8, 8, 4, 4, 4, 4, 2, 2, 2, 2)
"""Numbers of periods for which +10 V and −10 V act in turn: 0.2 s in all."""

EXACT_TOLERANCE = 1e-3
"""Tolerance of the reference run, relative to that of the tested run."""

ALLOWED_ERROR = 1e-4
"""Largest allowed error of any state, relative to its range."""

LEAST_RANGE = 0.01
"""Smallest range of a state, relative to its full scale."""


class Probe(NamedTuple):
    """Error of the integrator."""

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
        InvalidStateError: a state leaves the range in which the model is valid.
    """
    start, _ = equilibrium(parameters, position)
    voltage = FULL_VOLTAGE * np.repeat((-1.0) ** np.arange(len(HELD)), HELD)
    run, exact = (
        simulate(parameters, voltage, PERIOD, start, tolerance=each).states
        for each in (tolerance, EXACT_TOLERANCE * tolerance)
    )
    errors = np.abs(run - exact).max(axis=0) / state_ranges(parameters, exact)
    worst = int(np.argmax(errors))
    return Probe(float(errors[worst]), STATE_NAMES[worst])
