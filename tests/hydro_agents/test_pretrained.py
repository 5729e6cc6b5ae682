"""The shipped weights load with their normalisation and do what their card says, on validation plants."""

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.detection.detector import measured_run
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.evaluation.evaluate import ProtocolSettings
from hydro_agents.evaluation.study import default_study
from hydro_agents.learning.loading import load_controller, shipped
from hydro_agents.running.cases import Cases, family_errors, run_cases
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks

STUDY = default_study()


@pytest.fixture(scope="module")
def policy():
    return load_controller("ppo", STUDY.task, "PPO")


def test_policy_beats_the_tuned_pid_at_every_leak(policy):
    protocol = ProtocolSettings()
    leak, families, plant = map(np.ravel, np.meshgrid(protocol.leak_levels, protocol.families, np.arange(6)))
    cases = Cases(VALIDATION_SEEDS.start + 700_000 + plant, leak, families)
    error = {}
    for name, controller in (("PID", load_controller("pid", STUDY.task, "PID")), ("PPO", policy)):
        run = run_cases(STUDY.task, controller, cases)
        assert (run.failed_at < 0).all()
        error[name] = np.abs(run.position - run.reference).mean(axis=1)
    assert error["PPO"].mean() < 0.92 * error["PID"].mean()
    for level in protocol.leak_levels:
        assert error["PPO"][leak == level].mean() < error["PID"][leak == level].mean(), level


def test_the_policy_for_any_axis_beats_what_it_corrects_on_rigs_that_it_never_saw():
    tasks = rig_tasks(task_config(law={"split": "validation", "count": 1, "first": 50, "preview_paces": []}))
    gains = FlowLinearisingGains()
    for task in (*tasks, task_config(rig="symmetric_eha", control_period=0.004)):
        both = shipped("ppo", task, lambda *_: gains), FlowLinearising(gains, task)
        errors = [family_errors(task, each, 24, sensor_frame=True) for each in both]
        ratios = [errors[0][family] / errors[1][family] for family in errors[0]]
        assert np.exp(np.mean(np.log(ratios))) < 0.99


@pytest.mark.parametrize("controller", ["PID", "PPO"])
def test_head_flags_leaks_under_either_controller(policy, controller):
    head = HeadDetector.load().on(STUDY.task)
    count = 300
    flow = np.where(np.arange(count) % 2 == 0, 0.02, np.geomspace(0.3, 4.0, count))
    seeds = np.arange(count) + VALIDATION_SEEDS.start + 800_000
    acting = policy if controller == "PPO" else load_controller("pid", STUDY.task, "PID")
    found = head.estimate_windows(measured_run(STUDY.task, acting, Cases(seeds, flow))[0])
    leaking = flow >= 0.3
    assert roc_auc_score(leaking, found.probability) > 0.99
    assert np.mean(found.probability[leaking] >= head.settings.threshold) > 0.95
    assert np.mean(found.probability[~leaking] >= head.settings.threshold) < 0.04
    assert np.median(np.abs(np.log(found.flow_lpm / flow))[leaking]) < np.log(1.4)
