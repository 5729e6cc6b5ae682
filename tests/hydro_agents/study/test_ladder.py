"""A ladder trains every rung on every seed, resumes, and gives the same table however its jobs are run."""

import json

import numpy as np
import pandas as pd
import pytest
from joblib import parallel_config

from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.trainers import TRAINERS
from hydro_agents.running.folders import config_folder
from hydro_agents.running.seeds import TEST_SEEDS, VALIDATION_SEEDS
from hydro_agents.study.ladder import JOB_FILE, LadderSettings, ratios, run_ladder, rung_scores
from hydro_env import ConfigurationError
from hydro_env.files import read_yaml, validate, write_yaml
from hydro_env.task.configuration import task_config

SMALL = {"steps_per_rollout": 8, "minibatches": 1, "epochs": 1}
LADDER = {
    "task": {"episode_duration": 0.1},
    "controllers": {"PID": {"kind": "pid"}},
    "seeds": 2,
    "settings": {"total_steps": 64, "axes": 8, "hidden_sizes": [4], "validation_every": 0},
    "evaluation": {"plants": 3, "leak_levels": [0.01, 4.0], "families": ["step", "sine"]},
    "rungs": {
        "alone": {"kind": "ppo", "settings": {**SMALL, "residual": False, "paired": False, "validation_every": 1}},
        "correction": {"kind": "ppo", "corrects": "PID", "settings": SMALL},
        "told": {"after": "correction", "settings": {"told_critic": True, "prices": {"reversal": 1.0}}},
    },
}


def ladder(**changes):
    return validate(LadderSettings, {**LADDER, **changes}, "ladder.yaml")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ladder")
    file = run_ladder(ladder(), folder)
    return folder, file.read_text()


def without_times(folder):
    table = pd.read_csv(folder / "ladder.csv")
    return table.drop(columns=[name for name in table if name.startswith("seconds")])


def test_every_rung_has_a_row_and_the_controllers_too(done):
    folder, text = done
    table = pd.read_csv(folder / "ladder.csv")
    assert list(table["rung"]) == ["PID", "alone", "correction", "told"]
    assert list(table["seeds"]) == [0, 2, 2, 2]
    assert table["mean"][0] == table["worst case"][0] == 1.0
    assert np.isnan(table["geo to corrected"][1])
    np.testing.assert_allclose(table["mean to corrected"][2:], table["mean"][2:])
    assert text.count("\n| ") == 5
    assert len(pd.read_csv(folder / "scores.csv")) == 1 + 3 * 2


def test_a_rung_that_is_validated_has_a_learning_curve(done):
    folder, _ = done
    drawn = [path.parent.name for path in folder.glob("rungs/*/learning_curve.svg")]
    assert drawn == ["alone"]
    text = (folder / "rungs" / "alone" / "learning_curve.svg").read_text()
    assert "error ÷ error of PID" in text


def test_a_rung_takes_over_what_it_does_not_change():
    resolved = ladder().resolved("told")
    assert resolved.corrects == "PID"
    assert resolved.settings.told_critic
    assert resolved.settings.steps_per_rollout == 8
    assert resolved.settings.hidden_sizes == (4,)
    assert ladder().resolved("alone").corrects is None


def test_side_by_side_and_resumed_the_table_is_the_same(done, tmp_path):
    folder, _ = done
    run_ladder(ladder(), tmp_path, rungs=["told"], seeds=1)
    trained = (tmp_path / "rungs" / "told" / "seed 0" / "policy.safetensors").stat().st_mtime_ns
    with parallel_config(n_jobs=2):
        run_ladder(ladder(), tmp_path, resume=True)
    assert (tmp_path / "rungs" / "told" / "seed 0" / "policy.safetensors").stat().st_mtime_ns == trained
    pd.testing.assert_frame_equal(without_times(folder), without_times(tmp_path), check_exact=True)


def test_results_of_other_settings_are_not_mixed_in(done):
    folder, _ = done
    other = ladder(settings={**LADDER["settings"], "total_steps": 128})
    with pytest.raises(ConfigurationError, match=r"rung alone, seed 0: .*was made with another 'settings'"):
        run_ladder(other, folder, rungs=["alone"], seeds=1, resume=True)
    assert json.loads((folder / "rungs" / "alone" / "seed 0" / JOB_FILE).read_text())["seed"] == 0
    with pytest.raises(ConfigurationError, match="holds results already"):
        run_ladder(ladder(), folder)


def test_overwrite_begins_anew_and_a_stopped_ladder_says_what_it_keeps(tmp_path, monkeypatch):
    run_ladder(ladder(), tmp_path, rungs=["alone"], seeds=1)
    other = ladder(settings={**LADDER["settings"], "total_steps": 128})
    run_ladder(other, tmp_path, rungs=["alone"], seeds=1, overwrite=True)
    job = json.loads((tmp_path / "rungs" / "alone" / "seed 0" / JOB_FILE).read_text())
    assert job["settings"]["total_steps"] == 128

    def stop(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("hydro_agents.study.ladder.run", stop)
    with pytest.raises(KeyboardInterrupt) as stopped:
        run_ladder(other, tmp_path, rungs=["alone"], seeds=1, resume=True)
    assert "keeps the finished work" in stopped.value.__notes__[0]


def test_a_training_that_fails_loses_only_its_own_row(tmp_path):
    rungs = {"wrong": {"kind": "ppo", "corrects": "PID", "settings": {**SMALL, "practice": {"nonsense": 1}}}}
    with pytest.raises(ConfigurationError, match="rung wrong, seed 0: practice"):
        run_ladder(ladder(seeds=1, rungs={**rungs, "alone": LADDER["rungs"]["alone"]}), tmp_path)
    assert list(pd.read_csv(tmp_path / "ladder.csv")["rung"]) == ["PID", "alone"]


def test_choices_are_made_on_validation_plants():
    settings = ladder()
    chosen, test = (settings.protocol(test).cases_in("task")[0] for test in (False, True))
    assert all(int(seed) in VALIDATION_SEEDS for seed in chosen.seeds)
    assert all(int(seed) in TEST_SEEDS for seed in test.seeds)
    np.testing.assert_array_equal(chosen.leakage_flow_lpm, test.leakage_flow_lpm)


def test_ratios_by_hand():
    cases = pd.DataFrame({"family": ["step", "step", "sine"], "mean_error_mm": [2.0, 4.0, 0.5]})
    reference = pd.DataFrame({"family": ["step", "step", "sine"], "mean_error_mm": [4.0, 4.0, 1.0]})
    mean, geo = ratios(cases, reference)
    assert mean == pytest.approx(6.5 / 9.0)
    assert geo == pytest.approx(np.sqrt(0.75 * 0.5))
    more = {"leakage_flow_lpm": [0.1, 1.0, 1.0], "failed": 0.0, "steady_state_error_mm": 1.0, "valve_travel_per_s": 2.0}
    row = rung_scores("x", 0, "PID", cases.assign(**more, seconds=7.0), {"PID": reference.assign(**more)}).iloc[0]
    assert row["worst case"] == 1.0
    assert row["1 l/min"] == pytest.approx(4.5 / 5.0)
    assert (row["step"], row["travel"], row["seconds"]) == (0.75, 1.0, 7.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rungs": {"a": {"after": "b", "kind": "ppo"}}}, "rungs.a: after = 'b': must be a rung before it"),
        ({"rungs": {"a": {}}}, "rungs.a: kind is missing"),
        ({"rungs": {"a": {"kind": "ppo", "corrects": "b"}}}, "rungs.a: corrects = 'b': must be one of PID"),
        ({"rungs": {"PID": {"kind": "ppo"}}}, "rungs.PID: is the name of a controller"),
        ({"controllers": {"PID": {"kind": "ppo"}}}, "controllers.PID: kind = 'ppo': must be one of pid"),
    ],
)
def test_an_impossible_ladder_is_refused_with_one_line(changes, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        ladder(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "rungs"), [("default", 10), ("baselines", 9), ("alone", 8)])
def test_the_shipped_ladders_can_be_trained(name, rungs):
    settings = LadderSettings.from_yaml(config_folder() / "ladders" / f"{name}.yaml")
    assert len(settings.rungs) >= rungs
    assert settings.seeds >= 5
    for rung in settings.rungs:
        resolved = settings.resolved(rung)
        task_config(settings.task, **resolved.settings.practice)


def test_every_learned_baseline_has_one_budget_and_every_algorithm_takes_part():
    settings = LadderSettings.from_yaml(config_folder() / "ladders" / "baselines.yaml")
    resolved = {name: settings.resolved(name) for name in settings.rungs}
    assert {rung.settings.total_steps for rung in resolved.values()} == {1_000_000}
    assert {rung.kind for rung in resolved.values()} == set(TRAINERS)
    assert {rung.corrects for rung in resolved.values()} == {None, "PID", "Flow linearisation"}
    assert settings.controllers["MPC"].kind == "mpc"


def test_the_rungs_without_an_aid_differ_from_the_published_road_in_that_aid_alone():
    settings = LadderSettings.from_yaml(config_folder() / "ladders" / "alone.yaml")
    whole = settings.resolved("1 million periods").settings.model_dump()
    published = validate(PPOSettings, read_yaml(config_folder() / "agents" / "ppo_direct.yaml"), "ppo_direct.yaml")
    assert settings.resolved("PPO alone").settings == published
    assert whole | {"total_steps": 14_000_000, "validation_every": 1_000_000} == published.model_dump()
    for name in list(settings.rungs)[2:]:
        own = settings.resolved(name).settings.model_dump()
        changed = {key for key in own if own[key] != whole[key]}
        assert changed <= {"axes", "steps_per_rollout", "minibatches", "epochs"} or len(changed) == 1


def test_the_table_tells_the_gradient_steps(done):
    folder, _ = done
    table = pd.read_csv(folder / "ladder.csv").set_index("rung")
    assert np.isnan(table["gradient steps"]["PID"])
    assert (table["gradient steps"][1:] == 1.0).all()  # 64 periods of 8 axes: one rollout, one batch, one epoch


def test_the_direct_policy_of_the_ladder_is_that_of_the_studies():
    """One set of settings, so that the pages do not contradict each other; only the length differs."""
    rung = LadderSettings.from_yaml(config_folder() / "ladders" / "default.yaml").resolved("PPO alone").settings
    study = validate(PPOSettings, read_yaml(config_folder() / "agents" / "ppo_direct.yaml"), "ppo_direct.yaml")
    shorter = {"total_steps": 1_000_000, "validation_every": 0}
    assert rung.model_dump() == study.model_dump() | shorter


def test_the_task_of_a_file_is_the_name_of_a_task_and_its_plant_that_of_a_rig(tmp_path):
    file = tmp_path / "ladder.yaml"
    for task, period, stroke in (("period_10ms", 0.010, 0.4), ({"plant": "symmetric_eha"}, 0.005, 0.12)):
        write_yaml(file, {**LADDER, "task": task})
        read = LadderSettings.from_yaml(file).task
        assert read.control_period == period
        assert read.plant.cylinder.stroke == stroke
