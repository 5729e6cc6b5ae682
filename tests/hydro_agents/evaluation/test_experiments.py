"""Stiffness against linearised loops; all experiments as parts of a protocol."""

import numpy as np
import pandas as pd
import pytest
from joblib import parallel_config
from proportional import Constant, Proportional, exact_task
from published import TABLES, assert_published

from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_agents.evaluation import experiments
from hydro_agents.evaluation.experiments import EXPERIMENTS
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.robustness_protocol import EXPERIMENTS as PARTS
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.runner import run
from hydro_agents.learning.loading import shipped
from hydro_env import TaskConfig, resistance_from_flow
from hydro_env.plant.analysis import force_limits

EXACT = exact_task()


def done(name, task, gain, leaks, plants=1):
    """The table of an experiment with a proportional controller."""
    return EXPERIMENTS[name]._replace(leaks=leaks, plants=plants)(task, Proportional(gain, task))


def loop_of(task, leak):
    """The loop, linearised where the experiments hold the axis."""
    plant = task.plant.replace(leakage={"internal_resistance": resistance_from_flow(leak)})
    return sampled_loop(plant, experiments.working_place(task.plant), task.control_period, task.command_latency)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Forces (2 N) so small that a linearised loop describes the motion."""
    monkeypatch.setattr(experiments, "FORCE_SHARE", 2.0 / min(force_limits(EXACT.plant)))


@pytest.mark.parametrize("leak", [1.0, 4.0])
def test_a_small_force_meets_the_static_stiffness_of_the_loop(leak):
    stiffness = loop_of(EXACT, leak).static_stiffness(80.0)  # N/m
    table = done("force_step", EXACT, 80.0, [leak])
    assert table["static_mm_per_kn"].item() == pytest.approx(1e6 / stiffness, rel=0.02)
    assert table["peak_mm"].item() >= table["remaining_mm"].item()


def test_a_leak_makes_the_loop_soft_and_gain_makes_it_stiff():
    tables = {gain: done("force_step", EXACT, gain, [0.3, 4.0]) for gain in (40.0, 80.0)}
    (tight, leaking), (_, stiff) = (table["static_mm_per_kn"] for table in tables.values())
    assert leaking > 3.0 * tight
    assert leaking == pytest.approx(2.0 * stiff, rel=0.1)
    assert all((table["recovery_s"] < 1.5).all() for table in tables.values())


def test_deviations_are_counted_from_the_rest_before_the_force_and_no_other_force_counts(monkeypatch):
    busy = exact_task(leakage={"schedule": "growth"}, disturbance={"kind": "mixed", "force_share": (0.3, 0.5)})
    pd.testing.assert_frame_equal(*(done("force_step", task, 40.0, [1.0]) for task in (EXACT, busy)))
    monkeypatch.setattr(experiments, "FORCE_SHARE", 1e-13)
    table = done("force_step", EXACT, 40.0, [1.0], plants=2)
    assert (table["peak_mm"] < 1e-3).all()
    assert np.isfinite(table["recovery_s"]).all()


def test_offsets_at_rest_are_those_of_the_reading(monkeypatch):
    """With an integral a controller holds its reading on the reference, whatever the bias of the sensor is."""
    monkeypatch.setattr(experiments, "PLACES", (0.3,))
    config = TaskConfig()
    table = EXPERIMENTS["hold"]._replace(leaks=[0.3], plants=4)(config, shipped("pid", config))
    assert (table["offset_um"] < 10.0).all()  # biases reach 80 µm
    assert (table["unrest_um"] > 0.0).all()
    assert (table["valve_travel_per_s"] > 0.0).all()
    assert not table["failed"].any()


def test_a_broken_controller_loses_its_own_rows_only(monkeypatch):
    for name, experiment in EXPERIMENTS.items():
        monkeypatch.setitem(EXPERIMENTS, name, experiment._replace(plants=1))
    protocol = RobustnessProtocol(parts=PARTS, conditions={"plain": {}})
    good = Proportional(100.0, protocol.task)
    results = run(protocol, Participants({"P#0": good, "P#1": good, "broken": Constant(np.nan)}), jobs=1)
    assert {error.partition(":")[0] for error in results.errors} == {f"broken under {name}" for name in PARTS}
    tables = {name: results.table(name) for name in TABLES["experiments"]}
    assert_published("experiments", tables)
    assert all(set(table["controller"]) == {"P"} for table in tables.values())

    with parallel_config(backend="threading", n_jobs=2):
        alone = run(protocol, Participants({"P": good}))
    for name, table in tables.items():
        pd.testing.assert_frame_equal(alone.table(name), table, check_exact=True)
