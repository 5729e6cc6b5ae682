"""The leak test: its steps, limits and bound, and the leak that it reads."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import assert_one_clear_line, done, hydro

from hydro_agents.running.seeds import LEARNING
from hydro_env import TaskConfig
from hydro_rig.diagnosis.leak_test_plan import (
    Step,
    plan,
    priors_of_test,
    simulated,
    worn_task,
)
from hydro_rig.diagnosis.leak_test_reading import edge_flow, read_leak_test
from hydro_rig.diagnosis.verdict import EXIT_CODES, Kind
from hydro_rig.estimation.model import Model
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


def test_the_flow_through_the_edges_is_that_of_two_equal_edges_in_series():
    task = worn_task(CONFIG)
    priors = priors_of_test(task, np.ones(4, dtype=bool))
    model = Model(task, priors, np.zeros((1, 2)))
    values = np.array([prior.mean for prior in priors.values()])
    valve = {"valve.underlap": 0.02, "valve.rated_flow": 1.5e-4, "valve.edge_ratio": 1.0, "valve.null_shift": 0.01}
    values[model.names.index("load.spring_stiffness")] = -200.0  # the fit of an axis without a spring may end there
    for name, value in valve.items():
        values[model.names.index(name)] = value
    shared = np.flatnonzero([not name.startswith("start.") for name in model.names])
    joint = SimpleNamespace(scaled=model.scaled(values)[None], shared=shared)
    flow, slope = edge_flow(SimpleNamespace(model=model, joint=joint), task)
    gain = 1.5e-4 / np.sqrt(35e5)  # of an edge
    drop = 0.5 * (CONFIG.plant.supply.pressure - CONFIG.plant.supply.tank_pressure)
    assert flow == pytest.approx(2.0 * gain * 0.01 * np.sqrt(drop) * 6e4, rel=1e-3)  # each edge open by half of 2 %
    names = [model.names[place] for place in shared]
    assert slope[names.index("valve.underlap")] > 0.0
    assert slope[names.index("fluid.bulk_modulus")] == 0.0


def recorded(tmp_path, leak):
    """The recording of a short test on a simulated axis with a worn valve."""
    task = worn_task(CONFIG)
    axis = simulated(task, STEPS, 1, leak, LEARNING.take(1, 4001))
    path = tmp_path / f"{leak:g}.csv"
    time = CONFIG.control_period * np.arange(axis.signals.shape[2])
    path.write_text(recording_csv(time, axis.signals[0]), encoding="utf-8")
    return path, axis


def test_the_reading_finds_leak_and_wear(tmp_path):
    path, axis = recorded(tmp_path, 0.3)
    found = read_leak_test(path, CONFIG)
    assert found.verdict.kind is Kind.LEAK
    seal = found.fit.seal
    assert seal.value == pytest.approx(0.3, abs=5.0 * seal.deviation)
    assert seal.bound <= seal.deviation < 0.03
    shift = found.fit.quantities["valve.null_shift"]
    assert shift.value == pytest.approx(float(axis.value("valve.null_shift")[0]), abs=5.0 * shift.deviation)
    facts = found.facts()
    assert facts["exit_code"] == EXIT_CODES[Kind.LEAK] == 10
    assert facts["seal_lpm"]["low"] < 0.3 < facts["seal_lpm"]["high"] or abs(seal.value - 0.3) < 0.02
    json.dumps(facts)


def test_the_command_writes_commands_and_a_recording_that_it_reads(tmp_path):
    out = tmp_path / "plan"
    done("leak-test", "--duration", 8, "--stop", "extended", "--output", out)
    rows = np.loadtxt(out / "commands.csv", delimiter=",", skiprows=1)
    assert np.abs(rows[:, 1]).max() <= 0.3
    np.testing.assert_allclose(rows[:, 2], 10.0 * rows[:, 1], atol=1e-5)
    assert (out / "plan.html").stat().st_size > 0
    answer = hydro("leak-test", out / "simulated.csv", "--output", tmp_path / "reading")
    assert answer.returncode == json.loads((tmp_path / "reading/leak_test.json").read_text())["exit_code"]
    assert "past the seal" in (tmp_path / "reading/leak_test.html").read_text(encoding="utf-8") + answer.stdout


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
