"""The one Levenberg–Marquardt loop: against scipy's, and its elimination of start states against a dense problem."""

import numpy as np
from driven_axes import CONFIG, FEW, driven
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from hydro_rig.estimation.estimate import usable_readings
from hydro_rig.estimation.first_guess import first_values
from hydro_rig.estimation.model import SHORT_STEP, Model
from hydro_rig.estimation.solver import channel_weights, equations_of, fit, masked, prior_belief, without
from hydro_rig.estimation.unknowns import STARTS, priors_of
from hydro_rig.identification.common_fit import fit_together


def problem(leak, seeds, unknowns=None):
    """Model, readings and first guess of windows in motion; what is not among the unknowns is known."""
    signals, physical, _ = driven(CONFIG, leak, seeds, start_moving=True)
    priors = priors_of(CONFIG, unknowns)
    model = Model(CONFIG, priors, signals[:, -1], physical=physical)
    guess = model.scaled(first_values(signals, model.commands.durations, CONFIG, priors))
    return model, usable_readings(signals, CONFIG, model), guess


def by_scipy(model, measured, windows, roots, places, start):
    """Scipy's minimum of readings and priors; ``places`` (B, P): index of each unknown in the vector."""
    known = np.isfinite(measured[windows])
    data = np.where(known, measured[windows], 0.0)

    def residual(vector):
        read, _ = model.readings(vector[places], windows)
        return np.concatenate([(roots * np.where(known, read - data, 0.0).reshape(len(windows), -1)).ravel(), vector])

    def jacobian(vector):
        _, slopes = masked(model.linearise(vector[places], windows), data, known)
        rows = block_diag(*(roots[:, None] * slopes).transpose(0, 2, 1))
        whole = np.zeros((len(rows), len(vector)))
        np.add.at(whole.T, places.ravel(), rows.T)
        return np.concatenate([whole, np.eye(len(vector))])

    return least_squares(residual, start, jacobian, max_nfev=200)


def final_equations(model, measured, windows, scaled, shared):
    """Normal equations and roots of the weights at the end of a fit."""
    known = np.isfinite(measured[windows])
    linear = model.linearise(scaled, windows)
    residual, jacobian = masked(linear, np.where(known, measured[windows], 0.0), known)
    weight = channel_weights(residual, known)
    prior = without(prior_belief(model, len(windows)).precision, shared)
    return equations_of(residual, jacobian, weight, scaled, prior, shared), weight**0.5


def test_ten_windows_end_in_the_minimum_that_scipy_finds():
    model, measured, guess = problem(np.linspace(0.02, 1.0, 10), range(1_300_100, 1_300_110))
    windows, places = np.arange(10), np.arange(guess.shape[1])[None]
    found = fit(model, measured, windows, guess, prior_belief(model, 10), 161, 200, 1e-3, step=SHORT_STEP)
    away = np.zeros((2, 10))  # largest distance in standard deviations, of scipy from the first guess and from here
    for window in windows:
        one = np.array([window])
        equations, roots = final_equations(model, measured, one, found.scaled[one], np.empty(0, np.int64))
        deviation = np.sqrt(np.diag(np.linalg.inv(equations.precision[0])))
        starts = (guess[window], found.scaled[window])
        runs = [by_scipy(model, measured, one, roots, places, start) for start in starts]
        away[:, window] = [np.abs((run.x - found.scaled[window]) / deviation).max() for run in runs]
        # Sticking friction roughens the valley: where scipy's way from the first guess ends early, it ends higher.
        assert away[0, window] < 0.1 or runs[0].cost > runs[1].cost
    assert (away[1] < 0.1).all()
    assert (away[0] < 0.1).sum() >= 8


def test_windows_with_common_parameters_end_in_the_minimum_that_scipy_finds():
    unknowns = (*FEW[:4], *(name for name in FEW if name in STARTS))
    seeds = [1_300_200] * 3
    model, measured, guess = problem([0.3] * 3, seeds, unknowns)
    measured = measured.copy()
    measured[1, :, 80:], measured[2, :, :80] = np.nan, np.nan
    shared = np.arange(4)
    guess[:, shared] = guess[0, shared]
    windows, belief = np.arange(3), prior_belief(model, 3)
    found = fit(model, measured, windows, guess, belief, 161, 200, 1e-3, step=SHORT_STEP, shared=shared)
    own = guess.shape[1] - 4
    places = np.array([[*shared, *(4 + own * window + np.arange(own))] for window in range(3)])
    equations, roots = final_equations(model, measured, windows, found.scaled, shared)
    start = np.concatenate([guess[0, :4], guess[:, 4:].ravel()])
    best = by_scipy(model, measured, windows, roots, places, start).x
    apart = found.scaled.copy()  # from where the search of hydro identify comes back
    apart[:, shared] += 3.0 * np.sqrt(np.diag(np.linalg.inv(equations.precision[0])))[shared]
    identified = fit_together(model, measured, apart).scaled
    for window in windows:
        deviation = np.sqrt(np.diag(np.linalg.inv(equations.precision[window])))
        assert (np.abs(best[places[window]] - found.scaled[window]) < 0.1 * deviation).all()
        assert (np.abs(best[places[window]] - identified[window]) < 0.1 * deviation).all()
        assert (found.scaled[window, shared] == found.scaled[0, shared]).all()


def test_eliminating_the_starts_leaves_the_information_of_the_whole_problem():
    """Second way: one dense least-squares problem of all windows, shared unknowns first, inverted as a whole."""
    random = np.random.default_rng(1)
    windows, own, shared, readings = 3, np.array([1, 3]), np.array([0, 2, 4]), 40
    jacobian = random.standard_normal((windows, 5, readings))
    residual = random.standard_normal((windows, readings))
    weight = random.uniform(0.2, 1.0, (windows, readings))
    prior = without(np.tile(np.eye(5), (windows, 1, 1)), shared)
    reduced = equations_of(residual, jacobian, weight, np.zeros((windows, 5)), prior, shared)
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
    model, _, guess = problem(np.array([0.3]), range(1_300_130, 1_300_131))
    precision = np.diag(np.full(guess.shape[1], 1e24))[None]
    steps = np.linalg.norm(model.directions(precision, 1.0), axis=1)
    np.testing.assert_allclose(steps, 1e-6)
    jacobian = model.linearise(guess, directions=model.directions(precision, 1.0), central=True).jacobian
    exact = model.linearise(guess, central=True).jacobian
    np.testing.assert_allclose(jacobian, exact, atol=0.05 * np.abs(exact).max())
