"""Training is reproducible, survives interruption, and its weights carry everything that inference needs."""

import numpy as np
import pandas as pd
import pytest
from refusal import refused

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.learning.progress import PROGRESS_FILE, STEPS, read_progress
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import discount, make_env, make_features, train_policy
from hydro_agents.running.cases import validation_errors
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


def test_log_of_a_training(tmp_path):
    """Schedules are followed, rows come once per update, and stable-baselines3's figures are in them."""
    settings = SETTINGS.model_copy(update={"validation_every": 600, "learning_rate": 0.01})
    policy = train_policy(CONFIG, settings, BASE, seed=1, folder=tmp_path)
    rows = read_progress(tmp_path / PROGRESS_FILE)
    share = np.array([0.25, 0.5, 0.75, 1.0])
    assert [row[STEPS] for row in rows] == [256.0, 512.0, 768.0, 1024.0]
    assert list(pd.read_csv(tmp_path / PROGRESS_FILE)[STEPS]) == [256, 512, 768, 1024]
    rate = [row["train/learning_rate"] for row in rows]
    np.testing.assert_allclose(rate, 0.001 + 0.009 * 0.5 * (1 + np.cos(np.pi * share)))  # a cosine to a tenth
    assert settings.learning_rate_at(1.0) == 0.01
    assert settings.learning_rate_at(0.0) == settings.learning_rate_at(-0.1) == pytest.approx(0.001)
    np.testing.assert_allclose([row["train/std"] for row in rows], np.exp(-1.5 - 1.5 * (share - 0.25)), rtol=1e-6)
    for name in ("approx_kl", "clip_fraction", "explained_variance", "entropy_loss", "value_loss", "loss"):
        assert np.isfinite([row[f"train/{name}"] for row in rows]).all()
    assert rows[-1]["train/approx_kl"] > 0.0
    assert all(-5.0 < row["rollout/mean_reward"] < 0.0 for row in rows[1:])
    assert rows[-1]["rollout/ep_len_mean"] <= CONFIG.steps
    assert np.all(np.diff([row["time/time_elapsed"] for row in rows]) > 0.0)
    # On validation plants: when 600 steps are passed, and at the end.
    assert [bool(np.isfinite(row["validation/mean_error_mm"])) for row in rows] == [False, False, True, True]
    mean, worst, failures = validation_errors(CONFIG, policy)
    last = {name: rows[-1][f"validation/{name}"] for name in ("mean_error_mm", "worst_error_mm", "failures")}
    assert last == {"mean_error_mm": mean, "worst_error_mm": worst, "failures": failures}
    assert worst > mean > 0.0
    base = validation_errors(CONFIG, BASE)
    assert rows[-1]["validation/base_mean_error_mm"] == base[0] != mean
    assert rows[-1]["validation/error_to_corrected"] == mean / base[0]


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


def test_practice_changes_what_occurs_and_not_what_the_policy_sees():
    def env(**practice):
        features = make_features(CONFIG, SETTINGS, BASE)
        return make_env(CONFIG, SETTINGS.model_copy(update={"practice": practice}), features, 0)

    assert env(leakage={"healthy_share": 1.0}).env.config.leakage.healthy_share == 1.0
    heavy = {"load.mass": {"log_factor": [0.6, 3.0]}}
    ranges = env(randomisation=heavy).env.config.randomisation
    assert ranges == CONFIG.randomisation | TaskConfig(randomisation=heavy).randomisation
    for practice, message in (
        ({"control_period": 0.01}, "must leave the control period"),
        ({"references": {"preview_times": [0.01]}}, "must leave the control period and the names"),
        ({"nonsense": 1}, "practice: task: nonsense = 1: unknown key"),
    ):
        with refused(message):
            env(**practice)
