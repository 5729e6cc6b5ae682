"""The integrator's error against the reference solver over drawn rigs, states and inputs; its order."""

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from benchmarks.accuracy import INPUTS, LIMIT, convergence_orders, errors, random_runs, reference
from hydro_env.plant.states import STATE_NAMES


@pytest.mark.slow
def test_two_hundred_and_forty_drawn_rigs_are_within_the_limit():
    runs = random_runs(240)
    with ProcessPoolExecutor() as pool:
        exact = list(pool.map(reference, runs))
    found = errors(runs, exact)
    assert errors(runs, exact, tolerance=1e-3).max() > LIMIT  # the reference would notice
    assert dict(zip(STATE_NAMES, found.max(axis=0), strict=True)) == pytest.approx(
        dict.fromkeys(STATE_NAMES, 0.5 * LIMIT), abs=0.5 * LIMIT
    )


def test_the_order_is_five():
    assert min(convergence_orders()) > 4.7


def test_the_runs_cover_what_is_claimed():
    runs = random_runs(90)
    assert {run.signal for run in runs} == set(INPUTS)
    assert max(np.abs(run.voltage).max() for run in runs) > 9.5
    leaks = [6e11 / run.parameters.leakage.internal_resistance for run in runs]  # l/min at 100 bar
    assert min(leaks) < 0.05
    assert max(leaks) > 2.0
