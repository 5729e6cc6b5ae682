"""The page of controllers: its verdict and its tables say what the tables of the run say."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from made_up_tables import protocol_tables
from parsed_page import ODD_NAME, Parsed

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.evaluation.evaluate import ProtocolSettings, evaluate
from hydro_agents.report.controllers_page import Example, controllers_page, errors, heat_map, overview, verdict
from hydro_agents.report.kit import Page, drawn
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
SETTINGS = ProtocolSettings(plants=3, leak_levels=(0.01, 4.0), families=("step", "sine"), standstill_plants=1)


def shown(tables, **parts):
    facts = pd.DataFrame({"key": ["command", "seed"], "value": ["hydro study", "3"]})
    return Parsed(controllers_page("Trial", {**tables, "protocol": facts}, **parts).html()).text


def text_of(part, *arguments):
    """The text of one part of the page."""
    page = Page("Trial")
    drawn(part)(page, *arguments)
    return Parsed(page.html()).text


@pytest.fixture(scope="module")
def tables():
    gains = {"PID": 200.0, ODD_NAME: 60.0}
    controllers = {name: PID(PIDGains(proportional=gain), CONFIG) for name, gain in gains.items()}
    return evaluate(CONFIG, controllers, SETTINGS).tables()


def test_the_page_shows_every_part(tables):
    time = np.linspace(0.005, 0.4, 80)
    moved = 0.01 * (1.0 - np.exp(-time / 0.05))
    traces = SimpleNamespace(time=time, reference=np.full((1, 80), 0.01), position=moved[None], command=moved[None])
    example = Example("the same with 4 l/min", 4.0, dict.fromkeys(("PID", ODD_NAME), traces), 0)
    text = shown(tables, examples=[example], configuration="task:\n  control_period: 0.005 # <&>\n")
    for part in ("Single runs", "control_period: 0.005 # <&>", ODD_NAME):
        assert part in text
    assert "A small run: 3 plants" in text
    assert "no test seeds" not in text
    cases = tables["cases"]
    assert "no test seeds" in text_of(verdict, {**tables, "cases": cases.assign(seed=cases["seed"] - 2_000_000)})


def test_one_controller_alone():
    settings = SETTINGS.model_copy(update={"leak_levels": (0.3,), "families": ("step",)})
    text = shown(evaluate(CONFIG, {"PID": PID(PIDGains(), CONFIG)}, settings).tables())
    for absent in ("Ratio of errors by", "nan", "clearly better"):
        assert absent not in text


@pytest.mark.parametrize(
    ("ratio", "told"),
    [
        ((0.8, 0.7, 0.9), f"{ODD_NAME} positions best: 80 % of the error of PID, every kind"),
        ((1.25, 1.1, 1.4), "No controller is clearly better than PID."),
        ((0.9, 0.7, 1.1), "No controller is clearly better than PID."),
        ((0.5, np.nan, np.nan), "No controller is clearly better than PID."),  # too few plants for an interval
    ],
)
def test_nobody_is_called_best_without_a_clear_difference(tables, ratio, told):
    compared = tables["comparison"].copy()
    compared.loc[compared["group"] == "all", ["equal_weight", "equal_weight_low", "equal_weight_high"]] = ratio
    assert told in text_of(verdict, {**tables, "comparison": compared})


def test_a_policy_is_compared_with_the_controller_that_it_corrects(tables):
    compared = tables["comparison"]
    weights = {"equal_weight": 0.9, "equal_weight_low": 0.8, "equal_weight_high": 0.95, "share_better": 1.0}
    corrected = compared.iloc[[0]].assign(controller="PPO", against=ODD_NAME, **weights)
    both = pd.concat([compared, corrected], ignore_index=True)
    page = Page("Trial")
    errors(page, {**tables, "comparison": both})
    (row,) = [row for row in Parsed(page.html()).rows if row[0] == f"PPO ÷ {ODD_NAME}"]
    assert (row[1], row[4]) == ("0.90 (0.80 to 0.95)", "100")


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
    values, kinds = heat_map(protocol_tables())
    groups = list(dict.fromkeys(values.index.get_level_values(0)))
    assert groups == ["", "Leak past the piston", "Timing", "Assumed parameters, one at a time"]
    values, kinds = values.droplevel(0), kinds.droplevel(0)
    assert kinds.loc["8 l/min"].to_dict() == {"Good": "better-2 best", "Fair": ""}
    assert kinds.loc["latency 5 ms", "Good"] == "worse-2"
    assert kinds.loc["0.01 l/min", "Good"] == "better-3 best"  # half the error
    assert kinds.loc["period 10 ms", "Good"] == ""
    assert values.loc["0.01 l/min"].to_dict() == {"PID, mm": 0.2, "Good": 0.5, "Fair": 0.8}
