"""Rigs that lack sensors: what works without them works, the rest says in one line why not."""

from pathlib import Path

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation import study as settings
from hydro_agents.evaluation.study import default_study
from hydro_agents.learning import loading
from hydro_agents.learning.loading import shipped, usual_gains
from hydro_agents.running.cases import Cases, run_cases
from hydro_env import PlantParameters, TaskConfig

PRESSURES = {"pressure_a": {"fitted": False}, "pressure_b": {"fitted": False}}
SPOOL = {"spool_position": {"fitted": False}}
POSITION_ALONE = TaskConfig(sensors=PRESSURES | SPOOL, episode_duration=0.5)
RIG = """
supply: {model: constant, pressure: 70 bar}
sensors: {pressure_a: {fitted: false}, pressure_b: {fitted: false}, spool_position: {fitted: false}}
"""
STUDY = """
controllers:
  PID: {kind: pid}
  Flow linearisation: {kind: flow_linearising}
  PPO: {kind: ppo, corrects: Flow linearisation, settings: {total_steps: 1024, axes: 16, steps_per_rollout: 16,
        minibatches: 2, epochs: 1, hidden_sizes: [8], see_estimates: true}}
evaluation: {plants: 3, standstill_plants: 1, leak_levels: [0.01], families: [step]}
"""


@pytest.fixture
def files(tmp_path):
    """A rig with a position sensor alone, and a study of one PID and one policy that corrects flow linearisation."""
    rig, study = tmp_path / "rig.yaml", tmp_path / "study.yaml"
    rig.write_text(RIG)
    study.write_text(STUDY)
    return rig, study


def mean_error(controller, config):
    """Mean absolute error in m over four cases."""
    run = run_cases(config, controller, Cases(np.arange(4)))
    return float(np.abs(run.reference - run.position).mean())


def test_a_controller_that_reads_pressures_refuses_in_one_line():
    with refused(r"reads pressure_a, pressure_b.* no such sensor") as caught:
        make_controller("flow_linearising", POSITION_ALONE)
    assert len(str(caught.value).splitlines()) == 1


def test_flow_linearisation_takes_the_command_for_the_spool():
    without, whole = TaskConfig(sensors=SPOOL, episode_duration=0.5), TaskConfig(episode_duration=0.5)
    seen = mean_error(shipped("flow_linearising", whole), whole)
    unseen = mean_error(shipped("flow_linearising", without), without)
    assert seen < unseen < 0.8 * mean_error(shipped("pid", without), without)


def test_a_study_leaves_out_what_cannot_work(files, capsys):
    rig, file = files
    assert list(default_study(file, rig=rig).controllers) == ["PID"]
    assert [line.split(":")[2] for line in capsys.readouterr().err.splitlines()] == [" Flow linearisation", " PPO"]
    file.write_text(STUDY.replace("  PID: {kind: pid}\n", ""))
    with refused("no controller works with the sensors of this rig"):
        default_study(file, rig=rig)


def test_evaluate_leaves_out_shipped_weights_that_do_not_fit(files, capsys, monkeypatch):
    rig, file = files
    monkeypatch.setattr(settings, "searched_gains", lambda *_: PIDGains())
    monkeypatch.setattr(loading, "searched_gains", lambda *_: FlowLinearisingGains())  # of what the policy corrects
    on_pid = STUDY.replace("corrects: Flow linearisation", "corrects: PID").replace(", see_estimates: true", "")
    file.write_text(on_pid)
    study = default_study(file, rig=rig).with_gains_of_rig()
    assert list(study.with_weights({}, leave_out=True)) == ["PID"]
    assert "hydro: left out: PPO: no weights of this kind are shipped" in capsys.readouterr().err
    with refused("mine: flow linearisation: reads pressure_a, pressure_b"):
        study.with_weights({"mine": "ppo"}, leave_out=True)
    other = default_study(rig="symmetric_eha").with_gains_of_rig()
    assert list(other.with_weights({}, leave_out=True)) == ["PID", "Flow linearisation", "PPO on flow linearisation"]


def test_on_another_rig_flow_linearisation_begins_with_its_gains_for_any_rig(tmp_path):
    found = default_study(rig="kovari_2015").controllers["Flow linearisation"]
    assert found.settings == FlowLinearisingGains()
    assert found.tune is not None
    usual = FlowLinearisingGains(**usual_gains("flow_linearising"))
    assert default_study().controllers["Flow linearisation"].settings == usual
    file = tmp_path / "study.yaml"
    file.write_text("controllers: {mine: {kind: flow_linearising, settings: {position_gain: 0.5}}}\n")
    assert default_study(file, rig="kovari_2015").controllers["mine"].settings.position_gain == 0.5  # the user's


def test_a_comparison_on_another_rig_takes_no_gains_of_the_papers_rig(monkeypatch):
    task = TaskConfig(plant=PlantParameters().replace(load={"mass": 3000.0}), randomisation={})
    own = PIDGains(proportional=7.0)
    monkeypatch.setattr(settings, "searched_gains", lambda *_: own)
    study = default_study(Path("opponents")).model_copy(update={"task": task})
    given = study.controllers["PID mended"].changed(settings=PIDGains(proportional=3.0))
    study = study.model_copy(update={"controllers": {**study.controllers, "PID mended": given}})
    moved = study.with_gains_of_rig()
    assert moved.make("PID").gains == own
    assert moved.make("PID mended").gains == PIDGains(proportional=3.0)  # the user's
    assert moved.make("Flow linearisation").gains == FlowLinearisingGains()
    shipped_ones = default_study(Path("opponents")).model_copy(update={"task": task}).with_gains_of_rig()
    # The mended PID would have the gains of the PID.
    assert {*study.controllers} - {*shipped_ones.controllers} == {"PID mended"}
