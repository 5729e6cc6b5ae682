"""A data set of Minari holds the episodes of the environment, and the task that made them."""

import gymnasium as gym
import numpy as np
import pytest
from command_line import hydro

import hydro_env  # noqa: F401

minari = pytest.importorskip("minari", reason="the extra 'minari' brings it")
NAME = "hydraulic/pid-v0"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("minari")))
        arguments = ("record", "--minari", NAME, "--count", 3, "--duration", 0.1, "--seed", 7)
        done = hydro(*arguments, "--leakage", 1.5, "--family", "step", "--fault", "valve_null_shift=0.01")
        assert done.returncode == 0, done.stderr
        assert f"{NAME}: 3 episodes, 60 steps" in done.stdout
        again = hydro(*arguments)
        assert again.returncode == 2
        assert "exists; choose another name" in again.stderr
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--minari", "no version"), "must be NAME-v0"),
        (("--minari", "x"), "must be NAME-v0"),
        (("--minari", "a-v0", "--count", 0), "--count 0: must be within 1 to"),
        (("--minari", "a-v0", "--output", "a.csv"), "needs one of --output FILE, --minari NAME or --benchmark FOLDER"),
        ((), "needs one of --output FILE, --minari NAME or --benchmark FOLDER"),
    ],
)
def test_impossible_options_are_named(options, message, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    refused = hydro("record", *options)
    assert refused.returncode == 2
    assert message in refused.stderr
    assert not list(tmp_path.rglob("*.hdf5"))
