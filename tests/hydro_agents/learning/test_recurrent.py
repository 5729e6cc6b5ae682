"""RecurrentPPO: its weights act as its model does, keep their memory in the state, and its training resumes."""

import numpy as np
import torch

from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
SMALL = {"axes": 4, "steps_per_rollout": 24, "minibatches": 2, "epochs": 1, "hidden_sizes": (6,), "lstm_cells": 5}


def test_the_weights_act_as_the_model_does_over_starts_of_episodes():
    settings = PPOSettings(**SMALL, residual=False)
    features = make_features(CONFIG, settings, None)
    assert features.lags == (1,)
    env = make_env(CONFIG, settings, features, 0)
    model = make_model(env, settings, 0)
    with torch.no_grad():  # not nearly zero
        model.policy.get_parameter("action_net.weight").mul_(30.0)
    policy = PolicyController.from_sb3(model)
    inputs, state, memory, started = env.reset(), None, None, np.ones(4, dtype=np.bool_)
    ends = 0
    for _ in range(50):
        output, state = model.predict(inputs, state, started, deterministic=True)
        command, memory = policy.predict(env.env.axes.observation.copy(), memory, started)
        np.testing.assert_allclose(command, np.clip(output, -1.0, 1.0), atol=1e-5)
        inputs, _, started, _ = env.step(output)
        ends += started.sum()
    assert ends >= 8
    assert np.abs(command).max() > 0.01
