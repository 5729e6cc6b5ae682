"""Tables of a protocol from cases whose answers are known."""

import itertools

import numpy as np
import pandas as pd
import pytest
from published import assert_published
from small_protocol import Proportional, small

from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.evaluation.robustness_protocol import Participants
from hydro_agents.evaluation.runner import Results, run

FAMILIES, LEAKS, PLANTS = ("step", "sine"), (0.03, 4.0), 6
BASE = {"step": 0.5, "sine": 0.1}


def rows(controller, factor, condition="plain", group="leak", seed=0, scatter=0.0):
    """Cases of a controller whose error is ``factor`` times that of the baseline, which grows with the plant."""
    generator = np.random.default_rng(seed)
    columns = ["leakage_flow_lpm", "family", "plant"]
    table = pd.DataFrame(itertools.product(LEAKS, FAMILIES, range(PLANTS)), columns=columns)
    hardness = table["family"].map(BASE) * (1.0 + 0.3 * table["plant"]) * (1.0 + 0.1 * table["leakage_flow_lpm"])
    error = hardness * factor * np.exp(scatter * generator.normal(size=len(table)))
    values = dict.fromkeys(METRICS, 1.0) | {"valve_travel_per_s": 4.0 * factor, "failed": 0.0}
    values |= {"mean_error_mm": error, "mean_error_sensor_mm": 0.5 * error}
    labels = {"condition": condition, "group": group, "controller": controller, "training_seed": seed}
    return table.assign(**labels, seed=1000 * table["family"].map(FAMILIES.index) + table["plant"], **values)


def results_of(cases, corrects=()):
    """Results with made-up cases, one failure, and two limit cycles."""
    status = [(name, "plain", "done", "") for name in cases["controller"].unique()]
    status = pd.DataFrame(
        [*status, ("good#1", "late", "failed", "why")], columns=["controller", "condition", "status", "message"]
    )
    cycles = pd.DataFrame(
        {
            "controller": ["PID", "PID", "good"],
            "limit_cycle": [1.0, 1.0, 0.0],
            "amplitude_um": 9.0,
            "frequency_hz": 5.0,
            "failed": 0.0,
        }
    )
    parts = {"cases": cases, "limit_cycles": cycles}
    return Results(small(), Participants({}, corrects=dict(corrects)), parts, status)


def by_condition(table):
    """The rows of a comparison over all cases (``all``) and under each condition, by the condition."""
    kept = table[table["group"].isin(["all", "condition"])]
    return kept.assign(condition=kept["value"].where(kept["group"] != "all", "all")).set_index("condition")


def joined(*frames):
    return pd.concat(frames, ignore_index=True)


@pytest.fixture(scope="module")
def cases():
    return joined(
        rows("PID", 1.0), rows("good", 0.5), rows("PID", 1.0, "late", "timing"), rows("good", 0.8, "late", "timing")
    )


def test_ratios_of_a_controller_that_is_better_by_a_factor(cases):
    table = by_condition(results_of(cases).table("comparison"))
    for name in ("ratio", "equal_weight", "worst_ratio"):
        assert table.loc["plain", name] == pytest.approx(0.5)
        assert table.loc["late", name] == pytest.approx(0.8)
    assert table.loc["plain", "ratio_low"] == table.loc["plain", "ratio_high"] == pytest.approx(0.5)
    assert table.loc["all", "equal_weight"] == pytest.approx(np.sqrt(0.5 * 0.8))
    assert table.loc["all", "ratio"] == pytest.approx(0.65)  # both conditions have the same errors of the baseline
    assert table.loc["all", "worst_ratio"] == pytest.approx(0.8)
    assert (table["share_better"] == 1.0).all()
    assert table.loc["plain", "travel_ratio"] == pytest.approx(0.5)
    assert table.loc["all", "travel_ratio"] == pytest.approx(0.65)
    sensed = table[["ratio_sensor", "equal_weight_sensor", "equal_weight_sensor_low"]]
    np.testing.assert_allclose(sensed, table[["ratio", "equal_weight", "equal_weight_low"]])
    assert table["cases"].tolist() == [48, 24, 24]


def test_a_controller_absent_from_a_condition_is_compared_where_it_ran(cases):
    partial = joined(cases, rows("part", 0.5))
    comparison = results_of(partial).table("comparison")
    own = by_condition(comparison[comparison["controller"] == "part"])
    assert list(own.index) == ["all", "plain"]
    assert own.loc["all", "ratio"] == pytest.approx(0.5)
    assert own.loc["all", "cases"] == 24
    assert results_of(partial).table("ranking").set_index("controller").loc["part", "conditions"] == 1


def test_a_policy_is_compared_with_what_it_corrects_unless_that_is_the_baseline(cases):
    whole = joined(cases, rows("policy", 0.4), rows("policy", 0.64, "late", "timing"))
    table = results_of(whole, {"policy": "good", "good": "PID", "absent": "good"}).table("comparison")
    (row,) = table[table["against"] != "PID"].to_dict("records")
    assert (row["controller"], row["against"], row["group"], row["cases"]) == ("policy", "good", "all", 48)
    assert (row["ratio"], row["ratio_high"]) == pytest.approx((0.8, 0.8))


def test_the_ranking_puts_the_best_first_with_its_price(cases):
    table = results_of(cases).table("ranking")
    assert table["controller"].tolist() == ["good", "PID"]
    assert table["rank"].tolist() == [1, 2]
    good, pid = table.iloc[0], table.iloc[1]
    assert (good["conditions"], good["failed_conditions"]) == (2, 1)
    assert (pid["limit_cycles"], pid["standstills"], good["limit_cycles"]) == (2, 2, 0)
    assert (pid["equal_weight"], pid["worst_ratio"]) == (1.0, 1.0)
    assert good["travel_ratio"] == pytest.approx(0.65)


def test_training_seeds_count_as_one_controller():
    results = results_of(joined(rows("PID", 1.0), rows("P", 0.5, seed=0), rows("P", 1.5, seed=1)))
    row = results.table("comparison").set_index("group").loc["all"]
    assert row["ratio"] == pytest.approx(1.0)
    assert row["share_better"] == 0.5
    assert row["ratio_low"] == pytest.approx(0.5)  # a resampling may draw the same seed twice
    assert row["ratio_high"] == pytest.approx(1.5)
    summary = results.table("summary")
    own = summary[(summary["controller"] == "P") & (summary["metric"] == "mean_error_mm")]
    assert set(own["training_seeds"]) == {2}
    assert own.set_index("group").loc["all", "cases"] == 48
    seeds = results.table("seeds").set_index("training_seed")
    assert seeds["ratio"].tolist() == pytest.approx([0.5, 1.5])
    assert seeds["share_better"].tolist() == [1.0, 0.0]


def test_the_summary_holds_means_with_their_intervals(cases):
    table = results_of(cases).table("summary")
    row = table[(table["controller"] == "PID") & (table["metric"] == "mean_error_mm")].set_index("group").loc["all"]
    assert row["mean"] == pytest.approx(cases.loc[cases["controller"] == "PID", "mean_error_mm"].mean())
    assert row["mean_low"] < row["mean"] < row["mean_high"]


def test_all_tables_of_a_run_are_written(tmp_path):
    protocol = small(standstill_plants=3)
    chosen = Participants({"P": Proportional(), "Q": Proportional(20.0)})
    run(protocol, chosen, facts=[("date", "today")]).write(tmp_path)
    assert_published("robustness", tmp_path)
    facts = pd.read_csv(tmp_path / "protocol.csv").set_index("key")["value"]
    assert (facts["sha256"], facts["date"]) == (protocol.sha256, "today")
    changes = pd.read_csv(tmp_path / "conditions.csv")["changes"].tolist()
    assert changes == ["{}", '{"task": {"command_latency": 0.004}}']
