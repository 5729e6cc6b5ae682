"""Policies go to stable-baselines3 and back; its algorithms run on the plain adaptor."""

import numpy as np
import pytest
from refusal import refused
from stable_baselines3 import A2C, PPO, SAC, TD3

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import train_policy
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ServoHydraulicVectorEnv, TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
LAYOUT = ObservationLayout.of(CONFIG)
SETTINGS = PPOSettings(total_steps=128, axes=4, steps_per_rollout=16, minibatches=2, epochs=1, hidden_sizes=(8, 4))


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_there_and_back_with_the_critic(tmp_path, activation):
    settings = SETTINGS.model_copy(update={"activation": activation})
    train_policy(CONFIG, settings, PID(PIDGains(), CONFIG)).save(tmp_path / "policy")
    policy = PolicyController.load(tmp_path / "policy")
    env = AxisVecEnv(CONFIG, 4, policy.features)
    model = policy.to_sb3(env, n_steps=16, batch_size=32, seed=0)
    again = PolicyController.from_sb3(model)
    np.testing.assert_equal((policy.layers, policy.critic), (again.layers, again.critic))
    assert (again.log_standard_deviation, again.activation) == (policy.log_standard_deviation, activation)

    inputs = env.reset()
    observation, _ = ServoHydraulicVectorEnv(4, CONFIG).reset(seed=0)
    output, _ = model.predict(inputs, deterministic=True)
    command, state = policy.predict(observation)
    np.testing.assert_allclose(policy.features.command(output, state), command, atol=1e-6)
    values = model.policy.predict_values(model.policy.obs_to_tensor(inputs)[0]).detach().numpy()
    hidden = inputs
    for weight, bias in policy.critic[:-1]:
        hidden = hidden @ weight.T + bias
        hidden = np.tanh(hidden) if activation == "tanh" else np.maximum(hidden, 0.0)
    np.testing.assert_allclose(values, hidden @ policy.critic[-1][0].T + policy.critic[-1][1], atol=1e-5)

    model.learn(128)
    trained = PolicyController.from_sb3(model, training={"by": "a test"})
    assert not np.array_equal(trained.layers[0][0], policy.layers[0][0])
    assert not np.array_equal(trained.critic[0][0], policy.critic[0][0])
    assert trained.training == {"by": "a test"}


def test_models_that_do_not_fit_are_refused():
    plain = AxisVecEnv(CONFIG, 2)
    with refused("must be PolicyFeatures"):
        PolicyController.from_sb3(PPO("MlpPolicy", plain, n_steps=8, batch_size=8, device="cpu"))
    with refused("TD3Policy: must be an MlpPolicy of tanh or relu"):
        PolicyController.from_sb3(TD3("MlpPolicy", plain, device="cpu", buffer_size=10))
    policy = PolicyController.load(pretrained_folder() / "policy")
    with refused(r"inputs of shape \(13,\), the policy needs \(129,\)"):
        policy.to_sb3(plain)


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


def test_a_state_that_was_given_is_never_changed_and_exploration_draws_from_it():
    """One state gives one command, and a kept state goes on bit for bit; without exploration nothing is drawn."""
    features = PolicyFeatures(CONFIG, PID(PIDGains(), CONFIG))
    weight = 1e-3 * np.random.default_rng(1).standard_normal((1, features.size)).astype(np.float32)
    policy = PolicyController(features, [(weight, np.zeros(1, dtype=np.float32))], log_standard_deviation=-2.0)
    rows = np.random.default_rng(0).standard_normal((400, 4, len(LAYOUT.names))).astype(np.float32)
    starts = np.random.default_rng(2).random((400, 4)) < 0.02
    state, seen, corrections = None, [], []
    for row, start in zip(rows, starts, strict=True):
        action, after = policy.predict(row, state, start, deterministic=False)
        seen.append((row, state, start, action, after))
        corrections.append(action - policy.predict(row, state, start)[0])
        state = after
    for row, before, start, action, after in reversed(seen):
        repeated, following = policy.predict(row, before, start, deterministic=False)
        np.testing.assert_array_equal(repeated, action)
        np.testing.assert_array_equal(following.base_command, after.base_command)
        np.testing.assert_array_equal(following.ring, after.ring)
    again = seen[200][1]
    for row, _, start, action, _ in seen[200:]:
        repeated, again = policy.predict(row, again, start, deterministic=False)
        np.testing.assert_array_equal(repeated, action)
    free = np.abs([action for *_, action, _ in seen]) < 1.0  # not at the limit of the command
    drawn = np.array(corrections)[free] / features.residual_scale
    assert len(drawn) > 500
    assert drawn.std() == pytest.approx(np.exp(-2.0), rel=0.1)
    other = seen[1][1]._replace(noise=np.random.default_rng(7))
    assert not np.array_equal(policy.predict(rows[1], other, starts[1], deterministic=False)[0], seen[1][3])
    assert policy.predict(rows[0])[1].noise is None


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
