"""The contract of every controller's memory: a state that is given is never changed, so it may be used again."""

import copy

import numpy as np
import pytest

from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.learning.loading import SHIPPED_WEIGHTS, load_controller
from hydro_agents.learning.trainers import TRAINERS
from hydro_env import TaskConfig

CONFIG = TaskConfig()
LAYOUT = ObservationLayout.of(CONFIG)
AXES, STEPS = 3, 45
"""Longer than the longest lag of any history."""


def everything():
    """One of every kind that can be had by name, and what watches one."""
    found = {kind: load_controller(kind, CONFIG, kind) for kind in [*CONTROLLERS, *SHIPPED_WEIGHTS]}
    return found | {"leakage head": HeadDetector.load().on(CONFIG)}


EVERYTHING = everything()
OBSERVATIONS = (0.3 * np.random.default_rng(3).standard_normal((STEPS, AXES, len(LAYOUT.names)))).astype(np.float32)


def test_every_registered_kind_is_tried():
    assert set(CONTROLLERS) <= set(EVERYTHING)
    # Every trainer makes policies of one class, so that the shipped one stands for all.
    made = {trainer.load.__annotations__["return"] for trainer in TRAINERS.values()}
    assert made == {type(EVERYTHING["ppo"])}


def run(controller, state, steps, episode_start=None):
    """Answers of some steps from a state on, and the last state."""
    answers = []
    for step in steps:
        answer, state = controller.predict(OBSERVATIONS[step], state, episode_start)
        answers.append(np.array(answer))
        episode_start = None
    return np.array(answers), state


def content(state):
    """Everything that a state holds, as nested plain data."""
    if hasattr(state, "__dict__"):
        return {name: content(value) for name, value in vars(state).items()}
    if isinstance(state, tuple | list):
        return [content(value) for value in state]
    return state.tobytes() if isinstance(state, np.ndarray) else state  # NaN equals NaN


@pytest.mark.parametrize("name", EVERYTHING)
@pytest.mark.parametrize("start", [None, np.array([False, True, False]), np.ones(AXES, dtype=np.bool_)])
def test_going_on_from_a_kept_state_repeats_bit_for_bit(name, start):
    controller = EVERYTHING[name]
    _, kept = run(controller, None, range(STEPS - 10))
    before = content(copy.deepcopy(kept))
    first, _ = run(controller, kept, range(STEPS - 10, STEPS), start)
    assert content(kept) == before
    run(controller, kept, range(5), start)  # another branch in between
    second, _ = run(controller, kept, range(STEPS - 10, STEPS), start)
    np.testing.assert_array_equal(first, second)
    assert content(kept) == before


@pytest.mark.parametrize("name", EVERYTHING)
def test_the_start_of_an_episode_forgets_what_was_before(name):
    controller = EVERYTHING[name]
    _, kept = run(controller, None, range(30))
    started, _ = run(controller, kept, range(30, STEPS), np.array([True, False, True]))
    fresh, _ = run(controller, None, range(30, STEPS))
    on, _ = run(controller, kept, range(30, STEPS))
    np.testing.assert_array_equal(started[:, [0, 2]], fresh[:, [0, 2]])
    np.testing.assert_array_equal(started[:, 1], on[:, 1])
