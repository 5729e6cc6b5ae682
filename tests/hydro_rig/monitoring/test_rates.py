"""False-alarm rates, thresholds and drawn hours: known answers."""

import numpy as np
import pytest

from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.detector import Cause
from hydro_agents.detection.looks import Activity, Looks
from hydro_rig.monitoring import alarm_job
from hydro_rig.monitoring.alarm_job import (
    SAFETY,
    Axes,
    calibrate,
    healthy_peaks,
    peaks,
    rate_per_100_h,
    scale_of,
    threshold_for,
)

COPIES = 6


@pytest.fixture(autouse=True)
def few_copies(monkeypatch):
    """Fewer shifts of each axis than the job draws: enough for what these tests count."""
    monkeypatch.setattr(alarm_job, "COPIES", COPIES)


def test_an_excursion_has_one_peak():
    found = peaks(np.array([[0.0, 1.0, 3.0, 2.0, 0.0, 0.0, 5.0], [0.0] * 7]))
    assert [list(values) for values in found] == [[3.0, 5.0], []]


def test_interval_of_the_rate_widens_where_alarms_cluster():
    even = [np.array([2.0, 0.5])] * 20
    clustered = [np.full(20, 2.0), *[np.array([0.5])] * 19]
    same, wide = (rate_per_100_h(axes, 2000.0) for axes in (even, clustered))
    assert same == pytest.approx((1.0, 1.0, 1.0))
    assert wide.value == pytest.approx(1.0)
    assert wide.low < 0.2
    assert wide.high > 2.0


def looks(score, activity, cause=Cause.NONE, interval=4.0):
    full = np.full(score.shape, np.nan)
    kinds = [np.broadcast_to(np.asarray(kind, dtype=np.int8), score.shape) for kind in (cause, activity)]
    return Looks(interval * np.arange(score.shape[1]), score, full, np.abs(score), *kinds, np.zeros(score.shape))


def gaussian(mean, seed, axes=20, count=300):
    """Independent looks in motion and at rest in turn."""
    activity = np.tile(np.repeat([Activity.MOVING, Activity.STANDING, Activity.SLOW], 20), count // 60)
    return Axes(looks(np.random.default_rng(seed).normal(mean, 1.0, (axes, count)), activity))


def test_false_alarms_of_gaussian_looks_are_as_rare_as_the_closed_form_says():
    scale = {"highest_baseline": 0.0, "learning": 0, "spread": 1.0, "shift": 1.5}
    scales = dict.fromkeys(("standing", "slow", "moving"), scale)
    settings = AlarmSettings(scales=scales, threshold=6.0, clip=1e6, interval=4.0)
    per_axis, hours = healthy_peaks(settings, gaussian(0.0, 1, axes=40))
    boundary = 6.0 / 1.5 + 1.166  # Siegmund, Sequential Analysis (1985), (2.57), for steps 1.5 (z - 0.75)
    expected = (np.exp(1.5 * boundary) - 1.5 * boundary - 1.0) / (2.0 * 0.75**2)  # looks between alarms
    # An excursion with several passages is one alarm; after it the closed form begins anew.
    assert rate_per_100_h(per_axis, hours).value == pytest.approx(100.0 * 900.0 / expected, rel=0.2)


def test_the_threshold_holds_its_rate_on_other_axes():
    designs = dict.fromkeys(Activity, (0.05, gaussian(2.0, 3)))
    settings = calibrate(gaussian(0.0, 2), designs, 1.0, 60, "white noise", 0.03)
    assert settings.table("spread") == pytest.approx(1.0, rel=0.1)
    assert settings.table("shift") == pytest.approx(2.0, rel=0.1)
    assert settings.table("learning").tolist() == [60, 60, 60]
    own, hours = healthy_peaks(settings, gaussian(0.0, 2))
    assert rate_per_100_h(own, hours).high <= 1.0 / SAFETY
    assert rate_per_100_h(own, hours, 0.7).value > 1.0 / SAFETY, "no more than needed"
    others, hours = healthy_peaks(settings, gaussian(0.0, 4))
    assert hours == 20 * 16 * COPIES
    assert rate_per_100_h(others, hours).value < 3.0


def test_a_threshold_counts_the_peaks_above_it():
    per_axis = [np.arange(1.0, 101.0)] * 6
    for rate, expected in ((2.0, 98.0), (10.0, 90.0), (99.0, 1.0)):
        threshold = threshold_for(per_axis, 600.0, rate)  # 100 h an axis
        assert threshold == pytest.approx(expected)
        assert rate_per_100_h(per_axis, 600.0, threshold).value <= rate


def test_hours_are_drawn_from_an_axis_of_its_own_with_the_share_of_motion():
    count = 200
    activity = np.repeat([Activity.MOVING, Activity.STANDING], count // 2)
    score = 1000.0 * np.arange(3)[:, None] + np.arange(count)
    drawn = Axes(looks(score, activity)).drawn(8.0, 0, copies=2)
    assert drawn.score.shape == (6, 8 * 900)
    np.testing.assert_array_equal(drawn.score // 1000, np.tile(np.arange(3), 2)[:, None] + np.zeros_like(drawn.score))
    moving = drawn.activity == Activity.MOVING
    assert moving.mean() == pytest.approx(0.25, abs=0.05)
    np.testing.assert_array_equal(drawn.score % 1000 < count // 2, moving)
    assert (np.diff(drawn.score[:, :15], axis=1) % (count // 2) == 1).all(), "a block is a stretch of looks"
    still = Axes(looks(score, activity)).drawn(1.0, 0, in_motion=0.0)
    assert (still.activity == Activity.STANDING).all()


def test_a_rationed_detector_answers_once_a_minute_at_rest():
    count = 150
    score = np.where(np.arange(count) % 15 == 0, 1.0, np.nan)[None]
    rationed = Axes(looks(score, Activity.STANDING, np.where(np.isnan(score), Cause.UNDETERMINED, 0)), 60.0)
    drawn = rationed.drawn(1.0, 0, in_motion=0.0)
    assert np.isfinite(drawn.score).sum() == 60
    healthy, leaking = gaussian(0.0, 5), gaussian(2.0, 6)
    at_rest, in_motion = (
        scale_of(healthy._replace(ration=60.0), leaking, activity, 60, (0.03, 0.1))
        for activity in (Activity.STANDING, Activity.MOVING)
    )
    assert (at_rest.learning, at_rest.highest_baseline, at_rest.shift) == (0, 0.03, pytest.approx(0.07))
    assert in_motion.learning == 60
    assert in_motion.shift == pytest.approx(2.0, rel=0.1)
