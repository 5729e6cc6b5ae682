"""The leak test: its steps, limits and bound, and the leak that it reads."""

import json

import numpy as np
import pytest
from command_line import assert_one_clear_line, done, hydro

from hydro_agents.running.seeds import LEARNING
from hydro_env import TaskConfig
from hydro_rig.diagnosis.leak_test import Step, plan, read_leak_test, simulated, worn_task
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.recordings.simulated import recording_csv

CONFIG = TaskConfig()
STEPS = (
    Step(0.2, 2.5, "press against the extended stop"),
    Step(0.04, 1.5, "press less"),
    Step(0.0, 2.0, "valve closed"),
    Step(-0.1, 0.5, "move off the stop"),
    Step(0.1, 0.5, "and back"),
    Step(0.0, 1.0, "valve closed"),
)
"""A test of 8 s on an axis with a spring."""


def test_the_plan_keeps_the_limits_and_says_its_bound():
    planned = plan(CONFIG, 10.0, stop="extended")
    assert planned.speed <= CONFIG.failure.end_stop_speed
    assert (planned.bound < 0.02).all()
    assert np.abs(planned.commands).max() <= 0.3
    assert len(planned.commands) == pytest.approx(10.0 / CONFIG.control_period, abs=20)


def recorded(tmp_path, leak):
    """The recording of a short test on a simulated axis with a worn valve."""
    axis = simulated(worn_task(CONFIG), STEPS, 1, leak, LEARNING.take(1, 4001))
    path = tmp_path / f"{leak:g}.csv"
    time = CONFIG.control_period * np.arange(axis.signals.shape[2])
    path.write_text(recording_csv(time, axis.signals[0]), encoding="utf-8")
    return path, axis


def test_the_reading_finds_leak_and_wear(tmp_path):
    path, axis = recorded(tmp_path, 0.3)
    found, quantities = read_leak_test(path, CONFIG)
    assert found.verdict.kind is Kind.LEAK
    seal = quantities["leakage_flow_lpm"]
    assert seal.value == pytest.approx(0.3, abs=2.0 * (seal.high - seal.low))
    assert seal.high - seal.low < 0.1
    shift = quantities["valve.null_shift"]
    true = float(axis.value("valve.null_shift")[0])
    assert shift.value == pytest.approx(true, abs=2.0 * (shift.high - shift.low))


def test_the_command_writes_commands_and_a_recording_that_it_reads(tmp_path):
    out = tmp_path / "plan"
    done("leak-test", "--duration", 8, "--stop", "extended", "--output", out)
    rows = np.loadtxt(out / "commands.csv", delimiter=",", skiprows=1)
    assert np.abs(rows[:, 1]).max() <= 0.3
    np.testing.assert_allclose(rows[:, 2], 10.0 * rows[:, 1], atol=1e-5)
    assert (out / "plan.html").stat().st_size > 0
    answer = hydro("leak-test", out / "simulated.csv", "--output", tmp_path / "reading")
    assert answer.returncode == json.loads((tmp_path / "reading/leak_test.json").read_text())["exit_code"]
    assert (tmp_path / "reading/leak_test.html").stat().st_size > 0


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--duration", 0), ("duration",)),
        (("--duration", 5), ("--duration 5 s", "raise --speed")),
        (("none.csv",), ("none.csv",)),
    ],
)
def test_leak_test_refuses_in_one_line(tmp_path, options, parts):
    assert_one_clear_line(hydro("leak-test", *options, "--output", tmp_path / "out"), *parts)
    assert not (tmp_path / "out").exists()
