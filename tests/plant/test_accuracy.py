"""The integrator's error against the reference solver over drawn rigs, states and inputs; its order."""

import math

import numpy as np
import pytest

from agents.benchmark.accuracy import INPUTS, LIMIT, convergence_order, errors, random_cases, references
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.states import STATE_NAMES


def test_a_few_drawn_rigs_are_within_the_limit():
    cases = random_cases(6, seed=31)
    exact = list(references(cases, workers=1))
    assert errors(cases, exact).max() <= LIMIT
    assert errors(cases, exact, tolerance=1e-3).max() > LIMIT  # the reference would notice
    assert errors(cases, exact, tolerance=1e-9).max() < 1e-6


@pytest.mark.slow
def test_two_hundred_and_forty_drawn_rigs_are_within_the_limit():
    cases = random_cases(240)
    exact = list(references(cases, workers=2))
    found = errors(cases, exact)
    assert dict(zip(STATE_NAMES, found.max(axis=0), strict=True)) == pytest.approx(
        dict.fromkeys(STATE_NAMES, 0.5 * LIMIT), abs=0.5 * LIMIT
    )


def test_the_order_is_five():
    order = convergence_order()["order"].to_numpy()
    assert math.isnan(order[0])
    assert (order[1:] > 4.7).all()


def test_the_cases_cover_what_is_claimed():
    cases = random_cases(90)
    assert {case.signal for case in cases} == set(INPUTS)
    assert max(np.abs(case.voltage).max() for case in cases) > 9.5
    leaks = [6e11 / case.parameters.leakage.internal_resistance for case in cases]  # l/min at 100 bar
    assert min(leaks) < 0.05
    assert max(leaks) > 2.0
    slew = 0
    for case in cases[:12]:
        limits = plant_coefficients(case.parameters)
        slew += bool((np.abs(case.run()[:, STATE_NAMES.index("spool_velocity")]) >= limits.slew_limit).any())
    assert slew >= 3  # limits are met
