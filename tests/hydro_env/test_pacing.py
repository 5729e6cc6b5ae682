"""A window follows simulated time: a clock that the test turns takes the place of the real one."""

import gymnasium as gym
import pytest

import hydro_env  # noqa: F401
from hydro_env.pacing import BETWEEN_FRAMES, BETWEEN_LATE_FRAMES, Pace

PERIOD = 0.005


class Clock:
    def __init__(self):
        self.now, self.slept = 100.0, 0.0

    def __call__(self):
        return self.now

    def sleep(self, duration):
        self.now += duration
        self.slept += duration


def shown(clock, samples, work):
    """Sample times that are drawn, where each drawing takes ``work`` seconds."""
    pace, times = Pace(clock, clock.sleep), []
    pace.begin()
    for k in range(samples):
        if pace.due(k * PERIOD):
            times.append(k * PERIOD)
            clock.now += work
    return times


def test_a_fast_machine_waits_until_each_frame_is_due():
    clock = Clock()
    times = shown(clock, 401, 0.002)
    assert times == pytest.approx([k * BETWEEN_FRAMES for k in range(101)])
    assert clock.now == pytest.approx(102.0 + 0.002)  # two simulated seconds took two seconds


def test_a_slow_machine_draws_fewer_frames_and_keeps_up():
    clock = Clock()
    times = shown(clock, 401, 0.06)
    assert clock.now == pytest.approx(102.0, abs=BETWEEN_LATE_FRAMES)
    assert 15 < len(times) < 45


def test_a_new_episode_begins_at_once_and_after_a_pause_the_window_goes_on_in_real_time():
    clock = Clock()
    pace = Pace(clock, clock.sleep)
    for _ in range(2):
        pace.begin()
        assert pace.due(0.0)
        assert not pace.due(PERIOD)
    assert clock.slept == 0.0
    clock.now += 60.0
    assert pace.due(0.1)
    assert pace.due(0.2)
    assert clock.now == pytest.approx(160.1)


def test_recorders_of_each_step_take_the_rate_of_the_steps():
    with gym.make("ServoHydraulic-v0", control_period=0.01, render_mode="rgb_array") as env:
        assert env.metadata["render_fps"] == 100
