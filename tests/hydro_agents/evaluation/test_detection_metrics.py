"""Detection metrics against counting by hand and against scipy."""

import math

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from hydro_agents.detection.detector import threshold_at_false_alarm_rate
from hydro_agents.evaluation.detection import (
    area_under_roc,
    average_precision,
    detection_rate,
    precision_recall_curve,
    roc_curve,
)


def scores_with_ties(seed, count=200, decimals=1):
    generator = np.random.default_rng(seed)
    positive = generator.random(count) < 0.4
    return np.round(generator.normal(positive * 0.8, 1.0), decimals), positive


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("decimals", [0, 1, 9])
def test_area_under_roc_is_the_statistic_of_mann_and_whitney(seed, decimals):
    scores, positive = scores_with_ties(seed, decimals=decimals)
    statistic = mannwhitneyu(scores[positive], scores[~positive]).statistic
    expected = statistic / (positive.sum() * (~positive).sum())
    assert area_under_roc(scores, positive) == pytest.approx(expected, rel=1e-12)
    assert area_under_roc(-scores, positive) == pytest.approx(1.0 - expected, rel=1e-12)


def test_area_under_roc_at_its_ends():
    positive = np.array([False, False, True, True])
    assert area_under_roc(np.array([0.1, 0.2, 0.3, 0.4]), positive) == 1.0
    assert area_under_roc(np.array([0.4, 0.3, 0.2, 0.1]), positive) == 0.0
    assert area_under_roc(np.full(4, 0.5), positive) == 0.5
    assert math.isnan(area_under_roc(np.array([0.1, 0.2]), np.array([True, True])))
    assert math.isnan(area_under_roc(np.array([0.1, 0.2]), np.array([False, False])))


def test_roc_curve_by_hand():
    scores = np.array([0.9, 0.8, 0.8, 0.4, 0.1])
    curve = roc_curve(scores, np.array([True, True, False, False, True]))
    np.testing.assert_allclose(curve.x, [0.0, 0.0, 0.5, 1.0, 1.0])
    np.testing.assert_allclose(curve.y, [0.0, 1 / 3, 2 / 3, 2 / 3, 1.0])
    np.testing.assert_array_equal(curve.threshold, [np.inf, 0.9, 0.8, 0.4, 0.1])


def test_curves_say_what_their_thresholds_do():
    scores, positive = scores_with_ties(11)
    roc, recall = roc_curve(scores, positive), precision_recall_curve(scores, positive)
    for index in range(1, len(roc.threshold)):
        flagged = scores >= roc.threshold[index]
        assert roc.x[index] == pytest.approx(flagged[~positive].mean())
        assert roc.y[index] == pytest.approx(flagged[positive].mean())
        assert recall.y[index] == pytest.approx(positive[flagged].mean())
    np.testing.assert_array_equal(recall.x, roc.y)


def test_average_precision_by_hand():
    scores = np.array([0.6, 0.9, 0.7, 0.8])
    positive = np.array([False, True, True, False])
    assert average_precision(scores, positive) == pytest.approx(0.5 * 1.0 + 0.5 * 2 / 3)
    assert average_precision(np.full(8, 0.5), np.arange(8) < 2) == pytest.approx(0.25)  # no knowledge: their share
    assert average_precision(scores, np.array([True, True, True, True])) == 1.0
    assert math.isnan(average_precision(scores, np.zeros(4, dtype=bool)))


@pytest.mark.parametrize("count", [1, 7, 99, 100, 101, 250, 1000])
@pytest.mark.parametrize("rate", [0.0, 0.01, 0.05, 0.3, 0.5])
@pytest.mark.parametrize("decimals", [1, 12])
def test_threshold_never_exceeds_the_false_alarm_rate(count, rate, decimals):
    healthy = np.round(np.random.default_rng(count).random(count), decimals)
    threshold = threshold_at_false_alarm_rate(healthy, rate)
    assert detection_rate(healthy, threshold) <= rate
    # It is the lowest: the next healthy score below it would be too many.
    assert detection_rate(healthy, healthy[healthy < threshold].max()) > rate


def test_threshold_uses_the_false_alarms_it_may():
    healthy = np.arange(1000) / 1000
    assert detection_rate(healthy, threshold_at_false_alarm_rate(healthy, 0.01)) == pytest.approx(0.01)
    assert threshold_at_false_alarm_rate(healthy, 1.0) <= 0.0


def test_detection_rate():
    assert detection_rate(np.array([0.1, 0.5, 0.9]), 0.5) == pytest.approx(2 / 3)
    assert math.isnan(detection_rate(np.array([]), 0.5))


def test_where_nothing_is_flagged_precision_is_one_and_recall_zero():
    for positive in (np.array([True, False, True]), np.zeros(3, dtype=bool)):
        curve = precision_recall_curve(np.array([0.2, 0.9, 0.5]), positive)
        assert (curve.x[0], curve.y[0], curve.threshold[0]) == (0.0, 1.0, np.inf)
        assert curve.y[1] == 0.0
        assert curve.x[-1] == float(positive.any())
    assert detection_rate([0.1, 0.7], 0.7) == 0.5


def test_one_leak_and_one_healthy_seal_are_enough_for_a_curve():
    curve = roc_curve(np.array([0.8, 0.3]), np.array([True, False]))
    assert (curve.x.tolist(), curve.y.tolist()) == ([0.0, 0.0, 1.0], [0.0, 1.0, 1.0])
    assert precision_recall_curve(np.array([0.8, 0.3]), np.array([True, False])).x.tolist() == [0.0, 1.0, 1.0]
