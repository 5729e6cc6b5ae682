"""Intervals of an identification: scatter of the windows, limits that no motion reached, physical bounds."""

import numpy as np
import pytest
from recorded import recorded_file

from hydro_agents.detection.detector import Windows
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS
from hydro_rig.estimation.solver import Problem
from hydro_rig.identification.common_fit import Joint
from hydro_rig.identification.fit import fit_windows, possible_ends, spread_of, truncated_end, within_bounds
from hydro_rig.identification.found_rig import found_values, narrowed
from hydro_rig.recordings.recording import read_recording

WINDOWS, UNKNOWNS, READINGS = 7, 6, 40


def joint_of(found, information, score):
    """The common fit of windows without unknowns of their own."""
    count, places = len(score), np.arange(len(found))
    return Joint(np.tile(found, (count, 1)), places, information, score, np.ones(count))


def fit_of(path, config, cut, task=None):
    """The fit of ``cut``, (windows, samples), of a recording of the task, with another task if one is given."""
    recorded_file(path, config, 0.3, family="multi_sine", duration=config.episode_duration)
    count, samples = cut
    signals = read_recording(path).signals[:, : count * samples].reshape(5, count, samples).transpose(1, 0, 2)
    return fit_windows(Windows.of(signals), task or config, config.randomisation, np.zeros(count, np.int64))


def linear_fit(random, jacobian, disturbed=0.0):
    """A linear model of windows whose first unknown differs from window to window; its fit, and the truth."""
    true = random.standard_normal(UNKNOWNS)
    own = true + disturbed * random.standard_normal((WINDOWS, 1)) * np.eye(UNKNOWNS)[0]
    readings = np.einsum("wpr,wp->wr", jacobian, own) + random.standard_normal((WINDOWS, READINGS))
    information = jacobian @ jacobian.transpose(0, 2, 1)
    towards = np.einsum("wpr,wr->wp", jacobian, readings)
    found = np.linalg.solve(information.sum(axis=0) + np.eye(UNKNOWNS), towards.sum(axis=0))
    return joint_of(found, information, towards - information @ found), true


@pytest.fixture(scope="module")
def jacobian():
    """Derivatives of few windows, of which one tells most about the last unknown."""
    jacobian = 0.5 * np.random.default_rng(0).standard_normal((WINDOWS, UNKNOWNS, READINGS))
    jacobian[1:, -1] *= 0.05
    return jacobian


def coverage(jacobian, disturbed, runs=600):
    random = np.random.default_rng(1)
    inside, widening = np.zeros(UNKNOWNS), []
    for _ in range(runs):
        joint, true = linear_fit(random, jacobian, disturbed)
        spread = spread_of(joint)
        inside += np.abs(true - joint.common) <= spread.reach
        widening.append(spread.widening)
    return inside / runs, np.median(widening, axis=0)


def test_intervals_hold_as_often_as_they_promise_where_noise_is_all(jacobian):
    inside, widening = coverage(jacobian, 0.0)
    assert (inside > 0.93).all(), inside  # a variance is never below the noise's: they hold rather more often
    assert inside.mean() < 0.985, inside
    assert (widening < 1.2).all()


@pytest.mark.parametrize(("shift", "before", "after"), [(0.0, 0.9, 0.9), (2.0, 0.0, 0.85)])
def test_intervals_are_as_wide_as_recordings_disagree(shift, before, after):
    random, recording = np.random.default_rng(2), np.repeat(np.arange(6), 4)
    held, once, wider = 0, 0, []
    for _ in range(200):
        own = 0.1 * shift * random.standard_normal((6, 1))[recording] * np.eye(3)[0]
        information = np.tile(400.0 * np.eye(3), (24, 1, 1))
        towards = np.einsum("wij,wj->wi", information, own) + 20.0 * random.standard_normal((24, 3))
        found = np.linalg.solve(information.sum(axis=0) + np.eye(3), towards.sum(axis=0))
        joint = joint_of(found, information, towards - information @ found)
        alone, together = spread_of(joint).reach, spread_of(joint, recording).reach
        once += abs(found[0]) <= alone[0]
        held += abs(found[0]) <= together[0]
        wider.append(together / alone)
    assert once / 200 >= before
    assert held / 200 >= after
    assert (np.median(wider, axis=0)[1:] < 1.3).all()  # of the unknowns on which they agree
    assert (np.median(wider, axis=0)[0] > 1.5) == (shift > 0.0)


def test_a_direction_that_windows_contradict_widens_its_own_unknown(jacobian):
    inside, widening = coverage(jacobian, 1.0)
    assert inside[0] > 0.85, inside
    assert widening[0] > 1.4
    assert (widening[1:] < 1.25).all(), widening
    assert (inside[1:] > 0.93).all(), inside


class Saturating:
    """Readings of two unknowns: the first acts only below 0.5, like a limit that the motion never reached."""

    count = WINDOWS

    def __init__(self, edge=0.5):
        self.edge = edge
        self.time = np.linspace(-1.0, 1.0, READINGS)

    def readings(self, scaled, samples=None):
        limit, gain = np.minimum(scaled[:, 0], self.edge), scaled[:, 1]
        return (20.0 * limit[:, None] * self.time + 20.0 * gain[:, None])[:, None]


def fit_at(model, limit):
    """The fit at a value of the limit; its slope is that of differences to both sides."""
    scaled = np.tile([limit, 0.3], (WINDOWS, 1))
    measured = model.readings(scaled)
    slope = 0.5 * (1.0 if limit < model.edge else 0.0) + 0.5 * (1.0 if limit <= model.edge else 0.0)
    jacobian = np.tile(20.0 * np.stack([slope * model.time, np.ones(READINGS)]), (WINDOWS, 1, 1))
    information = jacobian @ jacobian.transpose(0, 2, 1)
    return Problem(model, measured), joint_of(scaled[0], information, np.zeros((WINDOWS, 2)))


def test_a_limit_that_was_never_reached_may_lie_at_the_end_of_its_range():
    ends = np.array([[-1.0, 2.0], [-np.inf, np.inf]])
    for edge, possible in ((0.5, True), (3.0, False)):  # with the second the limit acts
        problem, joint = fit_at(Saturating(edge), 0.5)
        found = possible_ends(problem, joint, spread_of(joint), ends)
        assert found.tolist() == [[False, possible], [False, False]]


def test_intervals_end_at_physical_bounds():
    bounded = {"leakage_flow_lpm": (-0.2, 0.0), "pressure_a_bias": (-2e5, -2e5), "load.viscous_damping": (-3.0, 0.0)}
    for name, (value, expected) in (bounded | {"load.mass": (50.0, 50.0)}).items():
        assert within_bounds(name, value) == expected
    assert truncated_end(0.5, 0.3, 0.7) == 0.7
    assert 0.0 < truncated_end(-0.2, -0.4, 0.0) < 0.2  # a size below zero leaves a small one possible


def test_a_rise_time_that_the_task_does_not_say_is_found(tmp_path):
    """With transducers of 4 ms in the task instead of 1.5 ms the model explains no window; then it finds their time."""
    config = task_config("as_given", randomisation={"load.mass": {"factor": [0.8, 1.2]}}, episode_duration=4.0)
    wrong = task_config(config, sensors={"pressure_rise_time": 4e-3})
    fit = fit_of(tmp_path / "a.csv", config, (4, 200), wrong)
    assert fit.explained.all()
    timing = fit.own()
    assert timing["pressure_rise_time"] == pytest.approx(config.sensors.pressure_rise_time, rel=0.1)
    assert timing["command_latency"] == pytest.approx(config.command_latency, abs=1e-4)
    assert fit.unknowns[0].low <= 0.3 <= fit.unknowns[0].high


@pytest.mark.parametrize("latency", [1e-3, 3e-3], ids=["timely", "late"])
def test_the_noise_of_a_channel_that_scatters_more_than_its_data_sheet_is_found(latency, tmp_path):
    """Before, one such channel left every window unexplained, and nothing was determined."""
    config = task_config("as_given", randomisation={"load.mass": {"factor": [0.8, 1.2]}}, episode_duration=4.0)
    noise = 1.6 * config.sensors.pressure_b.noise
    rig = task_config(config, sensors={"pressure_b": {"noise": noise}}, command_latency=latency)
    fit = fit_of(tmp_path / "a.csv", rig, (4, 200), config)
    assert fit.explained.all()
    np.testing.assert_allclose(fit.noise, np.where(np.array(SENSORS) == "pressure_b", 1.6, 1.0), rtol=0.05)
    assert fit.own().get("command_latency", config.command_latency) == pytest.approx(latency, abs=1e-4)
    assert fit.unknowns[0].low <= 0.3 <= fit.unknowns[0].high


def test_a_slew_limit_above_the_spools_speed_is_not_determined(tmp_path):
    """In slow moves the spool stays far below its limit: the file keeps its value and its range."""
    ranges = {"valve.slew_limit": {"log_factor": [0.05, 2.0]}}
    config = task_config("as_given", randomisation=ranges, episode_duration=5.0)
    fit = fit_of(tmp_path / "a.csv", config, (4, 200))
    by_name = {one.name: one for one in fit.unknowns}
    assert not fit.knows(by_name["valve.slew_limit"])
    assert fit.knows(by_name["leakage_flow_lpm"])
    own = config.plant.valve.slew_limit
    assert found_values(fit, config)["valve.slew_limit"] == pytest.approx(own)
    kept = narrowed(fit, config, config.randomisation)["valve.slew_limit"]["log_uniform"]
    assert kept == pytest.approx([0.05 * own, 2.0 * own], rel=1e-4)
