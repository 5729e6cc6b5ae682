"""A training that was interrupted and resumed ends bit for bit as one that was not."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.learning.checkpoint import CHECKPOINT_FILE
from hydro_agents.learning.progress import PROGRESS_FILE, read_progress
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import train_policy
from hydro_agents.running.weights import load_checkpoint
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.1)
BASE = PID(PIDGains(), CONFIG)
SETTINGS = PPOSettings(
    total_steps=1280, axes=16, steps_per_rollout=16, minibatches=2, epochs=2, hidden_sizes=(8,), validation_every=500
)
ROLLOUT = 256
KIND = "training checkpoint"


def train(folder, **options):
    return train_policy(CONFIG, options.pop("settings", SETTINGS), BASE, seed=1, folder=folder, **options)


def result(policy, folder):
    """Weights and curve, times left out."""
    layers = [array for layer in policy.layers for array in layer]
    rows = [[value for name, value in row.items() if name != "time/time_elapsed"] for row in read_progress(folder)]
    return np.concatenate([array.ravel() for array in layers]), np.array(rows)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return result(train(folder), folder / PROGRESS_FILE)


def interrupt_at(steps):
    def report(progress):
        if progress.steps >= steps:
            raise KeyboardInterrupt

    return report


ALL = {"full_preview": True, "family_units": True, "reversal_price": 1.0}


@pytest.mark.parametrize("changes", [{"residual": False}, ALL], ids=["alone", "all"])
def test_interrupted_training_ends_as_an_uninterrupted_one(tmp_path, changes):
    settings = SETTINGS.model_copy(update=changes)
    expected = result(train(tmp_path / "whole", settings=settings), tmp_path / "whole" / PROGRESS_FILE)
    folder, seen = tmp_path / "parts", []
    for steps in (256, 512, 1024):  # the interrupt comes when a rollout is over and its update is not
        with pytest.raises(KeyboardInterrupt):
            train(folder, settings=settings, resume=steps > 256, progress=interrupt_at(steps))
        _, stored = load_checkpoint(folder / CHECKPOINT_FILE, KIND)
        assert stored["steps"] == steps - ROLLOUT
    policy = train(folder, settings=settings, resume=True, progress=lambda progress: seen.append(progress))
    assert [progress.steps for progress in seen] == [1024, 1280]
    assert policy.training["steps"] == 1280
    np.testing.assert_equal(result(policy, folder / PROGRESS_FILE), expected)


def test_resume_needs_a_checkpoint_of_the_same_settings(tmp_path):
    with refused(r"checkpoint.safetensors: cannot be read: No such file"):
        train(tmp_path, resume=True)
    with refused("a folder with a checkpoint is needed"):
        train(None, resume=True)
    (tmp_path / "log" / PROGRESS_FILE).mkdir(parents=True)
    with refused("progress.csv: cannot be written"):
        train(tmp_path / "log", progress=lambda _: pytest.fail("it was trained"))
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, progress=interrupt_at(256))
    other = SETTINGS.model_copy(update={"discount": 0.5})
    for message, config, settings, base, seed in (
        ("other settings; cannot resume", CONFIG, other, BASE, 1),
        ("other task; cannot resume", TaskConfig(episode_duration=0.2), SETTINGS, BASE, 1),
        ("other features; cannot resume", CONFIG, SETTINGS, PID(PIDGains(proportional=3.0), CONFIG), 1),
    ):
        with refused(message):
            train_policy(config, settings, base, seed, tmp_path, resume=True)
    # A training that begins anew drops the checkpoint before anything else.
    assert (tmp_path / CHECKPOINT_FILE).exists()
    with refused("practice"):
        train(tmp_path, settings=SETTINGS.model_copy(update={"practice": {"control_period": 0.01}}))
    assert not (tmp_path / CHECKPOINT_FILE).exists()
