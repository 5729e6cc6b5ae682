"""What gain a rig bears with its friction, and that no controller takes the gains of another rig."""

import pytest

from hydro_agents.controllers.pid import PID, PIDGains
from hydro_agents.learning import loading, stable_gain
from hydro_agents.learning.loading import load_controller, shipped, usual_gains
from hydro_agents.learning.rig_gains import gain_sets
from hydro_agents.learning.stable_gain import (
    loops_within_ranges,
    pid_from_figures,
    pid_with_gain,
    pids_from_figures,
    quiet_gains,
    weakest,
)
from hydro_agents.rigs.rig_file import answers_from, new_rig
from hydro_agents.running.limit_cycles import comes_to_rest, counted_at_rest
from hydro_agents.running.seeds import ANY_AXIS
from hydro_env import ConfigurationError
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.configuration import task_config

NAMEPLATES = {
    "bore": "40 mm",
    "rod": "22 mm",
    "stroke": "500 mm",
    "rated_flow": "40 l/min",
    "bandwidth": "60 Hz",
    "supply_pressure": "160 bar",
    "mass": "500 kg",
}


@pytest.fixture(autouse=True, scope="module")
def few_plants():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stable_gain, "DRAWN", 12)
        yield


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    """The task on a soft rig of 20 Hz with a differential cylinder."""
    file = tmp_path_factory.mktemp("rig") / "soft.yaml"
    file.write_text(new_rig(answers_from(NAMEPLATES), "soft.yaml")[0], encoding="utf-8")
    return task_config(rig=file)


def rests(controller, task, count):
    """Whether an axis under a controller comes to rest on plants that no search of gains used, with a tight seal."""
    return comes_to_rest(counted_at_rest(controller, task, ANY_AXIS, count, 0.01))


def test_the_recommended_gain_uses_the_friction_of_the_rig_and_keeps_a_margin(task):
    quiet, without_friction = quiet_gains(task), weakest(loops_within_ranges(task))
    recommended = 0.5 * quiet.worst
    velocity_gain = recommended * 0.5 * sum(speed_limits(task.plant))
    assert 3.0 < velocity_gain < 8.0  # 1/s; without friction 0.3
    assert recommended > 1.5 * 0.5 * without_friction.gain
    exact = task_config(task, randomisation={})
    assert rests(PID(pid_with_gain(task, recommended), task), task, 6)
    assert rests(PID(pid_with_gain(exact, 1.9 * recommended), exact), exact, 1)
    assert not rests(PID(pid_with_gain(exact, 1.3 * quiet.own), exact), exact, 1)


def test_a_pid_on_a_rig_that_nobody_tuned_takes_its_gains_from_the_rig(task, monkeypatch):
    paper = PIDGains(**usual_gains("pid"))
    assert not rests(PID(paper, task), task, 6)
    own = shipped("pid", task)
    assert own.gains in gain_sets("pid", task)
    assert rests(own, task, 6)
    found = pid_from_figures(task)
    monkeypatch.setattr(loading, "searched_gains", lambda kind, _: found)
    assert load_controller("pid", task, "mine").gains == found  # a command searches


def test_a_rig_that_no_gain_keeps_quiet_has_no_pid(monkeypatch, task):
    monkeypatch.setattr("hydro_agents.learning.stable_gain.comes_to_rest", lambda _: False)
    monkeypatch.setattr("hydro_agents.learning.stable_gain.pid_from_figures", lambda _: None)
    with pytest.raises(ConfigurationError, match=r"^pid: no gains for this rig: no proportional gain"):
        pids_from_figures(task)
