"""The test move: within its limits, better than rest, and readable."""

import numpy as np
import pytest

from hydro_agents.estimation.information import WORN_VALVE, information, sigma, unknown_sets
from hydro_agents.estimation.known_windows import at_rest, known_windows, leak_cases
from hydro_agents.estimation.move_design import NUMBERS, Limits, MoveSettings, design, limits_of, move_from
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.seeds import TRAINING_SEEDS
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig()
LIMITS = Limits(low=-0.03, high=0.05, travel=0.02, speed=0.08, acceleration=4.0, duration=2.0)


def test_every_move_keeps_to_its_limits():
    random, period, possible = np.random.default_rng(0), 1e-3, 0
    for _ in range(200):
        move = move_from(random.uniform(size=NUMBERS), LIMITS)
        if move is None:
            continue
        possible += 1
        reference = move.reference(period)
        assert move.duration == pytest.approx(LIMITS.duration)
        assert len(reference) == 2001
        assert reference.min() >= LIMITS.low - 1e-12
        assert reference.max() <= LIMITS.high + 1e-12
        assert np.ptp(reference) <= LIMITS.travel + 1e-12
        assert np.abs(np.diff(reference)).max() <= LIMITS.speed * period * 1.001
        assert np.abs(np.diff(reference, 2)).max() <= LIMITS.acceleration * period**2 * 1.01
        assert reference[-1] == pytest.approx(reference[0])
    assert possible > 100


def test_a_move_that_does_not_fit_is_none():
    numbers = np.concatenate([[0.5], [0.0, 1.0, 0.0, 1.0], np.zeros(4), np.full(5, 0.5)])  # four strokes, slowly
    assert move_from(numbers, LIMITS) is None


def test_the_designed_move_is_better_than_rest():
    pid = shipped("pid", CONFIG)
    settings = MoveSettings(duration=1.0, travel=0.01, plants=2, evaluations=13)
    best = design(CONFIG, pid, settings)
    limits = limits_of(CONFIG, settings)
    reference = best.move.reference(CONFIG.control_period)
    assert np.ptp(reference) <= 0.01 + 1e-12
    assert np.abs(np.diff(reference)).max() <= limits.speed * CONFIG.control_period * 1.001
    assert not best.bound > best.first_bound
    unknowns = unknown_sets(CONFIG)
    worn = unknowns.sets[WORN_VALVE]
    priors = {name: unknowns.priors[name] for name in worn.unknowns}
    resting = known_windows(at_rest(CONFIG), pid, leak_cases(TRAINING_SEEDS, 2, settings.leak), 0.5, 1.0)
    rest = np.exp(np.log(sigma(information(CONFIG, resting, priors))).mean())
    assert best.bound < 0.5 * rest


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"travel": 0.5}, "--travel 500 mm: must be above 0 and at most"),
        ({"speed": 3.0}, "--speed 3000 mm/s: must be at most"),
    ],
)
def test_a_rig_is_not_asked_for_more_than_it_reaches(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        limits_of(CONFIG, MoveSettings(plants=2, **settings))
