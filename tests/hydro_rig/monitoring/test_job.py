"""The whole job on made-up looks: settings and tables; the detectors; bad options of the command."""

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro
from refusal import refused
from untrained import untrained_head

from hydro_agents.detection.detector import HALF_WIDTH, SIGNALS, Cause, Reading, Why, Windows
from hydro_agents.detection.looks import Activity, Looks
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.detection.operations import ACTING, at_rest
from hydro_env import TaskConfig
from hydro_rig.estimation.known_windows import known_windows, leak_cases
from hydro_rig.estimation.two_stage import TwoStageDetector
from hydro_rig.monitoring import alarm_job
from hydro_rig.monitoring.alarm_job import AlarmJob, run_job

CONFIG = TaskConfig()
JOB = AlarmJob(axes=12)


class MadeUp:
    """A bench with made-up looks: the score is white noise and rises by 4 per 0.1 l/min while the axis moves."""

    detector_name, detector, config = "made up", None, CONFIG

    def __init__(self, rise=4.0):
        self.rise = rise

    def looks(self, name, work):
        generator = np.random.default_rng(len(name))
        parts = [self._part(generator, work, 0.0, work.duration, 0.01)]
        return parts + [self._part(generator, work, work.duration, work.duration + work.after, x) for x in work.leaks]

    def _part(self, generator, work, begin, end, leak):
        time = np.arange(begin, end, work.interval) + 0.5
        shape = (work.axes, len(time))
        flow, cause = np.full(shape, leak), np.full(shape, Cause.NONE, dtype=np.int8)
        activity = np.tile(np.arange(len(time)) // 10 % 3, (work.axes, 1)).astype(np.int8)
        score = generator.normal(0.0, 1.0, shape) + self.rise * flow / 0.1 * (activity == Activity.MOVING)
        seen = flow * 10.0 ** generator.normal(0.0, 0.02, shape)
        return Looks(time, score, np.full(shape, np.nan), seen, cause, activity, flow)


@pytest.fixture(autouse=True)
def short_shifts(monkeypatch):
    """Hours in place of shifts, and fewer of them."""
    monkeypatch.setattr(alarm_job, "SHIFT_HOURS", 2.0)
    monkeypatch.setattr(alarm_job, "COPIES", 10)


def test_the_job_finds_settings_and_tests_them():
    settings, tables = run_job(MadeUp(), JOB)
    assert settings.false_alarms_per_100_h == 1.0
    assert settings.interval == 4.0
    # The healthy axes leak by 0.01, and the alarm is designed for 0.05 in motion.
    assert settings.table("shift") == pytest.approx([0.0, 0.0, 1.6], abs=0.5)
    shift = tables["shift"].set_index(["begins", "leak_lpm"])
    assert (shift["missed"] == 0.0).all()
    assert shift.loc[("after a healthy shift", 0.3), "median_minutes"] < 10.0
    rates = tables["false_alarms"].set_index("threshold")
    assert rates["per_100_h"].is_monotonic_decreasing
    assert rates.loc[1.0, "hours"] == 12 * 4 * 10


def test_rare_answers_at_rest_are_compared_as_sizes():
    made_up = MadeUp()
    made_up.detector = TwoStageDetector(HeadDetector(untrained_head(CONFIG)))
    still = run_job(made_up, JOB)[0].scales.standing
    assert still.learning == 0
    assert still.highest_baseline == CONFIG.leakage.class_bounds[0]
    assert still.shift == pytest.approx(0.1 - still.highest_baseline)


def test_a_detector_that_sees_nothing_is_refused():
    with refused("score of 'made up' does not rise"):
        run_job(MadeUp(rise=-4.0), JOB)


def test_the_head_is_a_detector_that_stands_lost_samples():
    head = untrained_head(CONFIG)
    detector = HeadDetector(head)
    signals = np.random.default_rng(1).normal(0.0, 0.3, (3, len(SIGNALS), detector.window)) * head.scale[:, None]
    signals[2, 1, 50] = np.nan
    found, expected = detector.read(Windows.of(signals), CONFIG), head.estimate_windows(signals)
    np.testing.assert_allclose(1.0 / (1.0 + np.exp(-found.score)), expected.probability, rtol=1e-6)
    np.testing.assert_array_equal(found.flow_lpm, expected.flow_lpm)
    np.testing.assert_array_equal(found.cause == Cause.UNKNOWN, expected.outside > 0.0)
    np.testing.assert_array_equal(found.answers, expected.outside == 0.0)


class Says:
    """A detector with given answers, which counts the windows that it reads."""

    threshold, window = 0.0, 400

    def __init__(self, score, cause, size, sigma=np.nan):
        self.score, self.cause, self.size, self.sigma, self.read_windows = score, cause, size, sigma, 0

    def read(self, windows, task):
        del task
        count = len(windows)
        self.read_windows += count
        half = HALF_WIDTH * self.sigma
        sizes = {"flow_lpm": self.size, "low_lpm": self.size - half, "high_lpm": self.size + half}
        known = {name: np.full(count, value) for name, value in sizes.items()}
        return Reading.of(np.full(count, self.score), np.full(count, self.cause), **known)


def two_stages(head, estimator):
    detector = TwoStageDetector(HeadDetector(untrained_head(CONFIG)), estimator)
    head.on = detector.head.on
    detector.head = head
    return detector


def windows_at(end, speed, count=2):
    signals = np.zeros((count, len(SIGNALS), 400))
    signals[:, 0] = speed * np.arange(400) * CONFIG.control_period
    return Windows(signals, np.full(count, end - 2.0), np.full(count, end))


def test_the_head_answers_in_motion_and_the_estimator_at_rest_once_a_minute():
    head, estimator = Says(-4.0, Cause.NONE, 0.01), Says(3.0, Cause.NONE, 0.2, 0.03)
    detector = two_stages(head, estimator)
    moving = detector.read(windows_at(2.0, 0.1), CONFIG)
    assert moving.score.tolist() == [0.01, 0.01]
    assert np.isnan(moving.sigma).all()
    assert estimator.read_windows == 0
    resting = detector.read(windows_at(4.0, 0.0), CONFIG)
    assert resting.score.tolist() == [0.2, 0.2]
    assert resting.sigma == pytest.approx([0.03, 0.03])
    soon = detector.read(windows_at(60.0, 0.0), CONFIG)
    assert np.isnan(soon.score).all()
    assert soon.cause.tolist() == [Cause.UNDETERMINED] * 2
    assert estimator.read_windows == 2
    assert detector.read(windows_at(64.0, 0.0), CONFIG).answers.all()
    assert detector.read(windows_at(2.0, 0.0), CONFIG).answers.all(), "time went back: other axes"
    assert estimator.read_windows == 6


def test_in_doubt_the_estimator_has_the_last_word_for_a_minute():
    head, estimator = Says(-4.0, Cause.RETURN_LINE, 0.01), Says(3.0, Cause.SENSOR, 0.02, 0.01)
    detector = two_stages(head, estimator)
    first = detector.read(windows_at(2.0, 0.1), CONFIG)
    assert (first.score[0], first.cause[0]) == (0.02, Cause.SENSOR)
    second = detector.read(windows_at(6.0, 0.1), CONFIG)
    assert (second.score[0], second.cause[0]) == (0.01, Cause.SENSOR), "the head's size, the estimator's cause"
    assert detector.read(windows_at(2.0, 0.1, 3), CONFIG).cause.tolist() == [Cause.SENSOR] * 3
    clears = two_stages(head, Says(3.0, Cause.NONE, 0.02, 0.01))
    read = [clears.read(windows_at(end, 0.1), CONFIG).cause[0] for end in (2.0, 6.0)]
    assert read == [Cause.NONE, Cause.RETURN_LINE], "it answers for its own window only"
    unsure = two_stages(head, Says(np.nan, Cause.UNKNOWN, np.nan))
    assert unsure.read(windows_at(2.0, 0.1), CONFIG).cause.tolist() == [Cause.RETURN_LINE] * 2
    stuck = two_stages(Says(np.nan, Cause.SENSOR, 0.5), Says(np.nan, Cause.UNKNOWN, np.nan))
    found = stuck.read(windows_at(2.0, 0.1), CONFIG)
    assert found.cause.tolist() == [Cause.SENSOR] * 2
    assert not found.answers.any()
    wide = two_stages(head, Says(0.1, Cause.UNDETERMINED, 0.1, 0.2)).read(windows_at(2.0, 0.0), CONFIG)
    assert wide.answers.all(), "a wide answer says little, but says it"


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--axes", "3"), ("axes = 3", "10 to 10000")),
        (("--rate", "0"), ("rate = 0", "above 0")),
        (("--detector", "estimator", "--head", "nowhere"), ("--head nowhere", "only a head has weights")),
        (("--head", "nowhere"), ("nowhere.json", "cannot be read")),
        (("--detector", "network"), ("kind = 'network'", "must be head, estimator, two_stage, or module:attribute")),
        (("--detector", "math:pi"), ("'math:pi': is no leak detector", "it has no threshold, refuses, read")),
    ],
)
def test_bad_options_of_the_command_get_one_line_and_leave_nothing(tmp_path, options, parts):
    assert_one_clear_line(hydro("alarms", "--output", tmp_path / "new", *options), *parts)
    assert not (tmp_path / "new").exists()


def test_an_axis_at_rest_is_read_with_what_its_last_motion_has_shown():
    detector, still = TwoStageDetector(HeadDetector(untrained_head(CONFIG)), remembers=True), at_rest(CONFIG)
    read = []
    for task in (still, CONFIG, still):
        acting = ACTING["proportional"].make(task, 1, 1)
        windows = known_windows(task, acting, leak_cases([90_250_001], 1, 0.3), 10.0, 1.995)
        read.append(detector.read(Windows.of(windows.signals), CONFIG))
    assert read[0].why[0] == Why.AT_REST
    assert 0.03 < read[2].low_lpm[0] < 0.3 < read[2].high_lpm[0]
