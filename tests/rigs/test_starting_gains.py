"""Gains of a PID from the figures of a rig, against the figures themselves and a closed loop."""

from pathlib import Path

import pytest

from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.sampled_loop import places_in_reach, sampled_loop
from hydro_agents.rigs.check import pid_from_figures, stable_start
from hydro_agents.study.other_rig import default_study
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.configuration import task_config

RIGS = ("symmetric_eha", "aalborg_svsdp_2017")


@pytest.mark.parametrize("rig", RIGS)
def test_half_of_the_largest_stable_gain_and_the_inverse_speeds(rig):
    task = task_config(None, rig=rig)
    gains = pid_from_figures(task)
    loops = [
        sampled_loop(task.plant, place, task.control_period, task.command_latency)
        for place in places_in_reach(task.plant)
    ]
    assert max(loop.spectral_radius(1.98 * gains.proportional) for loop in loops) < 1.0
    assert max(loop.spectral_radius(2.02 * gains.proportional) for loop in loops) > 1.0
    out, back = speed_limits(task.plant)
    assert gains.feedforward_extending * out == pytest.approx(1.0)
    assert gains.feedforward_retracting * back == pytest.approx(1.0)


@pytest.mark.parametrize("rig", RIGS)
def test_a_study_on_another_rig_begins_with_gains_that_are_stable_there(rig):
    study = default_study(Path("own_rig_quick"), rig=rig)
    settings = PIDGains(**study.controllers["PID"].settings)
    given, own = settings.proportional, pid_from_figures(study.task).proportional
    begins = stable_start(study.task, settings).proportional
    assert begins == (own if given > 2.0 * own else given)
    assert begins <= 2.0 * own
