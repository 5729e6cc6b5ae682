"""Detection by the head: the area under the ROC against scikit-learn, tables against figures by hand."""

import math

import numpy as np
import pandas as pd
import pytest
import sklearn.metrics

from hydro_agents.detection.detector import threshold_at_false_alarm_rate
from hydro_agents.evaluation.detection import (
    area_under_roc,
    detection_rates,
)
from hydro_agents.running.statistics import share_interval
from hydro_env import TaskConfig


@pytest.mark.parametrize("decimals", [0, 1, 9])
def test_the_area_is_that_of_scikit_learn(decimals):
    generator = np.random.default_rng(0)
    positive = generator.random(200) < 0.4
    scores = np.round(generator.normal(positive * 0.8, 1.0), decimals)
    assert area_under_roc(scores, positive) == pytest.approx(sklearn.metrics.roc_auc_score(positive, scores))
    assert math.isnan(area_under_roc(scores, np.ones_like(positive)))
    assert math.isnan(area_under_roc(scores, np.zeros_like(positive)))


@pytest.mark.parametrize("count", [1, 100, 1000])
@pytest.mark.parametrize("rate", [0.0, 0.01])
@pytest.mark.parametrize("decimals", [1, 12])
def test_threshold_never_exceeds_the_false_alarm_rate(count, rate, decimals):
    healthy = np.round(np.random.default_rng(count).random(count), decimals)
    threshold = threshold_at_false_alarm_rate(healthy, rate)
    assert np.mean(healthy >= threshold) <= rate
    # It is the lowest: the next healthy score below it would be too many.
    assert np.mean(healthy >= healthy[healthy < threshold].max()) > rate


# Tables ---------------------------------------------------------------------------------------------------------------

TASK = TaskConfig(leakage={"class_bounds": (0.05, 0.5, 2.0), "faulty_range": (0.2, 3.0)})
FLOW = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.25, 0.4, 0.5, 1.0, 2.5])
SCORE = np.array([0.1, 0.9, 0.3, 0.5, 0.6, 0.35, 0.7, 0.8, 0.2, 0.95])
SIZE = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.2, 0.5, 10.0, 2.5])
CLASS = ["healthy"] * 3 + ["incipient"] * 5 + ["moderate", "severe"]
THRESHOLD = 0.5


def episodes(controllers=("A", "B")):
    columns = {"leakage_flow_lpm": FLOW, "class": CLASS, "estimated_flow_lpm": SIZE}
    scores = {"A": SCORE, "B": 1.0 - SCORE}
    return pd.concat(
        [pd.DataFrame({"controller": name, **columns, "probability": scores[name]}) for name in controllers],
        ignore_index=True,
    ).assign(flagged=lambda table: table["probability"] >= THRESHOLD)


def test_rates_per_class_and_range():
    table = detection_rates(episodes(), TASK)
    own = table[table["controller"] == "A"]
    assert len(own) * 2 == len(table)
    expected = {
        ("class", "healthy"): (1, 3),
        ("class", "incipient"): (4, 5),
        ("class", "moderate"): (0, 1),
        ("class", "severe"): (1, 1),
        ("range", "0.2–0.3"): (1, 2),
        ("range", "0.3–0.5"): (1, 1),
        ("range", "0.5–1"): (1, 1),
        ("range", "1–2"): (0, 1),
        ("range", "2–3"): (1, 1),
        ("range", "≥ 0.5"): (2, 3),
    }
    assert [(row.group, row.value) for row in own.itertuples()] == list(expected)
    for row in own.itertuples():
        hits, total = expected[row.group, row.value]
        assert (row.flagged_share, row.flagged_share_low, row.flagged_share_high) == tuple(share_interval(hits, total))
        assert row.episodes == total
    default = detection_rates(episodes(), TaskConfig())
    ranges = default[(default["controller"] == "A") & (default["group"] == "range")]["value"]
    assert list(ranges) == ["0.1–0.2", "0.2–0.3", "0.3–0.5", "0.5–1", "1–2", "2–4", "≥ 0.3"]
