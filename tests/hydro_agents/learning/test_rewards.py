"""What a policy learns from: prices, units of the families, and its own correction among its inputs."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.any_axis import PREVIEW_PACES, AnyAxisFeatures
from hydro_agents.learning.features import HISTORY_SIGNALS, LASTING_TIME, PolicyFeatures
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_env import TaskConfig
from hydro_env.files import validate

CONFIG = TaskConfig(episode_duration=0.1)
BASE = PID(PIDGains(), CONFIG)


def axes(count=6, **options):
    return AxisVecEnv(CONFIG, count, PolicyFeatures(CONFIG, BASE, 0.5), seed=3, **options)


def test_the_policy_sees_what_it_did():
    features = AnyAxisFeatures(CONFIG, make_controller("flow_linearising", CONFIG), correction=0.5)
    env = AxisVecEnv(CONFIG, 6, features, seed=3)
    env.reset()
    place = len(HISTORY_SIGNALS) + len(PREVIEW_PACES) + 2  # after the reference ahead and the corrected command
    slow, blend = 0.0, CONFIG.control_period / (CONFIG.control_period + LASTING_TIME)
    for step in range(1, 15):
        inputs, _, _, _ = env.step(np.full((6, 1), 0.2))
        slow += blend * (0.1 - slow)
        np.testing.assert_allclose(inputs[:, place], 0.1, atol=1e-6, err_msg=str(step))
        np.testing.assert_allclose(inputs[:, place + 1], slow, atol=1e-6)
    for _ in range(6):
        inputs, _, done, _ = env.step(np.full((6, 1), 0.2))
    assert done.all()
    assert np.all(inputs[:, place : place + 2] == 0.0)


def test_the_price_of_a_reversal_by_hand():
    plain, priced = axes(), axes(reversal_price=0.4)
    plain.reset()
    priced.reset()
    before = None
    for output in np.random.default_rng(0).uniform(-0.4, 0.4, 15):
        start = plain.env.axes.column("command").copy()
        _, reward, _, _ = plain.step(np.full((6, 1), output))
        _, less, _, _ = priced.step(np.full((6, 1), output))
        change = plain.env.axes.column("command") - start
        if before is not None:
            swing = np.where(change * before < 0.0, np.minimum(abs(change), abs(before)), 0.0)
            np.testing.assert_allclose(reward - less, 0.4 * swing, atol=2e-5)
        before = change
    twins = axes(paired=True, reversal_price=1.0)
    twins.reset()  # a twin pays for its commands too
    assert all((twins.step(np.zeros((6, 1)))[1] == 0.0).all() for _ in range(25))


def test_units_of_the_family_in_the_frame_of_the_sensor():
    """Without the bias, which no controller sees, a smooth motion has smaller errors."""
    task = TaskConfig(episode_duration=1.0, references={"weights": {"ramp": 1, "step": 1}})
    exact = TaskConfig(**task.model_dump() | {"sensors": {"enabled": False}})
    scales = {}
    for frame, config in ((True, task), ("sensor", task), (True, exact), ("sensor", exact)):
        settings = PPOSettings(axes=2, family_units=frame, steps_per_rollout=4)
        env = make_env(config, settings, PolicyFeatures(config, make_controller("flow_linearising", config)), 0)
        scales[frame, config.sensors.enabled] = env.env.config.reward.family_scale
        env.close()
    assert scales["sensor", True]["ramp"] < 0.9 * scales[True, True]["ramp"]
    assert scales["sensor", False] == pytest.approx(scales[True, False], rel=1e-6)
    with refused("needs residual: true"):
        validate(PPOSettings, {"residual": False, "family_units": True}, "ppo.yaml")
