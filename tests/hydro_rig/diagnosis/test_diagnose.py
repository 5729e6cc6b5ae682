"""From a recorded file to verdict, page, picture and tables."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import problems_everywhere
from command_line import assert_one_clear_line, hydro, own_lines
from recorded import CONFIG, recorded_file

from hydro_agents.detection.detector import Why, Windows
from hydro_agents.detection.operations import MOTIONS
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import COMMAND, POSITION
from hydro_rig.diagnosis.diagnose import spread
from hydro_rig.diagnosis.verdict import EXIT_CODES, Kind
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import cut

SHARP_LAP = Path(__file__).parents[2] / "recorded_elsewhere" / "sharp_lap.csv"
FILES = {".hydro.json", "diagnosis.html", "findings.csv", "leak.csv"}


def verdict_on(folder, file, *options):
    answer = hydro("diagnose", file, "--output", folder / "out", "--overwrite", *options)
    line = own_lines(answer.stdout)[-1]
    kind = next(kind for kind in Kind if line.startswith(kind.value))
    assert answer.returncode == EXIT_CODES[kind], answer.stderr
    return line


def test_record_and_diagnose_from_the_command_line(tmp_path, browser):
    file = tmp_path / "axis.csv"
    done = hydro("record", "-o", file, "--leakage", 0.5, "--duration", 4, "--family", "sine", "--seed", 1_000_005)
    assert done.returncode == 0
    assert "800 rows" in done.stdout
    assert_one_clear_line(hydro("record", "-o", file), "exists", "--overwrite")
    answer = hydro("diagnose", file, "--output", tmp_path / "out")
    assert own_lines(answer.stdout)[-1].startswith(("internal leak of 0.50", "internal leak of 0.49"))
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    table = pd.read_csv(tmp_path / "out" / "leak.csv")
    assert table["end_s"].tolist() == [2.0, 4.0]
    assert ((table["low"] < 0.5 + 0.01) & (table["high"] > 0.5 - 0.01)).all()
    assert problems_everywhere(browser, tmp_path / "out" / "diagnosis.html") == []
    assert_one_clear_line(hydro("diagnose", "absent.csv", "--output", tmp_path / "out"), "holds results already")


def test_a_fault_is_told_from_a_leak(tmp_path):
    recorded_file(tmp_path / "a.csv", leakage=1.0, faults={"valve_null_shift": 0.012}, duration=1.0)
    verdict = verdict_on(tmp_path, tmp_path / "a.csv", "--window", 1)
    assert verdict.startswith("internal leak")
    assert "besides, null shift of the valve" in verdict


def test_a_late_command_is_read_and_the_console_says_how_late_it_is(tmp_path):
    recorded_file(tmp_path / "a.csv", {"command_latency": 3e-3}, leakage=0.5, duration=1.0)
    answer = hydro("diagnose", tmp_path / "a.csv", "--window", 1, "--output", tmp_path / "out")
    lines = own_lines(answer.stdout)
    assert lines[-1].startswith(("internal leak of 0.50", "internal leak of 0.49"))
    assert any("acts 3.0 ms after its row, and not 1.0 ms (command_latency): used" in line for line in lines)


def test_a_log_of_its_own_period_is_read(tmp_path):
    """Logged with a controller of 4.883 ms; the task says 5 ms."""
    recorded_file(tmp_path / "a.csv", {"control_period": 1.0 / 204.8}, leakage=0.3, duration=1.1)
    assert verdict_on(tmp_path, tmp_path / "a.csv", "--window", 1).startswith("internal leak of 0.3")


@pytest.fixture(scope="module")
def leaking(tmp_path_factory):
    """A recording of 1 s of an axis with a leak of 0.5 l/min."""
    file = tmp_path_factory.mktemp("leaking") / "a.csv"
    recorded_file(file, leakage=0.5, duration=1.0)
    return file


@pytest.mark.parametrize(("leakage", "answer"), [(0.05, f"cannot tell: {Why.AT_REST.word}"), (1.0, "internal leak")])
def test_an_axis_at_rest_with_worn_edges_must_be_moved_unless_its_leak_is_sure(tmp_path, leakage, answer):
    task = MOTIONS["standing still"](CONFIG)
    recorded_file(tmp_path / "a.csv", task, leakage, None, {"valve_underlap": 0.02}, seed=90_210_000, duration=1.0)
    assert verdict_on(tmp_path, tmp_path / "a.csv", "--window", 1).startswith(answer)


def test_bad_input_leaves_nothing_behind(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    (tmp_path / "map.yaml").write_text("time: a\n")
    for options in ((), ("--map", tmp_path / "map.yaml"), ("--map", tmp_path / "absent.yaml"), ("--rig", "absent")):
        assert_one_clear_line(hydro("diagnose", tmp_path / "a.csv", "--output", tmp_path / "out", *options))
    assert not (tmp_path / "out").exists()
    wrong = {"--fault": ("x=1", "external_leak", "external_leak=x", "external_leak=99"), "--duration": ("1e9",)}
    for option, values in {**wrong, "--family": ("x",)}.items():
        for value in values:
            assert_one_clear_line(hydro("record", "-o", tmp_path / "r.csv", option, value))
    assert not (tmp_path / "r.csv").exists()


def test_another_program_gets_the_verdict(tmp_path, leaking):
    answer = hydro("diagnose", leaking, "--window", 1, "--output", tmp_path / "out", "--json")
    found = json.loads(answer.stdout)
    assert answer.returncode == found["exit_code"] == EXIT_CODES[Kind.LEAK], answer.stderr
    assert found["verdict"] == "internal leak"
    assert found["leak"]["low"] < 0.5 < found["leak"]["high"]
    assert found["windows"] == 1


def test_other_sampling_is_told_and_still_drawn(tmp_path):
    recorded_file(tmp_path / "a.csv", duration=3.0)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "b.csv").write_text("\n".join([*lines[:2], *lines[2::3]]))
    assert verdict_on(tmp_path, tmp_path / "b.csv").startswith("cannot tell: time has one row every 15 ms")
    assert (tmp_path / "out" / "diagnosis.html").stat().st_size > 0
    assert pd.read_csv(tmp_path / "out" / "leak.csv").empty


def test_a_leak_beside_sharp_edges_is_read_and_their_lap_is_no_fault():
    """1 s of an axis with a leak of 1 l/min in Hopsan, whose valve has sharp edges with an underlap of 0.75 %."""
    config = task_config({"control_period": 2e-3, "command_latency": 6e-4}, rig=SHARP_LAP.with_suffix(".yaml"))
    windows = cut(check_recording(read_recording(SHARP_LAP), config).samples, 500)
    reading, found = EstimatorDetector(restarts=0).read_and_fit(windows, config)
    assert found.value("valve.overlap")[0] == pytest.approx(-0.0075, abs=0.002)
    assert reading.low_lpm[0] < 1.0 < reading.high_lpm[0]
    assert not reading.fault.any()


def test_a_long_recording_is_read_in_windows_that_move_all_over_it():
    rows = np.zeros((100, 5, 8))
    rows[:, POSITION] = np.where(np.arange(100)[:, None] % 10 == 7, np.arange(8) % 2, 0.0)  # every tenth moves
    rows[57, COMMAND, 3] = np.nan  # without all commands
    windows = Windows(rows, np.arange(100.0), np.arange(1.0, 101.0))
    read = spread(windows, 10).begin
    assert read[[0, 1, 2, 3, 4, 6, 7, 8, 9]].tolist() == [7, 17, 27, 37, 47, 67, 77, 87, 97]
    assert 50 <= read[5] < 60
    assert read[5] != 57
    assert spread(windows, 100) is windows
