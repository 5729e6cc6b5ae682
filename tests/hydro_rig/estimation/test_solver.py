"""The one Levenberg–Marquardt loop: against scipy's, and its elimination of start states against a dense problem."""

import numpy as np
from driven_axes import CONFIG, FEW, driven
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from hydro_rig.estimation.estimate import first_values, usable_readings
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.solver import NONE_SHARED, Effort, Linearised, Problem, fit
from hydro_rig.estimation.unknowns import STARTS, priors_of
from hydro_rig.identification.common_fit import fit_together


def problem_of(leak, seeds, unknowns=None):
    """Windows in motion and a first guess; what is not among the unknowns is known."""
    signals, physical, _ = driven(CONFIG, leak, seeds, start_moving=True)
    priors = priors_of(CONFIG, unknowns)
    model = Model(CONFIG, priors, signals[:, -1], physical=physical)
    guess = model.prior.scaled(first_values(signals, CONFIG, priors))
    return Problem(model, usable_readings(signals, CONFIG, model)), guess


def by_scipy(problem, roots, places, start):
    """Scipy's minimum of readings and priors; ``places`` (B, P): index of each unknown in the vector."""

    def residual(vector):
        missed = problem.residual(vector[places][:, None]).reshape(len(places), -1)
        return np.concatenate([-(roots * missed).ravel(), vector])

    def jacobian(vector):
        slopes = problem.linearised(vector[places]).jacobian
        rows = block_diag(*(roots[:, None] * slopes).transpose(0, 2, 1))
        whole = np.zeros((len(rows), len(vector)))
        np.add.at(whole.T, places.ravel(), rows.T)
        return np.concatenate([whole, np.eye(len(vector))])

    return least_squares(residual, start, jacobian, max_nfev=200)


def final_equations(problem, scaled, shared):
    """Normal equations and roots of the weights at the end of a fit."""
    linear = problem.linearised(scaled)
    return linear.equations(scaled, shared), linear.weight**0.5


def test_five_windows_end_in_the_minimum_that_scipy_finds():
    problem, guess = problem_of(np.linspace(0.02, 1.0, 5), range(1_300_100, 1_300_105))
    places = np.arange(guess.shape[1])[None]
    found, _ = fit(problem, guess, Effort(200, 1e-3))
    away = np.zeros((2, 5))  # largest distance in standard deviations, of scipy from the first guess and from here
    for window in range(5):
        one = problem.part(np.array([window]))
        equations, roots = final_equations(one, found[window : window + 1], NONE_SHARED)
        deviation = np.sqrt(np.diag(np.linalg.inv(equations.precision[0])))
        runs = [by_scipy(one, roots, places, start) for start in (guess[window], found[window])]
        away[:, window] = [np.abs((run.x - found[window]) / deviation).max() for run in runs]
        # Sticking friction roughens the valley: where scipy's way from the first guess ends early, it ends higher.
        assert away[0, window] < 0.1 or runs[0].cost > runs[1].cost
    assert (away[1] < 0.1).all()
    assert (away[0] < 0.1).sum() >= 4


def test_windows_with_common_parameters_end_in_the_minimum_that_scipy_finds():
    unknowns = (*FEW[:4], *(name for name in FEW if name in STARTS))
    problem, guess = problem_of([0.3] * 3, [1_300_200] * 3, unknowns)
    problem.measured[1, :, 80:], problem.measured[2, :, :80] = np.nan, np.nan
    shared = np.arange(4)
    guess[:, shared] = guess[0, shared]
    found, _ = fit(problem, guess, Effort(500, 1e-6), shared=shared)  # else how near it ends is up to the processor
    own = guess.shape[1] - 4
    places = np.array([[*shared, *(4 + own * window + np.arange(own))] for window in range(3)])
    equations, roots = final_equations(problem, found, shared)
    best = by_scipy(problem, roots, places, np.concatenate([guess[0, :4], guess[:, 4:].ravel()])).x
    apart = found.copy()  # from where the search of hydro identify comes back
    apart[:, shared] += 3.0 * np.sqrt(np.diag(np.linalg.inv(equations.precision[0])))[shared]
    identified = fit_together(problem, apart).scaled
    deviation = np.sqrt(np.einsum("bii->bi", np.linalg.inv(equations.precision)))
    assert (np.abs(best[places] - found) < 0.1 * deviation).all()
    assert (np.abs(best[places] - identified) < 0.1 * deviation).all()
    assert (found[:, shared] == found[0, shared]).all()


def test_eliminating_the_starts_leaves_the_information_of_the_whole_problem():
    """Second way: one dense least-squares problem of all windows, shared unknowns first, inverted as a whole."""
    random = np.random.default_rng(1)
    windows, own, shared, readings = 3, np.array([1, 3]), np.array([0, 2, 4]), 40
    jacobian = random.standard_normal((windows, 5, readings))
    residual = random.standard_normal((windows, readings))
    weight = random.uniform(0.2, 1.0, (windows, readings))
    reduced = Linearised(residual, jacobian, weight, None).equations(np.zeros((windows, 5)), shared)
    dense = np.zeros((3 + 2 * windows, 3 + 2 * windows))
    right = np.zeros(len(dense))
    for window in range(windows):
        places = np.zeros(5, dtype=int)
        places[shared], places[own] = np.arange(3), 3 + 2 * window + np.arange(2)
        weighted = weight[window] * jacobian[window]
        dense[np.ix_(places, places)] += weighted @ jacobian[window].T
        right[places] += weighted @ residual[window]
    dense += np.eye(len(dense))  # every prior has the standard deviation 1
    covariance = np.linalg.inv(dense)
    precision = reduced.information.sum(axis=0) + np.eye(3)
    np.testing.assert_allclose(np.linalg.inv(precision), covariance[:3, :3], rtol=1e-9)
    step = np.linalg.solve(precision, reduced.score.sum(axis=0))
    np.testing.assert_allclose(step, (covariance @ right)[:3], rtol=1e-9)
    first = [0, 3, 1, 4, 2]  # places of the first window's unknowns in the dense problem
    of_window = np.linalg.inv(reduced.precision[0])
    np.testing.assert_allclose(of_window, covariance[np.ix_(first, first)], rtol=1e-9)


def test_a_direction_that_the_readings_seem_to_fix_beyond_rounding_keeps_a_step():
    problem, guess = problem_of(np.array([0.3]), range(1_300_130, 1_300_131))
    directions = problem.model.directions(np.diag(np.full(guess.shape[1], 1e24))[None], 1.0)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1e-6)
    jacobian = problem.model.linearise(guess, directions, central=True)[1]
    exact = problem.model.linearise(guess, central=True)[1]
    np.testing.assert_allclose(jacobian, exact, atol=0.05 * np.abs(exact).max())
