"""A sensor that repeats one reading is told from one that works, at rest and at the ends of its range too."""

import numpy as np
import pytest

from hydro_agents.detection.damaged_signals import stuck_sensors
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS

CONFIG = TaskConfig()
FITTED = [getattr(CONFIG.sensors, name) for name in SENSORS]


def resting(windows=200, samples=400):
    """Readings (N, 5, T) of an axis at rest: noise in steps of the acquisition."""
    generator = np.random.default_rng(0)
    signals = np.zeros((windows, 5, samples))
    for row, sensor in enumerate(FITTED):
        middle = 0.5 * (sensor.low + sensor.high) + 0.1 * (sensor.high - sensor.low)
        noise = sensor.noise * generator.standard_normal((windows, samples))
        signals[:, row] = np.round((middle + noise) / sensor.resolution) * sensor.resolution
    return signals


def test_working_sensors_at_rest_are_not_stuck():
    assert not stuck_sensors(resting(), CONFIG).any()


@pytest.mark.parametrize("row", range(4))
def test_a_sensor_that_stops_is_found_and_no_other(row):
    signals = resting(3)
    signals[1, row, 350:] = signals[1, row, 350]  # for a quarter of a second
    signals[2, row, 100:115] = signals[2, row, 100]  # too short to count
    expected = np.zeros((3, 4), dtype=bool)
    expected[1, row] = True
    np.testing.assert_array_equal(stuck_sensors(signals, CONFIG), expected)


def test_the_ends_of_the_range_and_lost_samples_do_not_count():
    signals = resting(3)
    signals[0, 1] = FITTED[1].low  # a chamber that cavitates
    signals[1, 3] = FITTED[3].high  # the valve at full stroke
    signals[2, 2] = np.nan  # no such sensor
    assert not stuck_sensors(signals, CONFIG).any()


@pytest.mark.parametrize("sensors", [{"enabled": False}, {"position": {"noise": 0.0}}])
def test_a_sensor_without_noise_may_repeat_its_reading(sensors):
    signals = resting(1)
    signals[:, 0] = 0.02
    assert not stuck_sensors(signals, task_config(CONFIG, sensors=sensors)).any()
