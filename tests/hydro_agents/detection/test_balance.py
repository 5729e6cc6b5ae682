"""The flow balance reads leak and valve from simulated signals alone; lost samples and stuck sensors are found."""

from pathlib import Path

import numpy as np
import pytest

from hydro_agents import detection
from hydro_agents.detection.balance import COUNT, INTERNAL, OVERLAP, PARTS, TRACED, fit, fit_balance
from hydro_agents.detection.balance_parts import factor, hold, substitute
from hydro_agents.detection.damaged_signals import repair, repaired, stuck_sensors
from hydro_agents.detection.detector import measured_run
from hydro_agents.detection.features import CHANGE, FEATURES, describe, features_of
from hydro_agents.detection.operations import ACTING
from hydro_agents.detection.sheet import Unknowns, sheet_of
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import TRAINING_SEEDS
from hydro_env import TaskConfig
from hydro_env.compiling import digest_of_sources
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS, SPOOL

CONFIG = TaskConfig(references={"weights": {"multi_sine": 1.0, "point_to_point": 1.0}})
CONTROLLER = shipped("pid", CONFIG)
FLOW = np.tile([0.01, 0.1, 1.0, 3.0], 12)
SHEET = sheet_of(CONFIG)
FITTED = [getattr(CONFIG.sensors, name) for name in SENSORS]


def simulated(config=CONFIG, **changes):
    seeds = TRAINING_SEEDS.start + 910_000 + np.arange(len(FLOW))
    return measured_run(config, CONTROLLER, Cases(seeds, FLOW, **changes))[0]


@pytest.fixture(scope="module")
def signals():
    return simulated()


def test_leaks_are_read_with_the_deviation_that_is_told(signals):
    balance = fit_balance(signals, SHEET)
    error = balance.estimate[:, INTERNAL] - FLOW
    assert np.median(np.abs(error)) < 0.03
    assert np.quantile(np.abs(error), 0.9) < 0.15
    assert np.mean(np.abs(error) < 4.0 * balance.deviation[:, INTERNAL]) > 0.8
    assert 0.5 < np.median(balance.misfit[:, 0]) < 1.5


@pytest.mark.parametrize(
    ("fault", "size", "unknown", "tolerance"),
    [("valve_null_shift", 0.015, "null", 0.004), ("valve_underlap", 0.04, "underlap", 0.008)],
)
def test_a_worn_valve_is_read_as_such_and_not_as_a_leak(signals, fault, size, unknown, tolerance):
    faulty = fit_balance(simulated(faults={fault: np.full(len(FLOW), size)}), SHEET)
    sound = fit_balance(signals, SHEET)
    column = Unknowns._fields.index(unknown)
    change = np.median(faulty.estimate[:, column] - sound.estimate[:, column])
    assert change == pytest.approx(size, abs=tolerance)
    assert np.median(np.abs(faulty.estimate[:, INTERNAL] - FLOW)) < 0.05


@pytest.mark.parametrize(
    "valve",
    [
        {"overlap": -0.0075, "underlap": 0.0},  # the sharp edges of a textbook
        {"overlap": 0.03, "underlap": 0.002},
        {"overlap": -0.0075, "underlap": 0.0, "edge_ratio": 0.7, "knee_position": 0.4, "knee_opening": 0.25},
    ],
)
def test_leaks_are_read_behind_any_edges_and_the_lap_is_found(valve):
    config = task_config(CONFIG, plant={"valve": valve}, randomisation={"valve.underlap": None})
    told = valve | {"overlap": max(valve["overlap"], 0.0)}  # a nameplate does not tell a negative lap
    sheet = sheet_of(task_config(CONFIG, plant={"valve": told}), for_any_axis=True)
    balance = fit_balance(simulated(config), sheet)
    assert np.median(np.abs(balance.estimate[:, INTERNAL] - FLOW)) < 0.05
    assert np.median(balance.estimate[:, OVERLAP]) == pytest.approx(valve["overlap"], abs=0.003)


def test_no_leak_is_negative_and_each_part_of_the_window_reads_the_same_constant_leak(signals):
    balance = fit_balance(signals, SHEET)
    assert (balance.estimate[:, INTERNAL] >= 0.0).all()
    assert balance.part.shape == (len(FLOW), TRACED, PARTS)
    off = np.abs(balance.part[:, 0] - balance.estimate[:, INTERNAL, None])
    assert np.median(off / balance.part_deviation[:, 0]) < 2.0
    assert np.median(off[FLOW == 1.0]) < 0.05


def test_the_parts_of_the_window_tell_that_a_leak_begins(signals):
    config = task_config(CONFIG, leakage={"schedule": "onset", "start_range": (0.5, 0.5)})
    begun = simulated(config)[FLOW == 1.0]
    parts = fit_balance(begun, SHEET).part[:, 0]
    half = PARTS // 2
    assert np.mean(parts[:, half:].mean(axis=1) > parts[:, :half].mean(axis=1)) > 0.8
    change, constant = (features_of(each, SHEET)[:, CHANGE] for each in (begun, signals[FLOW == 1.0]))
    assert np.mean(change) > np.mean(constant) + 0.5  # decades


def test_normal_equations_against_numpy():
    generator = np.random.default_rng(0)
    root = generator.standard_normal((4, 4))
    matrix, right = root @ root.T + np.eye(4), generator.standard_normal(4)
    lower, free = matrix.copy(), right.copy()
    factor(lower)
    substitute(lower, free)
    np.testing.assert_allclose(free, np.linalg.solve(matrix, right))
    lower, held = matrix.copy(), right.copy()
    hold(lower, held, 2, 0.7)
    factor(lower)
    substitute(lower, held)
    others = [0, 1, 3]
    expected = np.linalg.solve(matrix[np.ix_(others, others)], right[others] - 0.7 * matrix[others, 2])
    np.testing.assert_allclose(held[others], expected)
    assert held[2] == pytest.approx(0.7)


def test_a_window_that_says_nothing_leaves_the_priors():
    signals = np.zeros((1, 5, 100))
    signals[:, 1:3] = 30e5
    balance = fit_balance(signals, SHEET)
    assert balance.estimate.shape == (1, COUNT)
    assert np.isfinite(balance.estimate).all()
    assert balance.deviation[0, INTERNAL] > 0.3 * SHEET.spread[INTERNAL]


def test_each_window_is_read_by_itself(signals):
    together, alone = features_of(signals, SHEET), features_of(signals[5:6], SHEET)
    assert together.shape == (len(FLOW), len(FEATURES))
    assert np.isfinite(together).all()
    np.testing.assert_allclose(together[5:6], alone, rtol=1e-5, atol=1e-5)


def test_lost_samples_are_filled_and_counted(signals):
    damaged = signals[:3].copy()
    damaged[0, 0, 10:14] = np.nan
    damaged[1, 2, 50] = SHEET.sensor_low[2]  # a broken current loop reads the lower end of the range
    damaged[2, 1, :3] = np.nan
    whole = repaired(damaged, SHEET)
    assert np.isfinite(whole.signals).all()
    np.testing.assert_array_equal(whole.signals[0, 0, 10:14], signals[0, 0, 9])
    assert whole.signals[1, 2, 50] == signals[1, 2, 49]
    np.testing.assert_array_equal(whole.signals[2, 1, :3], signals[2, 1, 3])
    samples = signals.shape[2]
    np.testing.assert_allclose(whole.lost[[0, 1, 2], [0, 2, 1]], [4 / samples, 1 / samples, 3 / samples])


def resting(windows=200, samples=400):
    """Readings (N, 5, T) of an axis at rest: noise in steps of the acquisition."""
    generator = np.random.default_rng(0)
    signals = np.zeros((windows, 5, samples))
    for row, sensor in enumerate(FITTED):
        middle = 0.5 * (sensor.low + sensor.high) + 0.1 * (sensor.high - sensor.low)
        noise = sensor.noise * generator.standard_normal((windows, samples))
        signals[:, row] = np.round((middle + noise) / sensor.resolution) * sensor.resolution
    return signals


@pytest.mark.parametrize("row", [0, 3])
def test_a_sensor_that_stops_is_found_and_no_other(row):
    signals = resting(3)
    signals[1, row, 350:] = signals[1, row, 350]  # for a quarter of a second
    signals[2, row, 100:115] = signals[2, row, 100]  # too short to count
    expected = np.zeros((3, 4), dtype=bool)
    expected[1, row] = True
    np.testing.assert_array_equal(stuck_sensors(signals, CONFIG), expected)


def test_working_sensors_the_ends_of_the_range_and_lost_samples_are_not_stuck():
    assert not stuck_sensors(resting(), CONFIG).any()
    signals = resting(3)
    signals[0, 1] = FITTED[1].low  # a chamber that cavitates
    signals[1, 3] = FITTED[3].high  # the valve at full stroke
    signals[2, 2] = np.nan  # no such sensor
    assert not stuck_sensors(signals, CONFIG).any()


def test_without_a_spool_sensor_the_nominal_valve_answers_the_commands():
    task = task_config(randomisation={}, sensors={"enabled": False})
    seeds = TRAINING_SEEDS.start + 945_000 + np.arange(3)
    signals, _ = measured_run(task, ACTING["dithering"](task, 3, 0), Cases(seeds))
    blind = signals.copy()
    blind[:, SPOOL] = np.nan
    filled, lost = repaired(blind, sheet_of(task))
    assert lost[:, SPOOL].tolist() == [1.0, 1.0, 1.0]
    assert np.ptp(signals[:, SPOOL]) > 0.05
    np.testing.assert_allclose(filled[:, SPOOL], signals[:, SPOOL], atol=2e-3)
    np.testing.assert_array_equal(np.delete(filled, SPOOL, axis=1), np.delete(signals, SPOOL, axis=1))


def test_a_kernel_depends_on_the_files_that_it_calls():
    sources = digest_of_sources(Path(detection.__file__).parent)
    for kernel in (fit, repair, describe):
        assert sources in [cell.cell_contents for cell in kernel.py_func.__closure__]
