"""Training is reproducible, survives interruption, and its weights carry everything that inference needs."""

import numpy as np
import pytest

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.learning.progress import PROGRESS_FILE, read_progress
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import discount, train_policy
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.paces import pace

CONFIG = TaskConfig(episode_duration=0.1)
BASE = PID(PIDGains(), CONFIG)
SETTINGS = PPOSettings(total_steps=1024, axes=16, steps_per_rollout=16, minibatches=2, epochs=2, hidden_sizes=(8,))


def weights_of(policy):
    return np.concatenate([np.concatenate([weight.ravel(), bias]) for weight, bias in policy.layers])


def test_same_seed_gives_the_same_weights_whatever_is_logged_and_another_does_not(tmp_path):
    first = train_policy(CONFIG, SETTINGS.model_copy(update={"validation_every": 0}), BASE, seed=1)
    logged = SETTINGS.model_copy(update={"validation_every": 256})
    second = train_policy(CONFIG, logged, BASE, seed=1, folder=tmp_path, checkpoint_seconds=0.0)
    other = train_policy(CONFIG, SETTINGS, BASE, seed=2)
    np.testing.assert_array_equal(weights_of(first), weights_of(second))
    assert not np.array_equal(weights_of(first), weights_of(other))
    assert first.training["steps"] == 1024


def test_an_update_begins_with_the_policy_of_its_rollout(tmp_path):
    """Ratio 1 in the first minibatch of each update, here the only one, although the exploration falls by e³."""
    settings = {"epochs": 1, "minibatches": 1, "initial_log_standard_deviation": 0.0}
    train_policy(CONFIG, SETTINGS.model_copy(update=settings), BASE, folder=tmp_path)
    rows = read_progress(tmp_path / PROGRESS_FILE)
    assert rows[-1]["train/std"] == pytest.approx(np.exp(-2.25))
    divergence = [row["train/approx_kl"] for row in rows]  # mean of ratio − 1 − ln ratio, 0 where the ratio is 1
    np.testing.assert_allclose(divergence, 0.0, atol=1e-7)
    assert all(row["train/clip_fraction"] == 0.0 for row in rows)


def test_the_discount_is_that_of_a_time_relative_to_the_rig():
    settings = PPOSettings(discount=0.97)
    assert discount(TaskConfig(), settings) == 0.97
    for task in (task_config(rig="aalborg_svsdp_2017"), task_config("period_2ms"), task_config("period_10ms")):
        periods = pace(task) / task.control_period
        assert discount(task, settings) ** periods == pytest.approx(0.97**1.54)
