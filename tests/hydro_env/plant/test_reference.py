"""Pinned trajectories: the integrator reproduces them, another plant does not, and they belong to today's physics."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from hydro_env import simulate
from hydro_env.plant.states import TYPICAL_SIZE

PATH = Path(__file__).parents[2] / "reference" / "make.py"
SPEC = importlib.util.spec_from_file_location("reference_make", PATH)
make = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(make)
CASES = make.cases()
BOUND = 1e-4
"""Largest error of any state in parts of its range."""


def error(name, parameters, **options):
    """Largest deviation from the pinned trajectory, in parts of each state's range."""
    _, voltage, start = CASES[name]
    _, pinned = make.read(name)
    states = simulate(parameters, voltage, make.SAMPLE_TIME, start, **options).states
    return (np.abs(states - pinned).max(axis=0) / np.maximum(np.ptp(pinned, axis=0), 0.01 * TYPICAL_SIZE)).max()


@pytest.mark.parametrize("name", CASES)
def test_pinned_trajectories_are_reproduced(name):
    assert error(name, CASES[name][0]) < BOUND
    assert error(name, CASES[name][0], tolerance=1e-9) < 1e-6


@pytest.mark.parametrize("name", CASES)
def test_they_belong_to_the_parameters_of_today(name):
    """Else they were made before a default or a rig changed: run python tests/reference/make.py, and look why."""
    assert make.read(name)[0] == make.described(*CASES[name])


def test_the_solver_gives_them_again():
    name = "pump_ideal_valve"
    assert error(name, CASES[name][0], method="radau") < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_solver_gives_all_of_them_again(name):
    assert error(name, CASES[name][0], method="radau") < 1e-7
