"""Errors of readings: what was put in is found, whitened residuals are white, and the estimate allows for them."""

import numpy as np
import pytest

from hydro_agents.detection.detector import HALF_WIDTH, Windows
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.known_windows import known_windows
from hydro_rig.estimation.model import noise_of
from hydro_rig.estimation.result import Errors, errors_of, spikes_of, whitened
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.data_sheet import contradictions

TASK = TaskConfig()
LEAK = 0.3
DRIFT = np.eye(5)[1][:, None] * np.linspace(0.0, 1.25e5, 202)  # Pa, of the pressure in chamber a


def process(white, slow, memory, shape, random):
    """White noise plus a first-order Gauss–Markov process, the definition in a loop."""
    keep, value = np.exp(-1.0 / memory), random.standard_normal(shape[:-1])
    columns = []
    for _ in range(shape[-1]):
        columns.append(slow * value + white * random.standard_normal(shape[:-1]))
        value = keep * value + np.sqrt(1.0 - keep**2) * random.standard_normal(shape[:-1])
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize(
    ("white", "slow", "memory"), [(1.0, 0.0, 1.0), (2.5, 0.0, 1.0), (1.0, 4.0, 60.0), (0.5, 2.0, 60.0)]
)
def test_the_errors_that_were_put_in_are_found(white, slow, memory):
    residual = process(white, slow, memory, (30, 2, 800), np.random.default_rng(3))
    found, _ = errors_of(residual, np.ones(residual.shape, bool))
    assert np.median(found.white) == pytest.approx(white, rel=0.05)
    if slow == 0.0:
        assert (found.slow > 0.3 * white).mean() < 0.05
    else:
        assert np.median(found.slow) == pytest.approx(slow, rel=0.35)
        assert 0.3 < np.median(found.memory) / memory < 3.1


def test_whitening_is_the_inverse_root_of_the_covariance():
    """Against the dense covariance: the same sum of squares as Σ rᵀ C⁻¹ r, with readings missing."""
    random = np.random.default_rng(4)
    errors = Errors(np.array([[0.7]]), np.array([[1.9]]), np.array([[12.0]]))
    known = random.random((1, 1, 60)) > 0.2
    residual, other = random.standard_normal((2, 1, 1, 60))
    lags = np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    dense = 1.9**2 * np.exp(-lags / 12.0) + 0.7**2 * np.eye(60)
    seen = np.flatnonzero(known[0, 0])
    inverse = np.linalg.inv(dense[np.ix_(seen, seen)])
    first, second = whitened(residual, known, errors)[0, 0], whitened(other, known, errors)[0, 0]
    assert first @ second == pytest.approx(residual[0, 0, seen] @ inverse @ other[0, 0, seen], rel=1e-9)
    assert (first[~known[0, 0]] == 0.0).all()


def test_the_likelihood_is_that_of_the_normal_distribution():
    residual = np.random.default_rng(5).standard_normal((1, 1, 500)) * 2.0
    _, cost = errors_of(residual, np.ones(residual.shape, bool))
    assert cost[0] == pytest.approx(500 * (np.log(float((residual**2).mean())) + 1.0), rel=1e-9)


def test_spikes_are_found_and_a_step_is_none():
    random = np.random.default_rng(6)
    residual = random.standard_normal((3, 4, 400))
    residual[:, 1, 200:] += 30.0
    spikes = random.random(residual.shape) < 0.02
    residual[spikes] += 25.0
    found = spikes_of(residual, np.ones(residual.shape, bool))
    assert (found & spikes).sum() >= 0.95 * spikes.sum()
    assert (found & ~spikes).sum() <= 3


@pytest.fixture(scope="module")
def clean():
    """Signals (1, 5, 202) of a moving axis."""
    cases = Cases(np.array([VALIDATION_SEEDS[0] + 5100]), np.array([LEAK]), np.array(["multi_sine"]))
    return known_windows(TASK, shipped("pid", TASK), cases, begin=0.5, length=1.005).signals


def noisier(signals, factor):
    """Readings with ``factor`` times the noise of the data sheet."""
    random = np.random.default_rng(7).standard_normal(signals[:, :4].shape)
    more = np.sqrt(factor**2 - 1.0) * noise_of(TASK)[:, None] * random
    return np.concatenate([signals[:, :4] + more, signals[:, 4:]], axis=1)


def spiky(signals):
    random, changed = np.random.default_rng(9), signals.copy()
    struck = random.random(signals[:, :4].shape) < 0.02
    changed[:, :4] += struck * 20.0 * noise_of(TASK)[:, None] * random.standard_normal(struck.shape)
    return changed


def shifted(signals, rows):
    """Commands that stand some rows late."""
    return np.concatenate([signals[:, :4, 1:-1], signals[:, 4:, 1 - rows : signals.shape[2] - 1 - rows]], axis=1)


CHANGES = {
    "noise times 3": (lambda signals: noisier(signals, 3.0), "scatters"),
    "spikes": (spiky, "has spikes"),
    "drift of a pressure": (lambda signals: signals + DRIFT[:, : signals.shape[2]], "differs slowly"),
    "row late": (lambda signals: shifted(noisier(signals, 2.0), 1), "acts −"),
    "row early": (lambda signals: shifted(signals, -1), "acts 6.0 ms after its row"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_recording_that_contradicts_the_data_sheet_is_read(clean, name):
    change, words = CHANGES[name]
    reading, found = EstimatorDetector(threads=1).read_and_fit(Windows.of(change(clean)), TASK)
    assert reading.answers.all() or name.startswith("drift")  # what it may hide is left open
    assert (np.abs(found.value(LEAKAGE) - LEAK) < 4.0 * found.deviation(LEAKAGE)).all()
    assert (reading.high_lpm - reading.low_lpm < 0.2).all()
    assert any(words in finding.what for finding in contradictions(found, TASK))


def test_nothing_is_said_of_a_recording_that_agrees_with_the_data_sheet(clean):
    _, found = EstimatorDetector(threads=1).read_and_fit(Windows.of(clean), TASK)
    assert contradictions(found, TASK) == []


def test_a_slow_error_of_several_signals_may_move_the_leak_as_far_as_its_norm(clean):
    """By the data sheet, errors of norm n move the leak by at most n standard deviations (Cauchy and Schwarz)."""
    steps = np.arange(clean.shape[2])
    wrong = np.zeros(clean.shape)
    wrong[:, :3] = np.stack([1e-4 * np.sin(steps / 30.0), 1.5e5 * np.sin(steps / 25.0), 9e4 * np.cos(steps / 40.0)])
    known, found = (
        EstimatorDetector(threads=1).read_and_fit(Windows.of(signals), TASK)[1] for signals in (clean, clean + wrong)
    )
    norm = np.sqrt(len(steps) * (found.slow**2).sum(axis=1))
    assert (found.slow[0] > 1.0).sum() == 2
    assert (found.deviation(LEAKAGE) > 0.9 * norm * known.deviation(LEAKAGE) / HALF_WIDTH).all()
