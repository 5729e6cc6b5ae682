"""Training is reproducible, survives interruption, and its weights carry everything that inference needs."""

import json

import numpy as np
import pytest

from agents.controllers import ObservationLayout, PIDGains
from agents.learning.policy import PolicyController
from agents.learning.training import PPOSettings, make_features, make_model, train_ppo
from agents.learning.vec_env import AxisVecEnv
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
GAINS = PIDGains()
SETTINGS = PPOSettings(
    total_steps=1024, axes=16, steps_per_rollout=16, minibatches=2, epochs=2, hidden_sizes=(8,), torch_threads=1
)


def weights_of(policy):
    return np.concatenate([np.concatenate([weight.ravel(), bias]) for weight, bias in policy.layers])


def test_same_seed_gives_the_same_weights_and_another_does_not():
    first, second = (train_ppo(CONFIG, SETTINGS, GAINS, seed=1) for _ in range(2))
    other = train_ppo(CONFIG, SETTINGS, GAINS, seed=2)
    np.testing.assert_array_equal(weights_of(first), weights_of(second))
    assert not np.array_equal(weights_of(first), weights_of(other))
    assert first.training["steps"] == 1024


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_policy_controller_acts_as_the_model_does(activation):
    features = make_features(CONFIG, SETTINGS, GAINS)
    env = AxisVecEnv(CONFIG, 16, features)
    model = make_model(env, SETTINGS.model_copy(update={"activation": activation}), 0)
    policy = PolicyController.from_sb3(model)
    inputs = env.reset()
    observation, _ = env.env.reset(seed=list(range(16)))
    output, _ = model.predict(inputs, deterministic=True)
    command, _ = policy.predict(observation)
    np.testing.assert_allclose(command, features.command(output, env._state), atol=1e-6)


def test_check_sees_the_policy_between_rollouts_and_may_end_the_training():
    seen = []

    def check(policy, steps, seconds):
        seen.append((steps, seconds, weights_of(policy)))
        return steps >= 512

    plain = train_ppo(CONFIG, SETTINGS.model_copy(update={"epochs": 1}), GAINS, seed=1, check=lambda *_: False)
    reference = train_ppo(CONFIG, SETTINGS.model_copy(update={"epochs": 1}), GAINS, seed=1)
    np.testing.assert_array_equal(weights_of(plain), weights_of(reference))
    policy = train_ppo(CONFIG, SETTINGS, GAINS, seed=1, check=check)
    assert [steps for steps, _, _ in seen] == [0, 256, 512]
    assert all(second >= 0.0 for _, second, _ in seen)
    assert not np.array_equal(seen[0][2], seen[1][2])
    assert policy.training["steps"] < 1024


@pytest.mark.parametrize("residual", [True, False])
def test_weights_round_trip(tmp_path, residual):
    settings = SETTINGS.model_copy(update={"residual": residual, "total_steps": 256})
    policy = train_ppo(CONFIG, settings, GAINS)
    policy.save(tmp_path / "policy")
    again = PolicyController.load(tmp_path / "policy.safetensors")
    assert again.activation == policy.activation
    rows = np.random.default_rng(0).standard_normal((20, 3, len(ObservationLayout.of(CONFIG).names)))
    mine, other = None, None
    for row in rows.astype(np.float32):
        a, mine = policy.predict(row, mine)
        b, other = again.predict(row, other)
        np.testing.assert_array_equal(a, b)
        assert np.abs(a).max() <= 1.0
    noisy, _ = again.predict(rows[0].astype(np.float32), deterministic=False)
    quiet, _ = again.predict(rows[0].astype(np.float32))
    assert not np.array_equal(noisy, quiet)


@pytest.fixture
def saved(tmp_path):
    policy = train_ppo(CONFIG, SETTINGS.model_copy(update={"total_steps": 256}), GAINS)
    policy.save(tmp_path / "policy")
    return tmp_path / "policy"


def test_foreign_and_damaged_weights_are_refused(saved):
    from agents.leakage.head import LeakageHead

    with pytest.raises(ConfigurationError, match="holds 'hydro_env policy', not the 'hydro_env leakage head'"):
        LeakageHead.load(saved)
    description = json.loads(saved.with_suffix(".json").read_text())
    good = saved.with_suffix(".safetensors").read_bytes()
    for content, message in ((b"not weights", "damaged"), (good[: len(good) // 2], "damaged")):
        saved.with_suffix(".safetensors").write_bytes(content)
        with pytest.raises(ConfigurationError, match=message) as caught:
            PolicyController.load(saved)
        assert "\n" not in str(caught.value)
    saved.with_suffix(".safetensors").write_bytes(good)
    for change, message in (
        ({"layer_sizes": [3, 8, 1]}, "must begin with"),
        ({"features": None}, "features: input should be a valid"),
        ({"layer_sizes": [*description["layer_sizes"][:1], 9, 1]}, "of shape"),
        ({"format": "another"}, "holds 'another'"),
    ):
        saved.with_suffix(".json").write_text(json.dumps(description | change))
        with pytest.raises(ConfigurationError, match=message) as caught:
            PolicyController.load(saved)
        assert "\n" not in str(caught.value)
    saved.with_suffix(".json").write_text("{")
    with pytest.raises(ConfigurationError, match="not a JSON file"):
        PolicyController.load(saved)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        PolicyController.load(saved.parent / "absent")
