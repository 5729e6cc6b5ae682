"""Tables of an evaluation against figures worked out by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from hydro_agents.detection.detector import Reading
from hydro_agents.evaluation.detection import (
    LeakBounds,
    detection_columns,
    detection_curves,
    detection_rates,
    detection_summary,
)
from hydro_agents.evaluation.evaluate import ratio_table, summary_table
from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.running.cases import Cases
from hydro_agents.running.statistics import share_interval
from hydro_env import TaskConfig

PLANTS = 4
GENERATOR = np.random.default_rng(5)


def tracking_table():
    """Two controllers on two levels, two families and four plants; every metric is a number of its own."""
    rows = []
    for controller, factor in (("base", 1.0), ("other", 0.5)):
        for level in (0.01, 4.0):
            for family in ("step", "sine"):
                for plant in range(PLANTS):
                    error = factor * (1.0 + plant) * (10.0 if family == "step" else 1.0) * (1.0 + 0.1 * level)
                    if (controller, level, family) == ("other", 4.0, "sine"):
                        error *= 3.0  # worse than the base there
                    rows.append(
                        {"controller": controller, "leakage_flow_lpm": level, "family": family, "plant": plant}
                        | {name: error + index for index, name in enumerate(METRICS)}
                    )
    return pd.DataFrame(rows)


CASES = tracking_table()


def errors(controller, **chosen):
    frame = CASES[CASES["controller"] == controller]
    for column, value in chosen.items():
        frame = frame[frame[column] == value]
    return np.array([frame[frame["plant"] == plant]["mean_error_mm"].mean() for plant in range(PLANTS)])


@pytest.mark.parametrize("by", ["leakage_flow_lpm", "family"])
def test_summary_of_every_metric(by):
    table = summary_table(CASES, by)
    assert len(table) == 2 * 2 * len(METRICS)
    for row in table.to_dict("records"):
        own = CASES[(CASES["controller"] == row["controller"]) & (CASES[by] == row[by])]
        values = own[row["metric"]].to_numpy()
        assert row["mean"] == pytest.approx(values.mean())
        assert row["low"] < row["mean"] < row["high"]
        assert row["worst"] == values.max()
        assert row["cvar_5_percent"] == values.max()  # one in twenty of eight is one
        assert row["cases"] == 2 * PLANTS
        assert row["unit"] == METRICS[row["metric"]].unit


def test_ratios_overall_per_level_and_per_family():
    table = ratio_table(CASES, ["base", "other"])
    assert set(table["controller"]) == {"other"}
    assert set(table["against"]) == {"base"}
    assert list(table["group"]) == ["all", "level", "level", "family", "family", "equal_weight"]
    chosen = {
        ("all", ""): {},
        ("level", "0.01"): {"leakage_flow_lpm": 0.01},
        ("level", "4.0"): {"leakage_flow_lpm": 4.0},
        ("family", "step"): {"family": "step"},
        ("family", "sine"): {"family": "sine"},
    }
    better = {"": 0.75, "0.01": 1.0, "4.0": 0.5, "step": 1.0, "sine": 0.5}
    for row in table.to_dict("records")[:-1]:
        mine, theirs = (errors(name, **chosen[row["group"], row["value"]]) for name in ("other", "base"))
        assert row["low"] <= row["ratio"] <= row["high"]
        assert row["ratio"] == pytest.approx(mine.mean() / theirs.mean())
        assert row["share_of_cases_better"] == better[row["value"]]


def test_with_equal_weights_every_family_counts_the_same():
    row = ratio_table(CASES, ["base", "other"]).iloc[-1]
    mine, theirs = (
        np.array([errors(name, family=family) for family in ("step", "sine")]) for name in ("other", "base")
    )
    ratios = mine.mean(axis=1) / theirs.mean(axis=1)
    assert row["ratio"] == pytest.approx(math.sqrt(ratios[0] * ratios[1]))
    assert row["low"] <= row["ratio"] <= row["high"]
    assert math.isnan(row["share_of_cases_better"])
    assert row["value"] == "geometric mean of the families' ratios"
    assert (row["controller"], row["against"]) == ("other", "base")


def test_an_equal_controller_is_not_better():
    same = pd.concat([CASES[CASES["controller"] == "base"].assign(controller=name) for name in ("base", "twin")])
    table = ratio_table(same, ["base", "twin"])
    assert np.all(table[["ratio", "low", "high"]] == 1.0)
    assert np.nanmax(table["share_of_cases_better"]) == 0.0
    assert ratio_table(same, ["base"]).empty
    three = pd.concat([same, CASES[CASES["controller"] == "other"]])
    assert list(ratio_table(three, ["base", "twin", "other"])["controller"].unique()) == ["twin", "other"]


# Detection ----------------------------------------------------------------------------------------------------------

TASK = TaskConfig(leakage={"class_bounds": (0.05, 0.5, 2.0), "faulty_range": (0.2, 3.0)})
FLOW = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.25, 0.4, 0.5, 1.0, 2.5])
SCORE = np.array([0.1, 0.9, 0.3, 0.5, 0.6, 0.35, 0.7, 0.8, 0.2, 0.95])
SIZE = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.2, 0.5, 10.0, 2.5])
CLASS = ["healthy"] * 3 + ["incipient"] * 5 + ["moderate", "severe"]
THRESHOLD = 0.5


def episodes(controllers=("A", "B")):
    frames = []
    for name in controllers:
        score = SCORE if name == "A" else 1.0 - SCORE
        frames.append(
            pd.DataFrame(
                {
                    "controller": name,
                    "leakage_flow_lpm": FLOW,
                    "class": CLASS,
                    "probability": score,
                    "estimated_flow_lpm": SIZE,
                    "flagged": score >= THRESHOLD,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def test_bounds_come_from_the_task():
    assert LeakBounds.of(TASK) == (0.05, 0.2, 0.5)
    assert LeakBounds.of(TASK).moderate_label == "≥ 0.5"
    assert LeakBounds.of(TaskConfig()) == (0.03, 0.1, 0.3)


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
        assert (row.flagged_share, row.low, row.high) == tuple(share_interval(hits, total))
        assert row.episodes == total
    default = detection_rates(episodes(), TaskConfig())
    ranges = default[(default["controller"] == "A") & (default["group"] == "range")]["value"]
    assert list(ranges) == ["0.1–0.2", "0.2–0.3", "0.3–0.5", "0.5–1", "1–2", "2–4", "≥ 0.3"]


def test_summary_counts_healthy_and_leaking_episodes_as_the_task_says():
    table = detection_summary(episodes(), THRESHOLD, TASK)
    assert list(table["controller"]) == ["A", "B"]
    row = table.iloc[0]
    # Healthy: 0.1, 0.9, 0.3; leaking (above 0.2 l/min): 0.35, 0.7, 0.8, 0.2, 0.95.
    assert row["healthy_episodes"] == 3
    assert row["leaking_episodes"] == 5
    pairs = [(leak > well) for leak in (0.35, 0.7, 0.8, 0.2, 0.95) for well in (0.1, 0.9, 0.3)]
    assert row["auroc"] == pytest.approx(np.mean(pairs))
    # Flags from the highest score on: 0.95 and 0.9 (healthy), 0.8, 0.7, 0.35, 0.3 (healthy), 0.2.
    assert row["average_precision"] == pytest.approx((1 / 1 + 2 / 3 + 3 / 4 + 4 / 5 + 5 / 7) / 5)
    assert row["threshold"] == THRESHOLD
    assert row["false_alarm_rate"] == pytest.approx(1 / 3)
    assert row["detection_rate_moderate"] == pytest.approx(2 / 3)  # 0.8 and 0.95 of 0.8, 0.2, 0.95
    assert row["detection_rate_moderate_at_1_percent"] == pytest.approx(1 / 3)  # the threshold lies above 0.9
    factors = np.sort([2.0, 2.0, 1.0, 10.0, 1.0])
    assert row["median_size_error_factor"] == pytest.approx(np.median(factors))
    assert row["p90_size_error_factor"] == pytest.approx(10 ** np.quantile(np.log10(factors), 0.9))
    assert table.iloc[1]["auroc"] == pytest.approx(1.0 - row["auroc"])


def test_curves_of_each_controller():
    table = detection_curves(episodes(), TASK)
    assert set(table["controller"]) == {"A", "B"}
    for name in ("A", "B"):
        roc = table[(table["controller"] == name) & (table["curve"] == "roc")]
        summary = detection_summary(episodes((name,)), THRESHOLD, TASK).iloc[0]
        assert np.trapezoid(roc["y"], roc["x"]) == pytest.approx(summary["auroc"])
        assert len(roc) == 1 + 8  # between the two bounds nothing counts
        precision = table[(table["controller"] == name) & (table["curve"] == "precision_recall")]
        area = np.sum(np.diff(precision["x"]) * precision["y"].to_numpy()[1:])
        assert area == pytest.approx(summary["average_precision"])
        assert roc["threshold"].iloc[0] == np.inf
    assert list(table.index) == list(range(len(table)))


def test_one_row_per_episode():
    class Detector:
        threshold = 0.5

        def read(self, windows, task):
            spool = windows.signal("spool_position")[:, 0]
            return Reading.of(spool, probability=spool, flow_lpm=10.0 * spool)

    probability = np.array([0.2, 0.5, 0.7])
    cases = Cases(np.array([7, 8, 9]), np.array([0.01, 0.4, 3.0]))
    signals = np.repeat(probability[:, None, None], 5, axis=1)
    rollout = SimpleNamespace(signals=signals, leakage_class=np.array([0, 2, 3]))
    columns = detection_columns(cases, rollout, Detector(), TASK)
    assert {name: values.tolist() for name, values in columns.items()} == {
        "seed": [7, 8, 9],
        "leakage_flow_lpm": [0.01, 0.4, 3.0],
        "class": ["healthy", "moderate", "severe"],
        "probability": [0.2, 0.5, 0.7],
        "estimated_flow_lpm": [2.0, 5.0, 7.0],
        "flagged": [False, True, True],
    }
