"""The work of a study grows with its settings, and what is finished counts no more."""

import pytest

from hydro_agents.study.other_rig import default_study
from hydro_agents.study.run import work_of


@pytest.fixture(scope="module")
def study():
    return default_study("quick", rig="symmetric_eha")


def test_each_part_has_its_work_and_it_follows_the_settings(study):
    work = work_of(study)
    assert list(work)[:3] == ["tune PID", "tune Flow linearisation", "train PPO"]
    assert min(work.values()) > 0.0
    entry = study.controllers["PPO"]
    longer = entry.model_copy(update={"settings": {**entry.settings, "total_steps": 600_000}})
    more = work_of(study.model_copy(update={"controllers": {**study.controllers, "PPO": longer}}))
    assert {name for name in work if more[name] != work[name]} == {"train PPO"}
    assert more["train PPO"] == 2.0 * work["train PPO"]


def test_a_resumed_study_counts_what_is_left(study):
    left = work_of(study, ["tune PID", "train PPO", "train leakage head"])
    assert {name for name in work_of(study) if name not in left} == {
        "tune PID",
        "train PPO",
        "leakage head, data",
        "leakage head, validation",
        "leakage head, training",
    }
