"""The command line as a person meets it: help, results, and one clear line for every mistake."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
import yaml

import hydro_env
from agents.commands.options import stoppable
from agents.rigs.simulation import trajectory_figure
from hydro_env import PlantParameters, simulate

ROOT = Path(__file__).parents[1]


def hydro(*arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "agents.commands.application", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd or ROOT,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"},
    )


def assert_one_clear_line(result, *parts):
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, result.stderr
    for part in parts:
        assert part in lines[0]


@pytest.mark.parametrize("command", ["simulate", "check-rig", "benchmark", "train", "evaluate", "study"])
def test_help_teaches(command):
    assert command in hydro("--help").stdout
    result = hydro(command, "--help")
    assert result.returncode == 0
    assert "--output" in result.stdout


def test_simulate_writes_all_quantities_and_a_picture(tmp_path):
    result = hydro("simulate", "--leakage", "1", "--duration", "0.2", "--output", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    rows = list(csv.reader((tmp_path / "run" / "trajectory.csv").open()))
    assert rows[0][:3] == ["time [s]", "voltage [V]", "position [m]"]
    assert len(rows) == 1 + 201
    assert (tmp_path / "run" / "trajectory.png").read_bytes()[:4] == b"\x89PNG"
    rig = yaml.safe_load((tmp_path / "run" / "rig.yaml").read_text())
    assert rig["leakage"]["internal_resistance"] == pytest.approx(6e11)
    before = (tmp_path / "run" / "trajectory.csv").read_bytes()
    refused = hydro("simulate", "--output", tmp_path / "run")
    assert_one_clear_line(refused, "holds results already")
    assert (tmp_path / "run" / "trajectory.csv").read_bytes() == before


def test_simulate_reads_a_rig_and_a_csv(tmp_path):
    (tmp_path / "voltage.csv").write_text("time,voltage\n0,0\n0.001,1.5\n0.002,-1.5\n")
    rig = ROOT / "configs" / "rigs" / "kovari_2015.yaml"
    result = hydro("simulate", "--rig", rig, "--input-file", tmp_path / "voltage.csv", "--output", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    rows = list(csv.reader((tmp_path / "run" / "trajectory.csv").open()))
    assert [float(row[1]) for row in rows[1:]] == [0.0, 1.5, -1.5, -1.5]


def test_the_legends_of_the_picture_lie_over_no_line():
    figure = trajectory_figure(simulate(PlantParameters(), [3.0] * 20, 1e-3))
    figure.draw_without_rendering()
    legends = [axes.get_legend() for axes in figure.axes if axes.get_legend() is not None]
    assert len(legends) == 3
    for legend in legends:
        assert legend.get_window_extent().y0 >= legend.axes.get_window_extent().y1 - 1.0


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("cylinder: {bore: 0.04}", ["rig.yaml", "cylinder.bore", "unknown key", "bore_diameter"]),
        ("cylinder: {bore_diameter: 40}", ["cylinder.bore_diameter = 40", "less than or equal to 1", "unit: m"]),
        ("load: {mass: -60}", ["load.mass = -60", "unit: kg"]),
        ("cylinder: {rod_diameter: 0.05}", ["rod_diameter = 0.05 m does not fit", "bore_diameter = 0.04 m"]),
        ("supply: {pressure: 70}", ["supply.pressure = 70", "unit: Pa"]),
        ("fluid: {bulk_modulus: .nan}", ["fluid.bulk_modulus = nan"]),
        ("- 1\n- 2", ["a mapping of settings is needed"]),
        ("load: {mass: [", ["not valid YAML"]),
    ],
)
def test_wrong_rigs(tmp_path, content, parts):
    (tmp_path / "rig.yaml").write_text(content)
    result = hydro("simulate", "--rig", tmp_path / "rig.yaml", "--output", tmp_path / "run")
    assert_one_clear_line(result, *parts)
    assert not (tmp_path / "run").exists()


def test_other_mistakes(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "foreign.json").write_text("{}")
    study = tmp_path / "study.yaml"
    study.write_text("pdi: {proportional: 1}\n")
    levels, included, semicolons = tmp_path / "levels.yaml", tmp_path / "included.yaml", tmp_path / "input.csv"
    levels.write_text("evaluation: {leak_levels: [0.1, -1]}\n")
    included.write_text("ppo: ppo.yaml\n")
    (tmp_path / "ppo.yaml").write_text("total_steps: -1\n")
    semicolons.write_text("t,v\n0,001;1,5\n")
    for arguments, parts in (
        (["simulate", "--leakage", "-1", "-o", tmp_path / "a"], ["--leakage = -1", "0 to 20"]),
        (["simulate", "--voltage", "50", "-o", tmp_path / "a"], ["--voltage = 50", "-10 to 10"]),
        (["simulate", "--position", "0.15", "-o", tmp_path / "a"], ["position = 0.15 m cannot be held"]),
        (["simulate", "--duration", "-1", "-o", tmp_path / "a"], ["--duration = -1"]),
        (["simulate", "--rig", tmp_path / "absent.yaml"], ["absent.yaml: cannot be read: No such file"]),
        (["simulate", "-o", tmp_path / "file" / "below"], ["below", "cannot be written"]),
        (["simulate", "-o", "/proc/nowhere"], ["/proc/nowhere", "cannot be written"]),
        (["evaluate", "--policy", tmp_path / "foreign", "-o", tmp_path / "a"], ["foreign.json", "not the"]),
        (["evaluate", "--head", tmp_path / "absent", "-o", tmp_path / "a"], ["absent.json: cannot be read"]),
        (["study", "--config", study, "-o", tmp_path / "a"], ["study.yaml", "pdi", "unknown key"]),
        (["study", "--config", levels, "-o", tmp_path / "a"], ["levels.yaml", "leak_levels: -1 l/min"]),
        (["study", "--config", included, "-o", tmp_path / "a"], ["ppo.yaml", "total_steps = -1"]),
        (["simulate", "--input-file", semicolons, "-o", tmp_path / "a"], ["line 2", "separate columns by commas"]),
        (["train", "ppo", "--resume", "-o", tmp_path / "empty"], ["nothing to resume", "checkpoint.json"]),
    ):
        assert_one_clear_line(hydro(*arguments), *parts)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["simulate", "--voltage", "abc"], ["hydro: ", "'--voltage'", "a number", "see hydro simulate --help"]),
        (["simulate", "--volts", "3"], ["--volts", "--voltage"]),
        (["simulate", "--voltage"], ["--voltage"]),
        (["simulate", "extra"], ["extra", "see hydro simulate --help"]),
        (["train"], ["ppo, head, pid", "see hydro train --help"]),
        (["train", "nothing"], ["'nothing'", "'ppo', 'head', 'pid'"]),
        (["train", "ppo", "--steps", "0"], ["--steps", "greater than or equal to 1"]),
        (["nothing"], ["'nothing'", "see hydro --help"]),
    ],
)
def test_wrong_usage(arguments, parts):
    assert_one_clear_line(hydro(*arguments), *parts)


def test_version():
    answer = hydro("--version")
    assert answer.returncode == 0
    assert answer.stdout == f"hydro_env {hydro_env.__version__}\n"


def test_without_arguments_the_help_is_shown():
    answer = hydro()
    assert answer.returncode == 2
    assert "check-rig" in answer.stdout + answer.stderr


@pytest.mark.parametrize(("resumable", "fate"), [(True, "--resume goes on"), (False, "begins anew")])
def test_ctrl_c_says_what_becomes_of_the_work(capsys, resumable, fate):
    with pytest.raises(typer.Exit) as stopped, stoppable(resumable):
        raise KeyboardInterrupt
    assert stopped.value.exit_code == 130
    told = capsys.readouterr().err
    assert fate in told
    assert ("--resume" in told) == resumable


TINY = {
    "task": {"episode_duration": 0.4},
    "ppo": {"total_steps": 200_000, "axes": 64, "steps_per_rollout": 32, "residual_scale": 1.0},
    "leakage_head": {"episodes": 200, "validation_episodes": 200, "epochs": 2, "width": 8, "batch": 64},
    "evaluation": {"plants": 3, "detection_episodes": 100, "leak_levels": [0.01, 1.0], "families": ["step", "sine"]},
}


def test_ctrl_c_in_training_keeps_a_checkpoint_and_the_study_resumes(tmp_path):
    study = tmp_path / "study.yaml"
    study.write_text(yaml.safe_dump(TINY))
    folder = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "agents.commands.application",
        "study",
        "--config",
        str(study),
        "--output",
        str(folder),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    )
    assert process.stdout is not None
    for line in process.stdout:
        if "train PPO" in line:
            break
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "--resume" in errors
    assert (folder / "checkpoint.safetensors").exists()
    assert not (folder / "report.html").exists()

    refused = hydro("study", "--config", study, "--output", folder)
    assert_one_clear_line(refused, "holds results already")
    resumed = hydro("study", "--config", study, "--output", folder, "--resume")
    assert resumed.returncode == 0, resumed.stderr
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert "http://" not in report.replace("http://www.w3.org", "")
    for name in ("cases.csv", "ratios.csv", "detection_summary.csv"):
        assert (folder / "tables" / name).stat().st_size > 100
    cases = list(csv.DictReader((folder / "tables" / "cases.csv").open()))
    assert len(cases) == 2 * 2 * 2 * 3
    curve = list(csv.DictReader((folder / "training_curve.csv").open()))
    assert int(float(curve[0]["steps"])) == 64 * 32
    assert [float(row["seconds"]) for row in curve] == sorted(float(row["seconds"]) for row in curve)
    into_study = hydro("train", "ppo", "--config", study, "--output", folder, "--overwrite")
    assert_one_clear_line(into_study, "holds a study")
    # What a study leaves can be used again, and what does not concern training may change.
    TINY["title"] = "Another title"
    study.write_text(yaml.safe_dump(TINY))
    again = hydro("study", "--config", study, "--output", folder, "--resume")
    assert again.returncode == 0, again.stderr
    assert "already trained" in again.stdout
    judged = hydro(
        *("evaluate", "--config", folder / "study.yaml", "--policy", folder / "policy"),
        *("--head", folder / "leakage_head", "--output", tmp_path / "judged"),
    )
    assert judged.returncode == 0, judged.stderr
    other = hydro("study", "--config", study, "--output", folder, "--resume", "--seed", "7")
    assert_one_clear_line(other, "is of another seed or other settings")


def test_benchmark_refuses_an_unknown_group(tmp_path):
    result = hydro("benchmark", "--only", "speed", "--output", tmp_path / "new")
    assert_one_clear_line(result, "--only speed: unknown group", "kernel, single")
    assert not (tmp_path / "new").exists()
