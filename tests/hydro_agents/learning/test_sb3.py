"""Models of stable-baselines3 become policies; its algorithms run on the plain adaptor."""

import numpy as np
import pytest
from refusal import refused
from stable_baselines3 import A2C, PPO, SAC, TD3

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_env import ServoHydraulicVectorEnv, TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
LAYOUT = ObservationLayout.of(CONFIG)
SETTINGS = PPOSettings(total_steps=128, axes=4, steps_per_rollout=16, minibatches=2, epochs=1, hidden_sizes=(8, 4))


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_the_weights_of_a_model_act_as_the_model_does(activation):
    settings = SETTINGS.model_copy(update={"activation": activation})
    features = make_features(CONFIG, settings, PID(PIDGains(), CONFIG))
    env = make_env(CONFIG, settings, features, 0)
    model = make_model(env, settings, 0)
    policy = PolicyController.from_sb3(model, training={"by": "a test"})
    assert (policy.activation, policy.training) == (activation, {"by": "a test"})
    output, _ = model.predict(env.reset(), deterministic=True)
    command, state = policy.predict(env.env.axes.observation[:4].copy())
    np.testing.assert_allclose(policy.features.command(output, state), command, atol=1e-6)


def test_models_that_do_not_fit_are_refused():
    plain = AxisVecEnv(CONFIG, 2)
    with refused("must be PolicyFeatures"):
        PolicyController.from_sb3(PPO("MlpPolicy", plain, n_steps=8, batch_size=8, device="cpu"))
    with refused("TD3Policy: must be an MlpPolicy of tanh or relu"):
        PolicyController.from_sb3(TD3("MlpPolicy", plain, device="cpu", buffer_size=10))


def test_plain_observations_are_those_of_the_vector_environment():
    env = AxisVecEnv({"episode_duration": 0.1}, 5, seed=11, control_period=0.01)
    plain = ServoHydraulicVectorEnv(5, TaskConfig(episode_duration=0.1, control_period=0.01), autoreset_mode="SameStep")
    assert env.observation_space == plain.single_observation_space
    assert env.action_space == plain.single_action_space
    expected, _ = plain.reset(seed=11)
    np.testing.assert_array_equal(env.reset(), expected)
    generator = np.random.default_rng(0)
    for _ in range(25):
        action = generator.uniform(-1.0, 1.0, (5, 1)).astype(np.float32)
        found, reward, done, infos = env.step(action)
        expected, rewards, terminated, truncated, info = plain.step(action)
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(reward, rewards.astype(np.float32))
        np.testing.assert_array_equal(done, terminated | truncated)
        for axis in np.flatnonzero(done):
            np.testing.assert_array_equal(infos[axis]["terminal_observation"], info["final_obs"][axis])
            assert infos[axis]["TimeLimit.truncated"] == (not terminated[axis])


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [
        (PPO, {"n_steps": 16, "batch_size": 32}),
        (A2C, {}),
        (SAC, {"learning_starts": 16, "buffer_size": 200, "batch_size": 16}),
    ],
)
def test_algorithms_of_stable_baselines3_learn_on_it_and_act_as_controllers(algorithm, options):
    from hydro_agents.running.cases import Cases, run_cases

    model = algorithm("MlpPolicy", AxisVecEnv(CONFIG, 4), device="cpu", seed=0, **options)
    model.learn(128)
    run = run_cases(CONFIG, model, Cases(np.arange(3)))
    assert np.abs(run.command).max() <= 1.0
    assert np.isfinite(run.position).all()


def test_memory_of_some_axes_goes_on_alone():
    features = PolicyFeatures(CONFIG, PID(PIDGains(), CONFIG))
    rows = np.random.default_rng(0).standard_normal((50, 4, len(LAYOUT.names))).astype(np.float32)
    state = None
    for row in rows[:40]:
        _, state = features(row, state, None)
    some = np.array([3, 1])
    part = state.rows(some)
    for row in rows[40:]:
        inputs, state = features(row, state, None)
        few, part = features(row[some], part, None)
        np.testing.assert_array_equal(few, inputs[some])
    assert isinstance(features.base, PID)
