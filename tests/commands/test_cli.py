"""The command line as a person meets it: help, results, and one clear line for every mistake."""

import csv
import json
import os
import signal
import subprocess
import time

import pytest
import yaml
from command_line import COMMAND, assert_one_clear_line, done, environment, hydro, hydro_process, own_lines

import hydro_env
from hydro_agents.commands.application import GROUPS
from hydro_agents.rigs import check_table
from hydro_agents.running.folders import output_folder


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A forgotten --output writes into the test's own folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")


@pytest.mark.parametrize("command", [name for group in GROUPS.values() for name in group])
def test_help_teaches(command):
    assert command in hydro("--help").stdout
    answer = hydro(command, "--help")
    assert answer.returncode == 0
    assert f"hydro {command}" in answer.stdout


FILES = {
    "study.yaml": "controllers: {PID: {kind: pid}}\npdi: {proportional: 1}\n",
    "wrong.yaml": "cylinder: {bore: 0.04}",
}


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ("record --leakage -1", "leakage"),
        ("record --rig absent.yaml", "absent.yaml"),
        ("record --rig wrong.yaml", "did you mean bore_diameter?"),
        ("record --family sinus", "--family"),
        ("evaluate --agent \x1b[31mPID=pid", "--agent"),
        (f"record --rig {10_000 * 'a'}", "unknown"),
        ("evaluate --head absent", "--head: belongs to --protocol leakage"),
        ("evaluate --jobs 0", "--jobs"),
        ("study --config study.yaml", "pdi"),
        ("train ppo --resume", "nothing to resume"),
    ],
)
def test_a_mistake_is_answered_in_one_line_and_leaves_nothing(tmp_path, arguments, part):
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    assert_one_clear_line(hydro(*arguments.split(), "--output", "new"), part)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ("record --duration abc", "'--duration'"),
        ("train", "hydro train --help"),
        ("train nothing", "ppo, head, pid"),
        ("nothing", "hydro --help"),
    ],
)
def test_wrong_usage(arguments, part):
    assert_one_clear_line(hydro(*arguments.split()), part)


def test_the_version_is_told_and_without_arguments_the_help():
    assert done("--version").stdout == f"hydro_env {hydro_env.__version__}\n"
    answer = hydro()
    assert answer.returncode == 2
    assert "check-rig" in answer.stdout + answer.stderr


NAMEPLATES = "bore=63mm rod=36mm stroke=0.5m rated-flow=40l/min supply-pressure=160bar mass=200kg -o rig.yaml"


def test_a_terminal_without_utf_8_and_a_name_without_it(tmp_path):
    folder = os.fsencode(tmp_path) + b"/f\xff"
    answer = hydro_process("new-rig", *NAMEPLATES.split()[:-1], os.fsdecode(folder), PYTHONIOENCODING="ascii")
    assert answer.returncode == 0, answer.stderr
    assert "f\\udcff" in answer.stdout
    assert os.path.exists(folder)
    assert_one_clear_line(hydro("new-rig", "-o", os.fsdecode(folder)), "f\\udcff: exists")


@pytest.mark.parametrize("arguments", ["--help", f"new-rig {NAMEPLATES}"])
def test_a_pipe_that_is_closed_is_no_error(tmp_path, arguments):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        ended = subprocess.run(
            [*COMMAND, *arguments.split()], stdout=writing, stderr=subprocess.PIPE, env=environment(), check=False
        )
    finally:
        os.close(writing)
    assert own_lines(ended.stderr.decode()) == []
    assert ended.returncode in (0, 141)
    assert (tmp_path / "rig.yaml").exists() == ("rig.yaml" in arguments)


TINY = {
    "task": {"episode_duration": 0.4},
    "controllers": {
        "PID": {"kind": "pid"},
        "PPO": {
            "kind": "ppo",
            "settings": {"total_steps": 12_000, "axes": 64, "steps_per_rollout": 32, "residual_scale": 1.0},
            "corrects": "PID",
        },
    },
    "evaluation": {
        **{"plants": 3, "standstill_plants": 1},
        **{"leak_levels": [0.01, 1.0], "families": ["step", "sine"]},
    },
}


@pytest.mark.parametrize(
    ("number", "code", "resume", "files", "words"),
    [
        (signal.SIGINT, 130, False, ["checkpoint.json"], "keeps the finished work, --resume continues"),
        (signal.SIGTERM, 143, None, ["check.json"], "keeps the finished work, --overwrite begins anew"),
        (signal.SIGHUP, 129, False, [], "stopped"),
    ],
)
def test_a_stopped_command_says_what_it_keeps(tmp_path, monkeypatch, number, code, resume, files, words):
    folder = tmp_path / "out"

    def stopped(*_):
        with output_folder(folder, "check-rig", ["checkpoint.json", "check.json"], resume=resume):
            for name in files:
                (folder / name).write_text("")
            signal.raise_signal(number)
            raise AssertionError("not reached")

    monkeypatch.setattr(check_table, "check_to_console", stopped)
    # In the background Ctrl-C is ignored, under nohup the end of the terminal: for the tests as for a command.
    before = signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    try:
        answer = hydro("check-rig")
    finally:
        signal.signal(number, before)
    assert answer.returncode == code
    [line] = own_lines(answer.stderr)
    assert line.startswith("hydro: stopped")
    assert words in line
    assert folder.exists() == bool(files)


def test_under_nohup_a_command_outlives_its_terminal(tmp_path, monkeypatch):
    monkeypatch.setattr(check_table, "check_to_console", lambda *_: signal.raise_signal(signal.SIGHUP) or [])
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        done("check-rig")
    finally:
        signal.signal(signal.SIGHUP, before)


def stopped_study(folder):
    """Start the study in a process of its own, and end it after the first update of PPO as a cluster does."""
    process = subprocess.Popen(
        [*COMMAND, "study", "--config", "study.yaml", "--output", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    log = folder / "controllers" / "PPO" / "progress.csv"
    while process.poll() is None and not (log.exists() and log.stat().st_size):
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate()
    return process.returncode, errors


def test_a_study_that_was_stopped_is_resumed(tmp_path):
    study, folder = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(yaml.safe_dump(TINY))
    code, errors = stopped_study(folder)
    assert code == 143, errors
    assert own_lines(errors) == [f"hydro: stopped; {folder} keeps the finished work, --resume continues"]
    assert not (folder / "report.html").exists()
    done("study", "--config", study, "--output", folder, "--resume")
    assert (folder / "report.html").is_file()
    assert len(list(csv.DictReader((folder / "tables" / "cases.csv").open()))) == 2 * 2 * 2 * 3
    weights = (*("--config", folder / "study.yaml"), *("--agent", f"PPO={folder / 'controllers' / 'PPO' / 'policy'}"))
    into_study = hydro("evaluate", *weights, "--output", folder, "--overwrite")
    assert_one_clear_line(into_study, "was not written by hydro evaluate")
    listed = json.loads((folder / ".hydro.json").read_text())["files"]["study"]
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {".hydro.json"}
    assert set(listed) == found
