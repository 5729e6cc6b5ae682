"""The training windows: many kinds of operation, labelled, the same for the same seed, whatever was done before."""

import numpy as np
import pytest

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.detection import dataset
from hydro_agents.detection.dataset import (
    LABEL_OF_FAULT,
    Chunk,
    LabelledWindows,
    draw_faults,
    rigs_of,
    simulated,
    training_jobs,
)
from hydro_agents.detection.features import CHANGE, FEATURES, LABELS
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.running.seeds import TRAINING_SEEDS
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.faults import SIGNED_KINDS
from hydro_env.task.law import RigLaw

CONFIG = TaskConfig(episode_duration=0.4)
CONTROLLER = PID(PIDGains(proportional=60.0), CONFIG)
FIRST_SEED = TRAINING_SEEDS.start + 920_000
SOUND = HeadTrainingSettings(fault_share=0.0)


@pytest.fixture(scope="module")
def windows():
    """Windows of every fourth kind of operation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset, "OPERATIONS", dataset.OPERATIONS[::4])
        return made()


def made():
    return [LabelledWindows(**job.run().metrics) for job in jobs_under(CONTROLLER).values()]


def jobs_under(controller):
    return training_jobs(CONFIG, [controller], HeadTrainingSettings(), "training", 120, FIRST_SEED)


def test_chunks_do_not_depend_on_others_nor_on_controllers_that_are_not_theirs(windows, monkeypatch):
    monkeypatch.setattr(dataset, "OPERATIONS", dataset.OPERATIONS[::4])
    own = {number for number, job in jobs_under(CONTROLLER).items() if job.participant is None}
    early = jobs_under(PID(PIDGains(proportional=30.0), CONFIG))
    number = max(own, key=int)
    job = early[number]
    assert len(own) < len(early)
    for name, values in job.run().metrics.items():
        np.testing.assert_array_equal(values, getattr(windows[int(number)], name))


def test_windows_are_labelled(windows):
    data = LabelledWindows.joined(windows)
    assert data.features.shape[1] == len(FEATURES)
    np.testing.assert_array_equal(data.labels[:, 0] == 1.0, data.size > 0.03)
    assert 0.3 < np.mean(data.size <= 0.03) < 0.7
    seconds = 10.0 ** data.features[:, FEATURES.index("duration")]
    assert seconds.min() == pytest.approx(0.4)
    assert 0.8 < seconds.max() <= 1.601


def test_every_label_but_the_leak_follows_from_a_fault():
    sizes, labels = draw_faults(CONFIG, np.random.default_rng(0), 3000, 0.6)
    faults = np.count_nonzero([*sizes.values()], axis=0)
    assert 0.55 < np.mean(faults > 0) < 0.65
    assert not labels[faults == 0].any()
    for label in range(1, len(LABELS)):
        named = [name for name, of in LABEL_OF_FAULT.items() if of == label]
        present = np.any([sizes[name] != 0.0 for name in named], axis=0)
        np.testing.assert_array_equal(labels[:, label] == 1.0, present)
    assert not labels[(sizes["position_offset"] != 0.0) & (faults == 1)].any()
    for kind in ("valve_null_shift", "valve_underlap"):
        assert (sizes[kind].min() < 0.0) == (kind in SIGNED_KINDS)
    hanging = task_config(plant={"load": {"external_force": 2000.0}})  # a weight meets no leak past the rod seal
    assert sizes["external_leak"].any()
    assert not draw_faults(hanging, np.random.default_rng(0), 400, 0.6)[0]["external_leak"].any()


@pytest.mark.parametrize("leak", ["onset", "growth"])
def test_a_changing_leak_is_labelled_with_its_size_at_the_end_of_the_window(leak):
    config = TaskConfig()
    seeds = TRAINING_SEEDS.start + 930_000 + np.arange(60)
    data = LabelledWindows(**simulated(None, SOUND, Chunk(4, "proportional", leak, 60), seeds, config))
    assert len(data.size) >= 55
    early, late = (data.features[:, FEATURES.index(f"change of leak in part {part}")] for part in (1, 8))
    large = data.size > 1.0
    assert large.sum() >= 5
    assert np.mean(late[large] > early[large] + 1.0) > 0.8
    assert np.median(data.features[large, CHANGE]) > np.median(data.features[data.size <= 0.03, CHANGE]) + 0.5
    # The leak of the last part is no larger than that at the end; a growing one is smaller.
    last = 0.1 * np.sinh(data.features[large, FEATURES.index("leak in part 8")])
    assert np.median(last / data.size[large]) < (1.15 if leak == "onset" else 0.9)


def test_with_a_law_the_chunks_take_its_rigs_in_turn_and_leaks_are_in_their_unit():
    settings = HeadTrainingSettings(law=RigLaw(count=6), fault_share=0.0)
    rigs, others = (rigs_of(TaskConfig(), settings, split) for split in ("training", "validation"))
    bores = [[task.plant.load.mass for task in each] for each in (rigs, others)]
    assert len({*bores[0], *bores[1]}) == 12
    large = max(rigs, key=leak_scale)
    seeds = TRAINING_SEEDS.start + 940_000 + np.arange(24)
    data = LabelledWindows(**simulated(None, settings, Chunk(4, "proportional", "constant", 24), seeds, large))
    np.testing.assert_array_equal(data.labels[:, 0] == 1.0, data.size > 0.03)
    leaking = data.size > 0.3
    found = 0.02 * np.sinh(data.features[leaking, FEATURES.index("small internal leak")])
    assert leak_scale(large) > 3.0
    assert 0.4 < np.median(found / data.size[leaking]) < 1.6
