"""A study over training seeds: its table and curves against known values, and what a second run does again."""

import json
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from command_line import assert_one_clear_line, hydro
from joblib import parallel_config
from refusal import refused

from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.running.cases import validation_errors
from hydro_agents.running.statistics import seeds_interval
from hydro_agents.study import over_seeds
from hydro_agents.study.settings import StudySettings
from hydro_env.files import write_yaml

HEAD = {"episodes": 100, "validation_episodes": 100, "epochs": 1, "width": 4, "batch": 64}
PPO = {"kind": "ppo", "corrects": "Flow linearisation", "settings": {"total_steps": 100}}
STUDY = StudySettings(
    controllers={"PID": {"kind": "pid"}, "Flow linearisation": {"kind": "flow_linearising"}, "PPO": PPO},
    leakage_head=HEAD,
)


def made(folder, seed):
    """A finished study, as the tests need it."""
    state = {"format": "hydro_env study, state 1", "done": ["evaluate"]}
    state["seconds"] = {"train PPO": 100 + seed, "train leakage head": 50}
    log = {"time/total_timesteps": [50, 75, 100], "validation/mean_error_mm": [0.2, np.nan, 0.1 + 0.01 * seed]}
    tables = {
        "tables/ratios": {
            "controller": ["Flow linearisation"] * 2 + ["PPO"] * 4,
            "against": "PID",
            "group": [*["all", "equal_weight"] * 2, "level", "family"],
            "value": ["", "", "", "", "0.3", "step"],
            "ratio": [0.7, 0.6, 0.70 - 0.01 * seed, 0.54, 0.5, 0.8],
        },
        "tables/cases": {
            "controller": [name for name in STUDY.controllers for _ in range(2)],
            "mean_error_mm": [1.0, 2.0, 0.5, 1.0, 0.4, 1.0 + seed],
            "failed": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        } | {metric.name: [1.0, 1.0, 0.6, 0.6, 1.5, 2.5] for metric in METRICS.values() if metric.ratio},
        "tables/detection_rates": {
            "controller": ["PID", "PPO"], "group": "range", "value": "0.1–0.2",
            "flagged_share": [0.9 + 0.05 * seed, 0.5],
        },
        "tables/detection_summary": {
            "controller": ["PID"], "auroc": 0.99, "false_alarm_rate": 0.01 + 0.001 * seed,
            "median_size_error_factor": 1.05,
        },
        "controllers/PPO/progress": log | {"validation/base_mean_error_mm": 0.12},
    }  # fmt: skip
    for name, table in tables.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=name != "tables/ratios")
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    (folder / "state.json").write_text(json.dumps(state))
    write_yaml(folder / "study.yaml", {**STUDY.model_dump(mode="json"), "seed": seed})
    (folder / "report.html").write_text("")


@pytest.fixture
def runs(monkeypatch):
    """Calls of run_study, which here writes a finished study at once."""
    calls = []

    def run(study, folder, seed, resume, overwrite, command):
        calls.append((folder.name, seed, resume, overwrite))
        made(folder, seed)

    monkeypatch.setattr(over_seeds, "run_study", run)
    return calls


def test_the_table_holds_every_seed_with_the_interval_of_student(runs, tmp_path):
    file = over_seeds.run_over_seeds(STUDY, tmp_path, range(3))
    assert runs == [(f"seed {seed}", seed, False, False) for seed in range(3)]
    table = pd.read_csv(file).set_index(["of", "figure"])
    assert list(table.columns[:5]) == ["group", "mean", "low", "high", "sd"]
    row = table.loc["PPO", "mean error ÷ PID's"].drop("group").astype(float)
    half = 4.302652729911275 * 0.01 / np.sqrt(3.0)  # Student's t for two degrees of freedom, from a table
    expected = [0.70, 0.69, 0.68, 0.69, 0.69 - half, 0.69 + half]
    np.testing.assert_allclose(row[["seed 0", "seed 1", "seed 2", "mean", "low", "high"]], expected)
    np.testing.assert_allclose(table.loc["PPO", "mean error ÷ that of Flow linearisation"]["mean"], 0.69 / 0.7)
    equal = table.loc["PPO", "mean error, kinds of reference weigh the same ÷ that of Flow linearisation"]
    np.testing.assert_allclose(equal[["mean", "low", "high"]].astype(float), 0.9)
    assert table.loc["PPO", "training, s"]["mean"] == 101.0
    assert table.loc["PPO", "mean error, leak of 0.3 l/min ÷ PID's"]["mean"] == pytest.approx(0.5)
    assert table.loc["PPO", "mean error, step ÷ PID's"]["mean"] == pytest.approx(0.8)
    worst = table.loc["PPO", "largest ratio of a case, error ÷ PID's"]
    np.testing.assert_allclose(worst[["seed 0", "seed 1", "seed 2", "sd"]].astype(float), [0.5, 1.0, 1.5, 0.5])
    assert table.loc["PPO", "valve travel ÷ PID's"]["mean"] == 2.0
    assert table.loc["Flow linearisation", "failed cases"]["mean"] == 1.0
    updates = STUDY.training_settings("PPO").updates(100)
    assert table.loc["PPO", "gradient steps"]["mean"] == updates
    head = table.loc["leakage head, under PID"]
    flagged = head.loc["leaks of 0.1–0.2 l/min flagged, %"]
    assert (flagged["seed 1"], flagged["high"]) == (95.0, 100.0)  # no more than all
    np.testing.assert_allclose(head.loc["false alarms, %"]["mean"], 1.1)


def test_the_learning_curves_hold_every_validation(runs, tmp_path):
    over_seeds.run_over_seeds(STUDY, tmp_path, range(4, 6))
    curves = pd.read_csv(tmp_path / over_seeds.CURVES)
    assert list(curves["controller"]) == ["PPO#4", "PPO#4", "PPO#5", "PPO#5"]
    assert list(curves["steps"]) == [50, 100, 50, 100]
    np.testing.assert_allclose(curves["validation/mean_error_mm"], [0.2, 0.14, 0.2, 0.15])
    error, _, _ = validation_errors(STUDY.task, STUDY.make("PID"))
    np.testing.assert_allclose(curves[over_seeds.FIRST_ERROR], error)
    np.testing.assert_allclose(over_seeds.relative(curves)["validation/base_mean_error_mm"], 0.12 / error)
    assert (tmp_path / over_seeds.CURVE_FILE).read_bytes().startswith(b"<?xml")


def test_a_second_run_keeps_finished_studies_of_the_same_settings(runs, tmp_path):
    over_seeds.run_over_seeds(STUDY, tmp_path, range(2))
    (tmp_path / "seed 1" / "report.html").unlink()
    assert over_seeds.is_finished(STUDY, tmp_path / "seed 0", 0)
    assert not over_seeds.is_finished(STUDY, tmp_path / "seed 0", 1)
    assert not over_seeds.is_finished(STUDY.model_copy(update={"title": "Another"}), tmp_path / "seed 0", 0)
    assert not over_seeds.is_finished(STUDY, tmp_path / "seed 1", 1)
    del runs[:]
    with pytest.raises(FileExistsError):  # this stand-in cannot go on
        over_seeds.run_over_seeds(STUDY, tmp_path, range(2), resume=True)
    assert runs == [("seed 1", 1, True, False)]


def in_threads(monkeypatch):
    """Two jobs side by side as threads of this process; they share one standard output, so that it stays."""
    monkeypatch.setattr(over_seeds, "redirect_stdout", nullcontext)
    monkeypatch.setattr(over_seeds, "redirect_stderr", nullcontext)
    return parallel_config("threading", n_jobs=2)


def test_side_by_side_the_table_is_the_same(runs, tmp_path, monkeypatch):
    alone, beside = tmp_path / "alone", tmp_path / "beside"
    over_seeds.run_over_seeds(STUDY, alone, range(3))
    del runs[:]
    with in_threads(monkeypatch):
        file = over_seeds.run_over_seeds(STUDY, beside, range(3))
        assert sorted(runs) == [(f"seed {seed}", seed, True, False) for seed in range(3)]
        assert file.read_bytes() == (alone / over_seeds.TABLE).read_bytes()
        over_seeds.run_over_seeds(STUDY, beside, range(3), resume=True)
    assert len(runs) == 3


def test_side_by_side_nothing_is_replaced_and_a_missing_disk_is_told(tmp_path, monkeypatch):
    (tmp_path / "seed 1").mkdir()
    (tmp_path / "seed 1" / "study.yaml").write_text("mine")
    with in_threads(monkeypatch):
        with refused(r"seed 1.study\.yaml: was not written by hydro"):
            over_seeds.run_over_seeds(STUDY, tmp_path, range(2))
        monkeypatch.setattr(over_seeds, "run_study", lambda *_: None)
        with refused("seed 0: the worker wrote elsewhere; all need a common disk"):
            over_seeds.run_over_seeds(STUDY, tmp_path / "new", range(2))


def test_two_seeds_have_no_interval():
    assert seeds_interval(np.array([1.0, 3.0])).value == 2.0
    assert np.isnan(seeds_interval(np.array([1.0, 3.0])).low)
    assert seeds_interval(np.array([2.0, 2.0, 2.0])) == (2.0, 2.0, 2.0)


def test_the_command_line_says_what_is_in_the_way(tmp_path):
    (tmp_path / "seed 0").write_text("mine")
    assert_one_clear_line(hydro("study", "--seeds", 2, "-o", tmp_path), "seed 0: is a file")
    assert_one_clear_line(hydro("study", "--seeds", 2, "--config", "none"), "none")
