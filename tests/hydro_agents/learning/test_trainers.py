"""Trainers by name: PPO, and another algorithm in one file."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers import RescaleAction
from refusal import refused
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, TD3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import STEPS, read_progress
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.trainers import TRAINERS, trainer
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.cases import Cases, run_cases
from hydro_env import TaskConfig
from hydro_env.files import validate

CONFIG = TaskConfig(episode_duration=0.1)
BASE = PID(PIDGains(), CONFIG)


def test_another_algorithm_is_one_file(tmp_path):
    a2c = trainer("a2c_trainer:A2CTrainer")
    settings = validate(a2c.settings, {"total_steps": 8000, "axes": 16, "learning_rate": 0.001}, "study.yaml")
    options = {"seed": 0, "folder": tmp_path, "resume": False, "base": BASE, "progress": None}
    policy = a2c.train(CONFIG, settings, **options)
    policy.save(tmp_path / "a2c.v1")
    again = a2c.load(tmp_path / "a2c.v1")
    cases = Cases(np.arange(6))
    run = run_cases(CONFIG, again, cases)
    np.testing.assert_array_equal(run.command, run_cases(CONFIG, policy, cases).command)
    assert len(np.unique(run.command)) > 3
    rows = read_progress(tmp_path / "progress.csv")
    assert [row[STEPS] for row in rows] == [8000.0]  # stable-baselines3's own interval
    assert np.isfinite(rows[0]["train/value_loss"])


def test_ppo_is_a_trainer(tmp_path):
    ppo = trainer("ppo")
    assert ppo is TRAINERS["ppo"]
    settings = PPOSettings(total_steps=64, axes=4, steps_per_rollout=16, minibatches=2, epochs=1, hidden_sizes=(4,))
    options = {"seed": 0, "folder": tmp_path, "resume": False, "progress": None}
    policy = ppo.train(CONFIG, settings, base=BASE, **options)
    assert policy.features.base is BASE
    assert (tmp_path / "checkpoint.safetensors").exists()
    with refused("needs a controller that the policy corrects"):
        ppo.train(CONFIG, settings, base=None, **options)
    with refused("PolicyController: must be one of CONTROLLERS"):
        ppo.train(CONFIG, settings, base=policy, **options)


class NoSettings:
    train = load = None


class Unmade(NoSettings):
    def __init__(self, needed):
        pass


def test_what_names_no_trainer_has_none():
    assert trainer("td3") is trainer("a2c_trainer:A2CSettings") is None


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("a2c_trainer:Absent", "Absent"),
        (f"{__name__}:NoSettings", "needs settings, train and load"),
        (f"{__name__}:Unmade", "cannot be made: TypeError"),
    ],
)
def test_a_trainer_that_cannot_be_used_is_refused_with_one_line(kind, message):
    with refused(message):
        trainer(kind)


SETTINGS = PPOSettings(total_steps=128, axes=4, steps_per_rollout=16, minibatches=2, epochs=1, hidden_sizes=(8, 4))


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_the_weights_of_a_model_act_as_the_model_does(activation):
    settings = SETTINGS.model_copy(update={"activation": activation})
    env = make_env(CONFIG, settings, make_features(CONFIG, settings, BASE), 0)
    model = make_model(env, settings, 0)
    with torch.no_grad():  # not nearly zero
        model.policy.action_net.weight.mul_(30.0)
    policy = PolicyController.from_sb3(model, training={"by": "a test"})
    assert policy.activation == activation
    assert policy.training == {"by": "a test"}
    expected, _ = model.predict(env.reset(), deterministic=True)
    command, state = policy.predict(env.env.axes.observation[:4].copy())
    assert np.ptp(expected) > 1e-4
    np.testing.assert_allclose(policy.features.command(expected, state), command, atol=1e-6)


def _gymnasium(config, count):
    return make_vec_env("ServoHydraulic-v0", count, env_kwargs={"episode_duration": config.episode_duration})


@pytest.mark.parametrize("make", [AxisVecEnv, _gymnasium])
def test_a_model_on_the_observation_acts_with_the_statistics_of_vecnormalize(make, tmp_path):
    scaled = VecNormalize(make(CONFIG, 4), clip_obs=1.5)
    model = PPO("MlpPolicy", scaled, n_steps=16, batch_size=32, n_epochs=1, device="cpu").learn(64)
    with torch.no_grad():
        model.policy.action_net.weight.mul_(30.0)
    observation = scaled.reset()
    PolicyController.from_sb3(model).save(tmp_path / "mine")
    assert (np.abs(observation) == 1.5).any()
    expected, _ = model.predict(observation, deterministic=True)
    command, _ = PolicyController.load(tmp_path / "mine").predict(scaled.get_original_obs())
    assert np.ptp(expected) > 1e-2
    np.testing.assert_allclose(command, expected, atol=1e-6)


def test_models_that_do_not_fit_are_refused():
    plain = AxisVecEnv(CONFIG, 2)
    stacked = VecFrameStack(plain, 2)
    with refused("has 26 inputs: must be 13"):
        PolicyController.from_sb3(PPO("MlpPolicy", stacked, n_steps=8, batch_size=8, device="cpu"))
    small = {"n_steps": 8, "batch_size": 8, "device": "cpu"}
    squashed = PPO("MlpPolicy", plain, use_sde=True, policy_kwargs={"squash_output": True}, **small)
    slow, halved, reading = (type("Own", (kind,), {}) for kind in (gym.Wrapper, ActorCriticPolicy, FlattenExtractor))
    own = PPO("MlpPolicy", plain, policy_kwargs={"features_extractor_class": reading}, **small)
    twice = PPO("MlpPolicy", VecNormalize(VecNormalize(plain)), **small)
    deep = RecurrentPPO("MlpLstmPolicy", plain, policy_kwargs={"n_lstm_layers": 2}, **small)
    wrapped = make_vec_env("ServoHydraulic-v0", 1, wrapper_class=RescaleAction, wrapper_kwargs=SCALED)
    rescaled = PPO("MlpPolicy", wrapped, **small)
    slowed = PPO("MlpPolicy", make_vec_env("ServoHydraulic-v0", 1, wrapper_class=slow), **small)
    for model, part in (
        (squashed, "squash_output"),
        (own, "features extractor"),
        (twice, "twice"),
        (deep, "several recurrent layers"),
        (rescaled, "ActionWrapper changes the environment"),
        (slowed, "Own may change the environment"),
        (PPO(halved, plain, **small), "a policy of its own"),
        (TD3("MlpPolicy", plain, device="cpu", buffer_size=10), "TD3Policy: must be an MlpPolicy of tanh or relu"),
        ("mine", "must be an MlpPolicy"),
    ):
        with refused(part):
            PolicyController.from_sb3(model)
    with refused("PolicyController.from_sb3 does"):
        run_cases(CONFIG, PPO("MlpPolicy", VecNormalize(plain), **small), Cases(np.array([0])))


SCALED = {"min_action": -10.0, "max_action": 10.0}
