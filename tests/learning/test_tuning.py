"""The search for gains lowers the cost and is reproducible."""

import numpy as np
import pytest

from agents.controllers import PID, PIDGains
from agents.learning.tuning import SEARCH, gains_from_vector, mean_costs, tune_pid
from agents.running.folders import config_folder
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import validate


def test_search_improves_and_repeats():
    config = TaskConfig(episode_duration=0.3)
    seen = []
    options = {"plants": 14, "generations": 4, "population": 2}
    gains, cost = tune_pid(config, **options, progress=lambda *now: seen.append(now))
    assert [generation for generation, _, _ in seen] == [1, 2, 3, 4]
    assert seen[-1][1] < seen[0][1]
    assert (gains, cost) == (seen[-1][2], seen[-1][1])
    assert tune_pid(config, **options) == (gains, cost)


class Full:
    """Full command on the first axis, none on the others."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action = np.zeros((len(observation), 1), dtype=np.float32)
        action[0] = 1.0
        return action, None


def test_an_axis_that_fails_pays_the_worst_tracking_cost_until_the_end():
    config = TaskConfig(
        episode_duration=0.5,
        plant={"cylinder": {"stroke": 0.06}, "load": {"spring_stiffness": 0.0}},
        randomisation={},
        references={"largest_amplitude": 0.01},
        failure={"end_stop_speed": 0.01},
        initial_position_range=(0.0, 0.0),
        reward={"failure": 7.0, "error_limit": 3.0, "tracking": 2.0},
    )
    seeds = [4, 5]

    def env():
        return ServoHydraulicVectorEnv(2, config, autoreset_mode="SameStep", info=False)

    costs = mean_costs(env(), Full(), seeds, {})
    again = env()
    again.reset(seed=seeds)
    paid, failed_at = np.zeros(2), None
    for step in range(config.steps):
        _, reward, terminated, _, _ = again.step(np.array([[1.0], [0.0]]))
        paid[1] -= reward[1]
        if failed_at is None:
            paid[0] -= reward[0]
            failed_at = step if terminated[0] else None
        assert not terminated[1]
    assert failed_at is not None
    paid[0] += 3.0 * 2.0 * (config.steps - 1 - failed_at)
    np.testing.assert_allclose(costs, paid / config.steps, rtol=1e-12)


def test_search_space_maps_to_gains():
    low = np.array([np.log(low) if log else low for low, _, log in SEARCH.values()])
    gains = gains_from_vector(low)
    assert [getattr(gains, name) for name in SEARCH] == pytest.approx([low for low, _, _ in SEARCH.values()])
    many = gains_from_vector(np.column_stack([low, low + 0.1]))
    assert many.proportional == pytest.approx([2.0, 2.0 * np.exp(0.1)])


def test_cost_is_the_mean_over_plants_that_are_the_same_for_every_candidate():
    config = TaskConfig(episode_duration=0.1)
    gains, cost = tune_pid(config, plants=12, generations=1, population=1, seed=3)
    families = [name for name, weight in config.references.weights.items() if weight > 0.0]
    leak = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0, 0.01, 0.03, 0.1, 0.3, 1.0])
    options = {"leakage_flow_lpm": leak, "reference": [families[0]] * 7 + [families[1]] * 5}
    env = ServoHydraulicVectorEnv(12, config, autoreset_mode="SameStep", info=False)
    controller = PID(PIDGains(**gains.model_dump()), config)
    assert cost == pytest.approx(mean_costs(env, controller, list(range(36, 48)), options).mean(), rel=1e-9)


def test_search_space_holds_the_shipped_gains_and_only_valid_ones():
    shipped = PIDGains.from_yaml(config_folder() / "agents" / "pid.yaml")
    for name, (low, high, logarithmic) in SEARCH.items():
        assert low < getattr(shipped, name) < high
        assert (low > 0.0) == logarithmic
        for bound in (low, high):
            validate(PIDGains, {name: bound}, "search")
