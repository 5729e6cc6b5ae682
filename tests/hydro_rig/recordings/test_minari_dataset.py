"""A data set of Minari holds the episodes of the environment, and the task that made them."""

import gymnasium as gym
import numpy as np
import pytest
from refusal import refused

from hydro_agents.learning.loading import shipped
from hydro_env import TaskConfig
from hydro_rig.recordings.simulated import check_dataset, record_dataset

minari = pytest.importorskip("minari", reason="the extra 'minari' brings it")
NAME = "hydraulic/pid-v0"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("minari")))
        task = TaskConfig(episode_duration=0.1)
        options = {"leakage_flow_lpm": 1.5, "reference": "step", "faults": {"valve_null_shift": 0.01}}
        steps, _ = record_dataset(NAME, task, shipped("pid", task), "pid", 3, 7, options)
        assert steps == 60
        with refused("exists; choose another name"):
            check_dataset(NAME)
        yield minari.load_dataset(NAME)


def test_its_actions_give_its_observations_and_rewards_again(dataset):
    env = dataset.recover_environment()
    for seed, episode in zip((7, 8, 9), dataset.iterate_episodes(), strict=True):
        options = {"leakage_flow_lpm": 1.5, "reference": "step", "faults": {"valve_null_shift": 0.01}}
        observation, info = env.reset(seed=seed, options=options)
        assert np.array_equal(observation, episode.observations[0])
        for step, action in enumerate(episode.actions):
            observation, reward, *_, info = env.step(action)
            assert np.array_equal(observation, episode.observations[step + 1])
            assert reward == episode.rewards[step]
            assert info["position"] == episode.infos["position"][step + 1]
        assert np.all(episode.infos["leakage_flow_lpm"] == 1.5)


def test_its_task_needs_no_file(dataset):
    assert gym.make(dataset.spec.env_spec).unwrapped.config.episode_duration == 0.1


@pytest.mark.parametrize("name", ["no version", "x"])
def test_a_name_without_a_version_is_refused(name):
    with refused("must be NAME-v0"):
        check_dataset(name)
