"""The page of controllers: its verdict and its tables say what the tables of the run say."""

import numpy as np
import pandas as pd
import pytest
from made_up_tables import protocol_tables
from parsed_page import ODD_NAME, Parsed
from untrained import untrained_head

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.evaluation.evaluate import ProtocolSettings, evaluate
from hydro_agents.report.controllers_page import (
    Example,
    controllers_page,
    cycles_by_condition,
    detection_table,
    heat_map,
    overview,
)
from hydro_agents.report.parts import BASE_ERROR, ERROR, learning_axes
from hydro_agents.running.text import correction_name, duration, frame_markdown, markdown, number
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
SETTINGS = ProtocolSettings(
    plants=3, leak_levels=(0.01, 4.0), families=("step", "sine"), detection_episodes=120, standstill_plants=1
)


def shown(tables, **parts):
    facts = pd.DataFrame({"key": ["command", "seed"], "value": ["hydro study", "3"]})
    return Parsed(controllers_page("Trial", {**tables, "protocol": facts}, **parts).html()).text


@pytest.fixture(scope="module")
def tables():
    gains = {"PID": 200.0, ODD_NAME: 60.0}
    controllers = {name: PID(PIDGains(proportional=gain), CONFIG) for name, gain in gains.items()}
    return evaluate(CONFIG, controllers, untrained_head(CONFIG), SETTINGS).tables()


def test_the_page_shows_every_part(tables):
    time = np.linspace(0.005, 0.4, 80)
    traces = dict.fromkeys(("PID", ODD_NAME), 0.01 * (1.0 - np.exp(-time / 0.05)))
    example = Example("the same with 4 l/min", time, np.full(80, 0.01), traces, traces, leak=4.0)
    curve = pd.DataFrame({"steps": [1e5, 2e5], ERROR: [0.3, 0.2], "controller": ODD_NAME, "first_mean_error_mm": 0.5})
    text = shown(
        {**tables, "training_curve": curve},
        examples=[example],
        timings={"train PPO": 3725.0},
        configuration="task:\n  control_period: 0.005 # <&>\n",
    )
    for part in ("Single runs", "Detecting the leak", "Training", "1 h 2 min", "control_period: 0.005 # <&>", ODD_NAME):
        assert part in text
    assert "A small run: 3 plants" in text
    assert "no test seeds" not in text
    cases = tables["cases"]
    assert "no test seeds" in shown({**tables, "cases": cases.assign(seed=cases["seed"] - 2_000_000)})


def test_one_controller_without_a_head():
    settings = SETTINGS.model_copy(update={"leak_levels": (0.3,), "families": ("step",)})
    text = shown(evaluate(CONFIG, {"PID": PID(PIDGains(), CONFIG)}, None, settings).tables())
    for absent in ("Detecting the leak", "Ratio of errors by", "nan", "clearly better"):
        assert absent not in text


def test_errors_and_limit_cycles_stand_in_the_overview(tables):
    counts = {"limit_cycles": [14, 0], "standstills": 16, "failures": [1, 0], "largest_amplitude_um": [7900.0, 0.0]}
    cycles = pd.DataFrame({"controller": ["PID", ODD_NAME], **counts, "frequency_hz": 8.0})
    restless = {**tables, "limit_cycle_summary": cycles}
    table = overview(restless)
    means = tables["cases"].groupby("controller", sort=False)["mean_error_mm"]
    assert table["error", "mean, mm"].tolist() == pytest.approx(means.mean().tolist())
    assert table["error", "worst run, mm"].tolist() == means.max().tolist()
    assert table["at rest", "limit cycles"].tolist() == ["14 of 16 (to 7.9 mm), 1 failed", "0 of 16"]
    assert "PID does not come to rest" in shown(restless)
    calm = cycles.assign(limit_cycles=0, failures=0)
    assert "PID does not come to rest" not in shown({**restless, "limit_cycle_summary": calm})


def test_the_growth_of_the_error_with_the_leak_is_a_table(tables):
    grown = {"family": ["all", "step", "sine"], "ratio": [2.5, 3.0, 2.0]}
    growth = pd.DataFrame({"controller": np.repeat(["PID", ODD_NAME], 3), **{k: 2 * v for k, v in grown.items()}})
    growth = growth.assign(ratio_low=growth["ratio"], ratio_high=growth["ratio"])
    rows = Parsed(controllers_page("Trial", {**tables, "growth": growth}).html()).rows
    assert ["PID", "2.50 (2.50 to 2.50)", "3.00 (3.00 to 3.00)", "2.00 (2.00 to 2.00)"] in rows


@pytest.mark.parametrize(
    ("ratio", "verdict"),
    [
        ((0.8, 0.7, 0.9), f"{ODD_NAME} positions best: 80 % of the error of PID, every kind"),
        ((1.25, 1.1, 1.4), "No controller is clearly better than PID."),
        ((0.9, 0.7, 1.1), "No controller is clearly better than PID."),
        ((0.5, np.nan, np.nan), "No controller is clearly better than PID."),  # too few plants for an interval
    ],
)
def test_nobody_is_called_best_without_a_clear_difference(tables, ratio, verdict):
    compared = tables["comparison"].copy()
    compared.loc[compared["group"] == "all", ["equal_weight", "equal_weight_low", "equal_weight_high"]] = ratio
    assert verdict in shown({**tables, "comparison": compared})


def test_a_policy_is_compared_with_the_controller_that_it_corrects(tables):
    compared = tables["comparison"]
    row = compared.iloc[[0]].assign(controller="PPO", against=ODD_NAME, ratio=0.9, ratio_low=0.9, ratio_high=0.9)
    corrected = row.assign(share_better=1.0, travel_ratio=1.0, reversals_ratio=1.0, energy_ratio=1.0)
    both = pd.concat([compared, corrected], ignore_index=True)
    found = Parsed(controllers_page("Trial", {**tables, "comparison": both}).html()).rows
    (row,) = [row for row in found if row[:2] == ["PPO", ODD_NAME]]
    assert row[2] == "0.900 (0.900 to 0.900)"
    assert row[5:] == ["100", "1.00", "1.00", "1.00"]  # better in all runs, at the same costs


def test_shares_and_sizes_of_the_detection_stand_in_its_tables(tables):
    rates = tables["detection_rates"].copy()
    columns = ["flagged_share", "flagged_share_low", "flagged_share_high"]
    rates.loc[rates["value"] == "0.1–0.2", columns] = (0.25, 0.2, 0.3)
    summary = tables["detection_summary"].assign(false_alarm_rate=0.012, median_size_error_factor=[1.31, 1.42])
    table = detection_table(summary)
    assert table.loc["False alarms at this threshold, %"].tolist() == pytest.approx([1.2, 1.2])
    assert table.loc["Size: factor of error, half of the leaks within"].tolist() == [1.31, 1.42]
    assert "25.0 (20.0 to 30.0)" in shown({**tables, "detection_rates": rates, "detection_summary": summary})


def test_learning_is_told_against_the_baseline_with_the_range_of_the_seeds():
    steps = np.array([1e5, 2e5])
    seeds = [pd.DataFrame({"steps": steps, ERROR: e, "controller": f"PPO#{n}"}) for n, e in enumerate((0.2, 0.3, 0.7))]
    axes = learning_axes(pd.concat(seeds), "PID", 0.5)
    (container,) = [each for each in axes.containers if each.get_label() == "PPO"]
    line, _, (bars,) = container.lines
    np.testing.assert_allclose(line.get_xydata(), [[100.0, 0.6], [200.0, 0.6]])  # the median seed
    np.testing.assert_allclose(bars.get_segments()[0][:, 1], [0.4, 1.4])
    axes = learning_axes(seeds[0].assign(**{BASE_ERROR: 0.34}), "PID", 0.5)
    assert "corrected controller" in axes.get_legend_handles_labels()[1]


# Several conditions ---------------------------------------------------------------------------------------------------


def test_a_protocol_shows_its_conditions_and_what_did_not_run():
    found = Parsed(controllers_page("Robustness", protocol_tables()).html())
    assert "Good positions best: 70 % of the error of PID, every kind" in found.text
    assert "no controller of this name is tuned for 10 ms" in found.text
    assert ["sha256", "41b35ac0"] in found.rows
    assert ["Leak past the piston", "0.01 l/min", "0.200", "0.50", "0.80"] in found.rows
    assert "nan" not in found.text.lower()
    ratios = overview(protocol_tables())["error ÷ PID's"]["equal weights"].tolist()
    assert ratios == ["–", "0.70 (0.60 to 0.80)", "0.95 (0.85 to 1.05)"]


def test_a_cell_has_a_colour_only_where_the_whole_interval_is_on_one_side_of_1():
    values, kinds = heat_map(protocol_tables(), "equal_weight")
    groups = list(dict.fromkeys(values.index.get_level_values(0)))
    assert groups == ["", "Leak past the piston", "Timing", "Assumed parameters, one at a time"]
    values, kinds = values.droplevel(0), kinds.droplevel(0)
    assert kinds.loc["8 l/min"].to_dict() == {"Good": "better-2 best", "Fair": ""}
    assert kinds.loc["latency 5 ms", "Good"] == "worse-2"
    assert kinds.loc["0.01 l/min", "Good"] == "better-3 best"  # half the error
    assert kinds.loc["period 10 ms", "Good"] == ""
    assert values.loc["0.01 l/min"].to_dict() == {"PID, mm": 0.2, "Good": 0.5, "Fair": 0.8}


def test_limit_cycles_are_counted_by_condition():
    counts = cycles_by_condition(protocol_tables()["limit_cycles"], ["PID", "Good", "Fair"])
    assert counts.to_dict("index") == {"leak_0.01": {"PID": "1 of 2", "Good": "0 of 1", "Fair": "–"}}


def test_numbers_and_names_as_a_person_writes_them():
    assert [number(x) for x in (0.0, 1234.5, 12.345, 0.98765, 0.001234)] == ["0", "1234", "12.3", "0.988", "0.00123"]
    assert [number(float("nan")), number(0.0000123), number(948.14, digits=4)] == ["–", "0.0000123", "948.1"]
    assert [number(-12.3), number(-0.0004, 2), number(-0.0)] == ["−12.3", "0.00", "0"]
    assert [duration(x) for x in (1.25, 75.0, 3725.0)] == ["1.2 s", "1 min 15 s", "1 h 2 min"]
    assert correction_name("PPO", "Flow linearisation") == "PPO on flow linearisation"
    assert correction_name("PPO on flow linearisation", "Flow linearisation") == "PPO on flow linearisation"
    assert markdown(["a|b", "mm"], [["x", "1"]]) == "| a\\|b | mm |\n|---|---:|\n| x | 1 |"
    frame = pd.DataFrame({"mm": [0.5]}, index=pd.Index(["PID"], name="controller"))
    assert frame_markdown(frame, 2) == "| controller | mm |\n|---|---:|\n| PID | 0.50 |"
