"""A study says who takes part; what does not fit is refused before any work."""

import pytest
from refusal import refused

from hydro_agents.controllers.pid import PID
from hydro_agents.evaluation.evaluate import ProtocolSettings
from hydro_agents.evaluation.study import StudySettings, default_study
from hydro_agents.learning.policy import PolicyController
from hydro_agents.running.seeds import TEST_SEEDS, VALIDATION_SEEDS
from hydro_env import TaskConfig
from hydro_env.folders import config_folder
from hydro_env.task.configuration import task_config

POLICY = "PPO on flow linearisation"
PLAIN = "controllers:\n  PID: {kind: pid}\n"
PID_AS, BESIDE = "controllers: {{PID: {{{}}}}}\n", "controllers:\n  PID: {{kind: pid}}\n  other: {{{}}}\n"


def study(tmp_path, text):
    file = tmp_path / "study.yaml"
    file.write_text(text)
    return StudySettings.from_yaml(file)


@pytest.mark.parametrize("name", ["default", "quick"])
def test_the_studies_that_ship_are_right(name):
    found = StudySettings.from_yaml(config_folder() / "studies" / f"{name}.yaml")
    assert list(found.controllers) == ["PID", "Flow linearisation", POLICY]
    assert found.trained == [POLICY]
    assert found.corrects == {POLICY: "Flow linearisation"}
    assert found.make("PID").gains.proportional == pytest.approx(397.3, abs=0.01)
    assert StudySettings(**found.model_dump(mode="json")) == found  # what is written can be read again


def test_a_controller_is_one_line_and_so_is_an_algorithm(tmp_path):
    learned = '{kind: "gain_trainer:Trainer", settings: {gain: 5}, corrects: other}'
    found = study(tmp_path, BESIDE.format('kind: "gain_trainer:Still"') + f"  learned: {learned}\n")
    assert found.trained == ["learned"]
    assert type(found.make("other")).__name__ == "Still"
    assert found.controllers["learned"].settings.gain == 5.0


def test_settings_may_be_files_relative_to_the_study(tmp_path):
    (tmp_path / "gains.yaml").write_text("proportional: 12.5\n")
    (tmp_path / "short.yaml").write_text("episode_duration: 0.5\n")
    found = study(tmp_path, "task: short.yaml\ncontrollers:\n  PID: {kind: pid, settings: gains.yaml}\n")
    assert found.make("PID").gains.proportional == 12.5
    assert found.task.steps == 100


WRONG = (
    ("controllers: {}\n", r"study.yaml: controllers: "),
    (PID_AS.format("kind: pdi"), r"controllers.PID.kind = 'pdi': unknown; did you mean pid\? known: .*ppo"),
    (PID_AS.format("kind: pid, settings: wrong.yaml"), r"controllers.PID.settings.proportional = -3"),
    ("controllers: {PPO: {kind: ppo, corrects: PID}}\n", r"corrects = 'PID'.*\(none\)"),
    (BESIDE.format("kind: ppo, corrects: other"), r"corrects = 'other': must be a controller before it \(PID\)"),
    (BESIDE.format("kind: ppo, corrects: PID, settings: {practice: {nonsense: 1}}"), r"nonsense"),
    (BESIDE.format("kind: ppo"), r"controllers.other: is trained as a correction .residual: true.: give 'corrects"),
    (BESIDE.format("kind: ppo, corrects: PID, tune: {}"), r"controllers.other: tune: a trained one cannot be tuned"),
    (BESIDE.format("kind: pid, corrects: PID"), r"controllers.other: corrects: only a trained one"),
    (BESIDE.format('kind: "gain_trainer:Settings"'), r"other: Settings: takes keywords alone, not TaskConfig"),
    (BESIDE.format('kind: "gain_trainer:Trainer", settings: {stops: 1}'), r"controllers.other.settings.stops"),
)


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_what_does_not_fit_is_told_in_one_line(tmp_path, text, message):
    (tmp_path / "wrong.yaml").write_text("proportional: -3\n")
    with refused(message) as raised:
        study(tmp_path, text)
    assert "\n" not in str(raised.value)


def test_controllers_ready_to_act_without_training(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = default_study()
    controllers = found.with_weights({"mine": "gain_trainer:Still"})
    assert list(controllers) == ["PID", "Flow linearisation", POLICY, "mine"]
    assert isinstance(controllers["PID"], PID)
    assert isinstance(controllers[POLICY], PolicyController)
    assert isinstance(found.with_weights({POLICY: "pid"})[POLICY], PID)
    own = study(tmp_path, PLAIN + '  learned: {kind: "gain_trainer:Trainer"}\n')
    (tmp_path / "weights.json").write_text("2.0")
    assert own.with_weights({"learned": "./weights"})["learned"].gain == 2.0
    with refused("learned: no weights of this kind are shipped; give --agent learned"):
        own.with_weights({})


def test_another_rig_changes_the_task_and_asks_for_tuning(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(
        "task: {plant: rig.yaml, control_period: 0.004}\ncontrollers:\n  PID: {kind: pid, tune: {evaluations: 9}}\n"
        '  other: {kind: pid}\n  mine: {kind: "gain_trainer:Still"}\n'
    )
    (tmp_path / "rig.yaml").write_text("supply: {model: constant}\n")
    found = StudySettings.from_yaml(file)
    assert found.task == task_config(rig=tmp_path / "rig.yaml", control_period=0.004)
    assert found.tuned == ["PID"]
    moved = default_study(file, rig="symmetric_eha")
    assert moved.task == task_config(rig="symmetric_eha", control_period=0.004)
    assert moved.tuned == ["PID", "other"]
    assert moved.controllers["PID"].tune.evaluations == 9
    assert moved.make("PID").config == moved.task
    assert StudySettings(**moved.model_dump(mode="json")) == moved
    assert default_study(file, task="no_preview").task == task_config("no_preview")
    assert default_study(file, task="no_preview").tuned == ["PID"]


@pytest.mark.parametrize(("seeds", "expected"), [("CHOICES", VALIDATION_SEEDS), ("EVALUATION", TEST_SEEDS)])
def test_choices_are_made_on_validation_plants(seeds, expected):
    cases = ProtocolSettings(seeds=seeds, plants=3).protocol(TaskConfig()).cases_in("task")
    assert all(int(seed) in expected for seed in cases["seed"])
