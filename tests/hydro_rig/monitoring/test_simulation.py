"""Axes at work: references, looks that depend on seeds alone, onsets from one past, files that are resumed."""

from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.detection.detector import SIGNALS, Reading
from hydro_agents.detection.looks import Activity, activity_of, looks_at
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_rig.monitoring.alarm_simulation import Bench, Work, simulate, working_references

CONFIG = TaskConfig()
CONTROLLER = PID(PIDGains(proportional=60.0), CONFIG)
WORK = Work(first_seed=1_900_000, axes=3, duration=4.0, interval=0.5, after=3.0)


class MeanPressure:
    """A detector whose score is the mean pressure of chamber a in bar."""

    threshold, window = None, 200

    def refuses(self, task, samples):
        return "" if task.control_period == 0.005 else "reads one sample in 5 ms"

    def read(self, windows, task):
        return Reading.of(1e-5 * windows.signal("pressure_a").mean(axis=1))


def position(travel, count=400):
    signals = np.zeros((1, len(SIGNALS), count))
    signals[0, SIGNALS.index("position")] = travel
    return signals


def test_activity_is_the_travel_of_a_window():
    noise = 30e-6 * np.random.default_rng(0).normal(size=400)
    creep, move = np.linspace(0.0, 2e-3, 400), 0.05 * np.sin(np.linspace(0.0, 20.0, 400))
    kinds = [int(activity_of(position(row + noise), 0.005)[0]) for row in (np.zeros(400), creep, move)]
    assert kinds == [Activity.STANDING, Activity.SLOW, Activity.MOVING]
    move[::7] = np.nan
    assert activity_of(position(move), 0.005)[0] == Activity.MOVING
    assert activity_of(position(np.full(400, np.nan)), 0.005)[0] == Activity.STANDING


def test_references_of_work_stay_reachable_and_continuous():
    config = TaskConfig(episode_duration=120.0)
    seeds = np.arange(5)
    rows = working_references(config, seeds)
    assert rows.shape[0] == 5
    assert np.abs(rows).max() <= 0.5 * config.plant.cylinder.stroke
    jumps = np.abs(np.diff(rows, axis=1))
    largest_step = config.references.step_range[1]
    assert jumps.max() <= largest_step + 1e-9
    assert (np.abs(rows[:, 4000:] - rows[:, :-4000]).max(axis=1) > 1e-3).all(), "every axis moves"
    np.testing.assert_array_equal(rows[2], working_references(config, seeds[2:3])[0])


@pytest.fixture(scope="module")
def looks():
    return simulate(CONFIG, CONTROLLER, MeanPressure(), replace(WORK, leaks=(2.0, 0.01, 2.0)))


def test_each_leak_goes_on_from_the_same_past(looks):
    before, leak, tight, again = looks
    np.testing.assert_allclose(before.time, np.arange(0.995, 4.0, 0.5))
    np.testing.assert_allclose(leak.time, np.arange(4.495, 7.0, 0.5))
    assert (before.true_flow_lpm <= 0.03).all()
    assert (leak.true_flow_lpm == 2.0).all()
    assert (tight.true_flow_lpm == 0.01).all()
    np.testing.assert_array_equal(leak.score, again.score)
    assert (leak.score != tight.score).all()


def test_looks_depend_on_the_seed_alone(looks):
    other = simulate(CONFIG, CONTROLLER, MeanPressure(), Work(1_900_001, 1, 4.0, 0.5))[0]
    np.testing.assert_array_equal(other.score[0], looks[0].score[1])


def test_a_rig_without_a_sensor_shows_nothing_in_its_place():
    config = TaskConfig(sensors={"pressure_a": {"fitted": False}})
    controller = PID(PIDGains(proportional=60.0), config)
    found = simulate(config, controller, MeanPressure(), Work(1_900_000, 1, 1.5, 0.5))[0]
    assert np.isnan(found.score).all()


def test_recorded_looks_equal_those_of_the_running_axes():
    config = TaskConfig(episode_duration=10.0)
    env = ServoHydraulicVectorEnv(2, config, info=False)
    seeds = [WORK.first_seed, WORK.first_seed + 1]
    flow = [np.exp(np.random.default_rng([seed, 2]).uniform(*np.log(config.leakage.healthy_range))) for seed in seeds]
    options = {"reference": working_references(config, np.array(seeds)), "leakage_flow_lpm": flow}
    observation, _ = env.reset(seed=seeds, options=options)
    columns = [env.observation_names.index(name) for name in SIGNALS]
    signals, memory = [], None
    for step in range(800):
        signals.append(observation[:, columns] * env.observation_scale[columns])
        action, memory = CONTROLLER.predict(observation, memory, np.full(2, step == 0), True)
        observation, *_ = env.step(action)
    env.close()
    recorded = looks_at(np.stack(signals, axis=2), config, MeanPressure(), 0.5)
    lived = simulate(CONFIG, CONTROLLER, MeanPressure(), WORK)[0]
    np.testing.assert_allclose(recorded.time, lived.time)
    np.testing.assert_array_equal(recorded.score, lived.score[:2])
    np.testing.assert_array_equal(recorded.activity, lived.activity[:2])


def test_finished_looks_are_read_again_and_those_of_another_detector_are_not(tmp_path):
    def looks(detector, *leaks):
        done = []
        bench = Bench(CONFIG, [CONTROLLER], detector, "", tmp_path, lambda *now: done.append(now[1]))
        return bench.looks("a", Work(1_900_000, 2, 2.0, 0.5, 1.0, leaks)), done[0]

    first, reused = looks(MeanPressure(), 1.0)
    assert (len(first), reused) == (2, 0)
    again, reused = looks(MeanPressure(), 1.0)
    assert reused == 1
    for one, two in zip(first, again, strict=True):
        for left, right in zip(one, two, strict=True):
            np.testing.assert_array_equal(left, right)
    assert looks(MeanPressure())[1] == 0
    other = MeanPressure()
    other.window = 100
    assert looks(other, 1.0)[1] == 0


def test_controllers_take_turns_over_the_axes():
    slower = PID(PIDGains(proportional=10.0), CONFIG)
    work = Work(1_900_000, 4, 2.0, 0.5)
    (both,) = Bench(CONFIG, [CONTROLLER, slower], MeanPressure(), "").looks("a", work)
    (alone,) = Bench(CONFIG, [slower], MeanPressure(), "").looks("a", work)
    np.testing.assert_array_equal(both.score[2:], alone.score[2:])
    assert (both.score[:2] != alone.score[:2]).any()


def test_too_short_work_and_recordings_are_refused():
    with refused(r"work of 0.5 s is shorter than a window of 1 s"):
        simulate(CONFIG, CONTROLLER, MeanPressure(), Work(0, 1, 0.5, 0.5))
    with refused(r"recording of 0.5 s is shorter than a window of 1 s"):
        looks_at(np.zeros((1, 5, 100)), CONFIG, MeanPressure(), 0.5)
    with refused("shape"):
        looks_at(np.zeros((5, 400)), CONFIG, MeanPressure(), 0.5)
    with refused("alarm: reads one sample in 5 ms"):
        looks_at(np.zeros((1, 5, 400)), TaskConfig(control_period=0.01), MeanPressure(), 0.5)
