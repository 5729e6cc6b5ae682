"""The flow balance reads leak and valve from simulated signals, alone, and the features stand what rigs deliver."""

import numpy as np
import pytest

from agents.controllers import PID, ObservationLayout, PIDGains
from agents.leakage.balance import COUNT, INTERNAL, fit_balance
from agents.leakage.features import FEATURES, SIGNALS, features_of, repaired
from agents.leakage.sheet import Unknowns, sheet_of
from agents.running.cases import Cases, run_cases
from agents.running.seeds import TRAINING_SEEDS
from hydro_env import TaskConfig
from hydro_env.folders import config_file

CONFIG = TaskConfig(references={"weights": {"multi_sine": 1.0, "point_to_point": 1.0}})
LAYOUT = ObservationLayout.of(CONFIG)
COLUMNS = [LAYOUT.index(name) for name in SIGNALS]
SCALE = np.array([LAYOUT.scale[column] for column in COLUMNS])
CONTROLLER = PID(PIDGains.from_yaml(config_file("agents", "pid")), CONFIG)
FLOW = np.tile([0.01, 0.1, 1.0, 3.0], 12)
SHEET = sheet_of(CONFIG)


def simulated(config=CONFIG, **changes):
    seeds = TRAINING_SEEDS.start + 910_000 + np.arange(len(FLOW))
    run = run_cases(config, CONTROLLER, Cases(seeds, FLOW, **changes), COLUMNS, states=False)
    return run.signals.astype(np.float64) * SCALE[:, None]


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


def test_a_reading_that_stays_at_the_end_of_its_range_is_believed(signals):
    damaged = signals[:1].copy()
    damaged[0, 2, 100:200] = SHEET.sensor_low[2]
    whole = repaired(damaged, SHEET)
    np.testing.assert_array_equal(whole.signals, damaged)
    assert whole.lost[0, 2] == 0.0


def test_absent_and_frozen_sensors_show_in_the_features(signals):
    damaged = signals[:2].copy()
    damaged[0, 1] = np.nan
    damaged[1, 3, 200:] = damaged[1, 3, 200]
    values = features_of(damaged, SHEET)
    assert np.isfinite(values).all()
    assert values[0, FEATURES.index("lost samples of pressure_a")] > -0.01
    assert 10.0 ** values[1, FEATURES.index("longest standstill of spool_position")] > 0.45


def test_a_valve_without_dynamics_has_a_sheet_too():
    ideal = sheet_of(TaskConfig(plant={"valve": {"model": "ideal"}}))
    assert np.isfinite(ideal.transition).all()
    command, sample = np.array([0.2, 0.7]), ideal.transition[0, -1]
    np.testing.assert_allclose(sample[0] @ np.array([0.0, 0.0, 0.0, *command]), command[1], rtol=1e-6)
