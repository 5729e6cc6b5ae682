"""A policy that imitates a teacher on its own states misses it less and less, and PPO goes on from there."""

import numpy as np
import pandas as pd
import pytest
import torch
from refusal import refused

from hydro_agents.learning.imitation import misses
from hydro_agents.learning.loading import shipped
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import train_policy
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import TRAINING_SEEDS
from hydro_env import TaskConfig
from hydro_env.files import validate

TASK = TaskConfig(episode_duration=0.5)
SIZE = {"residual": False, "teacher": "flow_linearising", "full_preview": True, "normalise": True, "axes": 64}
STEPS = {"steps_per_rollout": 32, "minibatches": 4, "epochs": 8, "hidden_sizes": [64], "validation_every": 0}
SMALL = SIZE | STEPS | {"initial_log_standard_deviation": -3.0, "imitation_rate": 0.003}
CASES = Cases(TRAINING_SEEDS.start + 960_000 + np.arange(24))


@pytest.mark.parametrize("memory", [{}, {"lstm_cells": 16}])
def test_a_student_follows_better_the_longer_it_imitates(memory, tmp_path):
    settings = validate(PPOSettings, SMALL | memory | {"imitated_share": 0.8, "total_steps": 30 * 2048}, "test")
    student = train_policy(TASK, settings, seed=0, folder=tmp_path)
    log = pd.read_csv(tmp_path / "progress.csv")
    miss = log["train/miss_of_teacher"].dropna().to_numpy()
    assert miss[-1] < 0.7 * miss[0]
    assert log["train/approx_kl"].notna().sum() == pytest.approx(6, abs=1)  # then PPO goes on
    runs = [run_cases(TASK, each, CASES) for each in (student, shipped("flow_linearising", TASK))]
    errors = [np.abs(run.position - run.reference).mean() for run in runs]
    still = np.abs(runs[0].reference - runs[0].reference[:, :1]).mean()
    assert errors[0] < 0.5 * still  # of an axis that does not move


def test_a_start_that_comes_too_early_costs_as_much_as_one_that_comes_too_late():
    still, moving = torch.tensor([[0.0], [0.001]]), torch.tensor([[0.5], [-0.8]])
    assert misses(still, moving).tolist() == misses(moving, still).tolist()
    assert (misses(still, moving) < 10.0).all()


def test_what_a_teacher_needs_is_said():
    with refused("teacher: needs residual: false"):
        validate(PPOSettings, SMALL | {"residual": True}, "test")
    with refused("family_units: needs residual: true or a teacher"):
        validate(PPOSettings, {"residual": False, "family_units": True}, "test")
    with refused("teacher: 'nobody': unknown; known: pid, .*module:attribute"):
        train_policy(TASK, validate(PPOSettings, SMALL | {"teacher": "nobody"}, "test"))
