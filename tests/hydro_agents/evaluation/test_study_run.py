"""A whole study with an algorithm of one's own: what it leaves, how it resumes, and what stops it early."""

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from gain_trainer import Trainer
from published import assert_published
from refusal import refused

from hydro_agents.commands import pages
from hydro_agents.commands.evaluate import evaluate
from hydro_agents.commands.study import train, whole_study
from hydro_agents.evaluation import study_run as training
from hydro_agents.evaluation.study import StudySettings, default_study
from hydro_agents.learning import tuning

CONTROLLERS = {
    "PID": {"kind": "pid"},
    "mine": {"kind": "gain_trainer:Trainer", "settings": {"gain": 2.0}, "corrects": "PID"},
}
VALUES = {
    "task": {"episode_duration": 0.4},
    "controllers": CONTROLLERS,
    "evaluation": {**{"plants": 3, "standstill_plants": 1}, **{"leak_levels": [0.01, 4.0], "families": ["step"]}},
}


@pytest.fixture
def algorithm(monkeypatch):
    monkeypatch.setattr(Trainer, "calls", [])
    monkeypatch.setattr(Trainer, "fate", "finish")
    return Trainer


@pytest.fixture
def settings(algorithm, monkeypatch):
    """The study; its report has one line: drawing takes longer than everything else here."""
    page = lambda title, *_, **__: SimpleNamespace(write=lambda path, _: path.write_text(title))  # noqa: E731
    monkeypatch.setattr(pages, "controllers_page", page)
    return StudySettings(**VALUES)


def study_file(tmp_path, **changes):
    """The study as a file, with other values and with other entries of the PID."""
    pid = {"PID": {"kind": "pid", **changes.pop("pid", {})}}
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump({**VALUES, "controllers": CONTROLLERS | pid, **changes}))
    return file


def run_study(study, folder, seed, **options):
    return whole_study(study, folder, range(seed, seed + 1), **options)


def stopped(*arguments, **options):
    with pytest.raises(KeyboardInterrupt):
        run_study(*arguments, **options)


def test_a_study_trains_compares_and_reports_and_can_be_resumed(algorithm, settings, tmp_path, capsys):
    folder = tmp_path / "out"
    result = run_study(settings, folder, seed=5)
    printed = capsys.readouterr().out.splitlines()
    shown = {line.split(":")[0] for line in printed if re.search(r":  ?( ?\d+ %|begun|done)", line)}
    assert shown == {"train mine", "jobs", "page"}
    assert printed[-1] == f"page: {folder / 'report.html'}"
    assert [(call["seed"], call["resume"]) for call in algorithm.calls] == [(5, False)]
    assert type(algorithm.calls[0]["base"]).__name__ == "PID"
    assert result.controllers == ["PID", "mine"]
    for name in ("study.yaml", "report.html", "controllers/mine/policy.json"):
        assert (folder / name).is_file()
    assert_published("study", folder / "tables")
    assert StudySettings.from_yaml(folder / "study.yaml").seed == 5

    other = {**CONTROLLERS, "mine": {**CONTROLLERS["mine"], "settings": {"gain": 4.0}}}
    changed = StudySettings(**{**VALUES, "controllers": other})
    for study, seed, key in ((settings, 6, "seed"), (changed, 5, "controllers")):
        with refused(rf"other settings \('{key}' differs\)"):
            run_study(study, folder, seed, resume=True)
    again = run_study(settings.model_copy(update={"title": "Another"}), folder, seed=5, resume=True)
    assert len(algorithm.calls) == 1
    pd.testing.assert_frame_equal(again.table("cases"), result.table("cases"))
    assert "Another" in (folder / "report.html").read_text()

    anew = run_study(settings, folder, seed=5, overwrite=True)
    assert len(algorithm.calls) == 2
    pd.testing.assert_frame_equal(anew.table("comparison"), result.table("comparison"))


def test_training_seeds_share_the_rows_of_their_controller_and_correct_the_same_seed(algorithm, settings, tmp_path):
    after = {"kind": "gain_trainer:Trainer", "settings": {"gain": 1.0}, "corrects": "mine"}
    values = {**VALUES, "controllers": {**CONTROLLERS, "after": after}}
    result = whole_study(StudySettings(**values), tmp_path / "out", range(3, 5))
    assert [call["seed"] for call in algorithm.calls] == [3, 4, 3, 4]
    assert len({id(call["base"]) for call in algorithm.calls}) == 3  # the PID, and both seeds of the first one
    assert result.controllers == ["PID", "mine", "after"]
    assert result.table("seeds").groupby("controller")["training_seed"].agg(list).to_dict() == {
        "after": [3, 4],
        "mine": [3, 4],
    }
    assert (tmp_path / "out" / "controllers" / "mine#4" / "policy.json").is_file()
    assert result.table("comparison").query("against == 'mine'")["controller"].tolist() == ["after"]


def test_a_stopped_training_goes_on_from_its_checkpoint_and_never_from_an_older_one(algorithm, settings, tmp_path):
    folder = tmp_path / "out"
    algorithm.fate = "late"
    stopped(settings, folder, seed=1)
    assert not (folder / "report.html").exists()
    algorithm.fate = "finish"
    run_study(settings, folder, seed=1, resume=True)
    algorithm.fate = "early"
    stopped(settings, folder, seed=1, overwrite=True)
    assert not any(folder.rglob("checkpoint*"))
    assert not any(folder.rglob("policy*"))
    algorithm.fate = "finish"
    run_study(settings, folder, seed=1, resume=True)
    assert [call["resume"] for call in algorithm.calls] == [False, True, False, False]


def test_a_controller_that_fails_stops_the_study_before_it_trains(algorithm, tmp_path):
    controllers = {**CONTROLLERS, "broken": {"kind": "gain_trainer:Broken"}}
    with refused(r"controllers\.broken: seed 1999998, at 0.000 s: predict returned nan"):
        run_study(StudySettings(**{**VALUES, "controllers": controllers}), tmp_path / "out", seed=0)
    assert algorithm.calls == []
    assert not list(tmp_path.glob("out/controllers/*"))


def test_evaluate_joins_training_seeds_and_keeps_the_results_of_the_others(settings, tmp_path, capsys):
    file, out = study_file(tmp_path), tmp_path / "out"
    agents = ["mine#0=pid", "mine#1=flow_linearising", "broken=gain_trainer:Broken"]
    with refused(r"broken under task: .*out holds the other results"):
        evaluate(out, file, agents)
    status = pd.read_csv(out / "tables" / "status.csv").set_index("controller").loc["broken"]
    assert status["message"].startswith("seed 2000000, reference step, leak 0.01 l/min, at 0.000 s: predict returned")
    assert pd.read_csv(out / "tables" / "limit_cycle_summary.csv")["standstills"].tolist() == [2, 4]
    cases = pd.read_csv(out / "tables" / "cases.csv")  # the seeds replace the study's controller, which has no weights
    assert cases.groupby("controller", sort=False)["training_seed"].nunique().to_dict() == {"PID": 1, "mine": 2}
    with refused("the same training seed"):
        evaluate(tmp_path / "new", file, ["mine#0=pid", "mine=pid"])
    assert not (tmp_path / "new" / "tables").exists()


def test_train_takes_any_trained_controller_of_the_study_and_tunes_what_it_corrects(algorithm, tmp_path):
    file = study_file(tmp_path, pid={"tune": {"evaluations": 14, "cases": 2}})
    train("MINE", tmp_path / "out", file, rig="symmetric_eha", steps=7, seed=3)
    assert (algorithm.calls[-1]["steps"], algorithm.calls[-1]["seed"]) == (7, 3)
    assert (tmp_path / "out" / "policy.json").exists()
    gains = yaml.safe_load((tmp_path / "out" / "gains.yaml").read_text())
    assert algorithm.calls[0]["base"].gains.model_dump() == gains
    for what, options, message in (
        ("nothing", {}, "train 'nothing': unknown; this study trains: mine, head, pid, "),
        ("pid", {"resume": True}, "nothing to resume"),
        ("head", {"steps": 3}, "--steps: does not apply to hydro train head"),
        ("mine", {"agent": ["PPO=ppo"]}, "--agent: does not apply to hydro train mine"),
    ):
        with refused(message):
            train(what, tmp_path / "new", file, **options)
    for changes, message in (
        ({"task": {"leakage": {"faulty_range": [6.0, 7.0]}}}, r"faulty_range\[0\] = 6 must lie within"),
        ({"task": {"episode_duration": 0.2}}, "an episode of 40 control periods .* at least 50"),
    ):
        with refused(message):
            train("head", tmp_path / "new", study_file(tmp_path, **changes))
    assert not (tmp_path / "new").exists()


def test_a_study_on_another_rig_tunes_first_and_can_be_resumed(algorithm, settings, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tuning, "REST", 2.0)
    monkeypatch.setattr(training, "STANDSTILL_CASES", 2)
    file = study_file(tmp_path, pid={"tune": {"evaluations": 14, "cases": 2}})
    study, folder = default_study(file, rig="symmetric_eha"), tmp_path / "out"
    algorithm.fate = "late"
    stopped(study, folder, seed=2)
    gains = (folder / "controllers" / "PID" / "gains.yaml").read_text()
    note = re.search(
        r"^# (.*standstills.*) \(drawn plants and leaks, without sensor noise\)$", gains, flags=re.MULTILINE
    )
    told = f"pid, tuned: {note[1][0].lower()}{note[1][1:]}"
    assert (told in capsys.readouterr().out) == (not note[1].startswith("No limit cycle"))
    base = algorithm.calls[0]["base"]
    assert base.config.plant == study.task.plant
    assert base.gains.model_dump() == yaml.safe_load(gains) != study.make("PID").gains.model_dump()
    algorithm.fate = "finish"
    result = run_study(study, folder, seed=2, resume=True)
    assert (folder / "controllers" / "PID" / "gains.yaml").read_text() == gains
    assert algorithm.calls[1]["base"].gains == base.gains

    # The study with the gains, which needs no tuning.
    weights = [f"mine={folder / 'controllers' / 'mine' / 'policy'}"]
    evaluate(tmp_path / "again", folder / "tuned_study.yaml", weights)
    again = pd.read_csv(tmp_path / "again" / "tables" / "cases.csv")
    np.testing.assert_array_equal(again["mean_error_mm"], result.table("cases")["mean_error_mm"])
