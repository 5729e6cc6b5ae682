"""Frequency response and stiffness: against formulas and linearised loops; all experiments as parts of a protocol."""

from unittest import mock

import numpy as np
import pandas as pd
import pytest
from joblib import parallel_config
from proportional import Constant, Proportional, exact_task
from published import TABLES, assert_published

from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_agents.evaluation import experiments
from hydro_agents.evaluation.experiments import EXPERIMENTS, HiddenPreview, bandwidths, crossing, sine_fit
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.robustness_protocol import EXPERIMENTS as PARTS
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.runner import run
from hydro_agents.learning.opponents import shipped
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
    """Motions and forces (2 N) so small that a linearised loop describes them."""
    monkeypatch.setattr(experiments, "FREQUENCIES", (1.0, 4.0, 12.0, 30.0))
    monkeypatch.setattr(experiments, "AMPLITUDE_SHARE", 2.5e-5)
    monkeypatch.setattr(experiments, "FORCE_SHARE", 2.0 / min(force_limits(EXACT.plant)))


@pytest.mark.parametrize(("leak", "gain"), [(0.01, 60.0), (4.0, 100.0)])
def test_a_small_sweep_is_the_linearised_loop(leak, gain):
    task = exact_task(leakage={"law": "laminar"})
    table = done("frequency", task, gain, [leak])
    expected = loop_of(task, leak).response(gain, np.array(experiments.FREQUENCIES))
    for preview in (True, False):  # which this controller does not use
        own = table[table["preview"] == preview]
        answer = own["gain"] * np.exp(1j * np.deg2rad(own["phase_deg"]))
        np.testing.assert_allclose(answer, expected, rtol=0.02)
    assert (table["rest"] < 0.02).all()


def test_a_sine_is_fitted_beside_offset_and_drift():
    time = 5e-3 * np.arange(400)
    rows = np.stack([3.0 + 0.2 * time + 0.5 * np.cos(2 * np.pi * 4.0 * time - 1.0), np.zeros(400)])
    amplitude, rest = sine_fit(rows, time, 4.0)
    assert amplitude[0] == pytest.approx(0.5 * np.exp(-1j), abs=1e-12)
    assert amplitude[1] == 0.0
    np.testing.assert_allclose(rest, 0.0, atol=1e-12)


def test_bandwidths_of_a_first_order_lag():
    """It is −3 dB (exactly 1/√2: −3.01 dB) at its corner and never reaches −90°; with a dead time it does."""
    corner, frequency = 10.0, np.geomspace(0.5, 60.0, 200)
    answer = 1.0 / (1.0 + 1j * frequency / corner)
    rows = []
    for controller, dead_time in (("lag", 0.0), ("late", 0.01)):
        phase = np.rad2deg(np.unwrap(np.angle(answer * np.exp(-2j * np.pi * frequency * dead_time))))
        labels = {"controller": controller, "preview": False, "leakage_flow_lpm": 0.01, "seed": 0}
        rows.append(pd.DataFrame({"frequency_hz": frequency, "gain": np.abs(answer), "phase_deg": phase, **labels}))
    table = bandwidths(pd.concat(rows)).set_index("controller")
    assert table.loc["lag", "minus_3_db_hz"] == pytest.approx(corner, rel=3e-3)
    assert table.loc["lag", "minus_90_deg_hz"] == np.inf
    late = table.loc["late", "minus_90_deg_hz"]
    assert np.rad2deg(np.arctan(late / corner)) + 360.0 * late * 0.01 == pytest.approx(90.0, abs=0.1)


def test_crossings():
    frequency = np.array([1.0, 10.0, 100.0])
    assert crossing(frequency, np.array([0.0, -2.0, -4.0]), -3.0) == pytest.approx(10.0**1.5)
    assert crossing(frequency, np.array([-5.0, 0.0, 0.0]), -3.0) == 1.0
    assert crossing(frequency, np.array([0.0, 0.0, 0.0]), -3.0) == np.inf


def test_a_hidden_preview_shows_the_present_reference():
    watcher = mock.Mock(predict=lambda observation, *_: (observation, None))
    names = Proportional(1.0, EXACT).layout.names
    given = np.ones((2, len(names)), dtype=np.float32)
    seen, _ = HiddenPreview(watcher, EXACT).predict(given)
    np.testing.assert_array_equal(seen, np.tile([not name.startswith("reference_preview") for name in names], (2, 1)))
    assert seen.dtype == given.dtype
    assert given.all()  # the observation itself is untouched


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
    table = EXPERIMENTS["hold"]._replace(leaks=[0.3], plants=4)(config, HiddenPreview(shipped("pid", config), config))
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
