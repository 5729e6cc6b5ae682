"""Inputs in units of their own size, what the corrected controller estimates, and both in stored weights."""

import numpy as np
import pytest
import yaml

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.learning.features import Normalisation, PolicyFeatures
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.folders import config_folder

CONFIG = TaskConfig(episode_duration=0.6)
BASE = FlowLinearising(FlowLinearisingGains(), CONFIG)


def test_a_normalisation_is_linear_near_its_centre_and_logarithmic_far_away():
    normalisation = Normalisation(np.array([1.0], np.float32), np.array([1e-3], np.float32))
    near, far = normalisation(np.array([[1.0001]], np.float32)), normalisation(np.array([[2.0]], np.float32))
    assert near[0, 0] == pytest.approx(0.1, rel=0.01)
    assert far[0, 0] == pytest.approx(np.log(2e3), rel=1e-3)


def test_units_are_those_that_the_inputs_have():
    """A constant, white noise of known size, and an input that moves now and then."""
    rng, rows = np.random.default_rng(0), 200_000
    columns = [np.full(rows, 7.0), rng.normal(3.0, 2e-4, rows), np.where(rng.random(rows) < 0.05, 1.0, 0.0)]
    centre, unit = Normalisation.of(np.stack(columns, axis=1))
    np.testing.assert_allclose(centre, [7.0, 3.0, 0.0], atol=1e-5)
    assert unit[0] == 1.0  # a constant has no size
    assert unit[1] == pytest.approx(0.8416 * 2e-4, rel=0.02)  # 60 % of a normal distribution
    assert unit[2] == pytest.approx(0.3 * np.sqrt(0.05 * 0.95), rel=0.05)


def test_normalised_inputs_are_of_order_one_under_the_corrected_controller():
    features = PolicyFeatures(CONFIG, BASE, 0.2, full_preview=True, see_estimates=True).normalised()
    env = ServoHydraulicVectorEnv(100, CONFIG)
    observation, _ = env.reset(seed=11)
    memory, rows = None, []
    for step in range(CONFIG.steps - 1):
        inputs, memory = features(observation, memory, np.full(100, step == 0))
        rows.append(inputs)
        observation, *_ = env.step(features.command(np.zeros((100, 1)), memory))
    middle = np.quantile(np.abs(np.concatenate(rows)), 0.6, axis=0)
    moving = features.normalisation.unit != 1.0
    assert np.median(middle[moving]) == pytest.approx(np.arcsinh(1.0), rel=0.1)
    assert middle.max() < 3.0
    plain = PolicyFeatures(CONFIG, BASE, 0.2, full_preview=True, see_estimates=True)
    assert np.abs(plain(observation, None, None)[0]).min() < 1e-3  # where they were


def test_estimates_tell_position_leak_and_speed():
    """On an axis with a known leak the filter's leak approaches it, and the estimated error follows the true one."""
    config = TaskConfig.from_yaml(config_folder() / "tasks" / "default.yaml", sensors={"enabled": False})
    gains = FlowLinearisingGains(**yaml.safe_load((config_folder() / "agents/flow_linearising.yaml").read_text()))
    base = FlowLinearising(gains, config)
    env = ServoHydraulicVectorEnv(40, config)
    options = {"leakage_flow_lpm": 4.0, "reference": "multi_sine"}
    observation, _ = env.reset(seed=5, options=options)
    memory = None
    for _ in range(300):
        action, memory = base.predict(observation, memory)
        observation, *_ = env.step(action)
    _, memory = base.predict(observation, memory)
    estimates = base.estimates(memory)
    assert estimates.shape == (40, len(base.estimate_names))
    error = 1e4 * (env.axes.column("reference") - env.axes.column("position"))
    np.testing.assert_allclose(estimates[:, 0], error, atol=0.4)
    assert np.median(np.abs(estimates[:, 0] - error)) < 0.1
    assert 1.5 < np.median(estimates[:, 2]) < 6.0  # l/min; it learns slowly
    speed = estimates[:, 4] * base._full_speed
    assert np.corrcoef(speed, env.axes.column("velocity"))[0, 1] > 0.95
