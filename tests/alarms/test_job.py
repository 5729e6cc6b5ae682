"""The whole job on made-up looks: settings and tables; the detectors; bad options of the command."""

from copy import deepcopy

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro
from untrained import untrained_head

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.alarm_calibration import scale_of
from hydro_agents.detection.alarm_job import FAULTS, LEVELS, AlarmJob, run_job
from hydro_agents.detection.detector import Cause, Windows, measured_run
from hydro_agents.detection.features import SIGNALS
from hydro_agents.detection.following_detector import FollowingDetector
from hydro_agents.detection.looks import Activity, Looks
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.cases import Cases
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig()
JOB = AlarmJob(hours=5.0, shift=300.0, past=300.0, after=60.0, axes=20, interval=1.0, learning=20)


class MadeUp:
    """A bench with made-up looks: the score is white noise and rises by 4 per 0.1 l/min while the axis moves."""

    detector_name = "made up"

    def __init__(self, rise=4.0):
        self.rise = rise

    def looks(self, work):
        return {name: self._looks(name, each) for name, each in work.items()}

    def _looks(self, name, work):
        generator = np.random.default_rng(len(name))
        parts = [self._part(generator, work, 0.0, work.duration, work.leak_lpm, None)]
        ends = work.duration + work.after
        return parts + [self._part(generator, work, work.duration, ends, None, onset) for onset in work.onsets]

    def _part(self, generator, work, begin, end, leak, onset):
        time = np.arange(begin, end, work.interval) + 0.5
        shape = (work.axes, len(time))
        flow = np.full(shape, leak or 0.01)
        activity = np.tile(np.arange(len(time)) // 10 % 3, (work.axes, 1)).astype(np.int8)
        if onset is not None:
            flow[:] = onset.leak_lpm or 0.01
            if onset.then is not None:
                activity[:] = onset.then
            if onset.grows:
                flow[:] = 0.01 * (onset.leak_lpm / 0.01) ** np.linspace(0.0, 1.0, len(time))
        score = generator.normal(0.0, 1.0, shape) + self.rise * flow / 0.1 * (activity == Activity.MOVING)
        seen = flow * 10.0 ** generator.normal(0.0, 0.02, shape)
        return Looks(time, score, np.full(shape, np.nan), seen, np.zeros(shape, dtype=np.int8), activity, flow)


def test_the_job_finds_settings_and_proves_them():
    settings, tables = run_job(MadeUp(), JOB)
    assert settings.false_alarms_per_100_h == 1.0
    assert settings.interval == 1.0
    assert settings.table("shift") == pytest.approx([0.0, 0.0, 4.0], abs=0.7)
    delays = tables["delays"].set_index(["then", "leak_lpm"])
    assert len(delays) == len(LEVELS) * len(Activity)
    moving = delays.loc["moving"]
    assert moving.loc[0.1, "median_s"] <= 5.0
    assert (moving["missed"] == 0.0).all()
    assert moving.loc[1.0, "median_s"] <= moving.loc[0.1, "median_s"]
    assert (delays.loc["standing", "missed"] > 0.8).all(), "nothing is seen there"
    rates = tables["false_alarms"].set_index("threshold")
    assert rates["alarms"].is_monotonic_decreasing
    assert rates.loc[1.0, "low"] <= 1.0, "the rate that was asked for"
    assert len(tables["other_faults"]) == len(FAULTS)
    assert (tables["other_faults"]["alarmed"] < 0.2).all()
    assert tables["from_the_start"]["alarmed"].tolist() == [1.0, 1.0, 1.0]
    assert tables["growth"].loc[0, "with_trend"] == JOB.axes
    assert tables["growth"].loc[0, "holds_high"] > 0.9


def test_a_detector_that_sees_nothing_is_refused():
    with pytest.raises(ConfigurationError, match="score of 'made up' does not rise"):
        run_job(MadeUp(rise=-4.0), JOB)


def test_scale_counts_looks_that_stray_together_for_little():
    generator, count = np.random.default_rng(0), 200
    white = generator.normal(0.0, 1.0, (50, count))
    together = np.repeat(generator.normal(0.0, 1.0, (50, count // 10)), 10, axis=1)

    def looks(score):
        full = np.full(score.shape, np.nan)
        kinds = [np.full(score.shape, kind, dtype=np.int8) for kind in (0, Activity.MOVING)]
        return Looks(np.arange(count, dtype=float), score, full, full, *kinds, full)

    assert scale_of(looks(white), [], Activity.MOVING, 50).spread == pytest.approx(1.0, rel=0.1)
    assert scale_of(looks(together), [], Activity.MOVING, 50).spread == pytest.approx(np.sqrt(10.0), rel=0.15)
    with pytest.raises(ConfigurationError, match="0 healthy axes were slow"):
        scale_of(looks(white), [], Activity.SLOW, 50)


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


def test_an_estimator_is_a_detector_and_a_misfit_counts_for_nothing():
    task = TaskConfig(episode_duration=0.81)
    cases = Cases(np.array([1_930_000, 1_930_001]), np.full(2, 0.3), np.full(2, "sine"))
    signals, _ = measured_run(task, shipped("pid", task), cases)
    signals[1, 0] = signals[1, 0, ::-1]  # no axis moves against its command
    detector = FollowingDetector(threads=1)
    fresh = deepcopy(detector)
    first, second = (detector.read(Windows.of(signals[:, :, n : n + 81]), CONFIG) for n in (0, 80))
    assert first.cause.tolist() == second.cause.tolist() == [Cause.NONE, Cause.UNKNOWN]
    for found in (first, second):
        assert abs(found.score[0] - 0.3) < 4.0 * found.sigma[0]
    anew = fresh.read(Windows.of(signals[:, :, 80:161]), CONFIG)
    assert anew.score[0] == pytest.approx(second.score[0], abs=0.5 * anew.sigma[0]), (
        "the past changes the way, not the end"
    )
    again = detector.read(Windows.of(signals[:, :, :81]), CONFIG)
    np.testing.assert_array_equal(again.score, first.score, "it has not followed on: all anew")
    scales = {a.name.lower(): {"highest_baseline": 0.03, "spread": 0.001, "shift": 0.1} for a in Activity}
    alarm = LeakAlarm(AlarmSettings(scales=scales, sums=({"method": "mean", "threshold": 0.1},)))
    result, _ = alarm.update(second, np.array([Activity.MOVING] * 2, dtype=np.int8), alarm.begin(2))
    assert result.alarm.tolist() == [True, False]


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--hours", "-3"), ("hours = -3", "above 0")),
        (("--rate", "0"), ("rate = 0", "above 0")),
        (("--detector", "estimator", "--head", "nowhere"), ("--head nowhere", "only the head has weights")),
        (("--head", "nowhere"), ("nowhere.json", "cannot be read")),
        (("--task", "period_10ms"), ("alarm: the leakage head was trained for a control period of 5 ms",)),
        (("--detector", "network"), ("kind = 'network'", "must be head, estimator, or module:attribute")),
        (("--detector", "math:pi"), ("'math:pi': is no leak detector", "it has no threshold, refuses, read")),
    ],
)
def test_bad_options_of_the_command_get_one_line_and_leave_nothing(tmp_path, options, parts):
    assert_one_clear_line(hydro("alarms", "--output", tmp_path / "new", *options), *parts)
    assert not (tmp_path / "new").exists()
