"""A model card holds the numbers of the tables, in a head that hubs read, and code that runs."""

import re
from types import SimpleNamespace

import pandas as pd
import pytest
import yaml

from agents.evaluation.opponents import shipped
from agents.leakage.head import LeakageHead
from agents.running.folders import pretrained_folder
from agents.study.model_cards import card_file, controller_card, head_card
from hydro_env import TaskConfig

RATIOS = pd.DataFrame(
    [
        ("PPO", "PID", "all", "", 0.68895443, 0.66924653, 0.70719858),
        ("PPO", "PID", "level", "0.3", 0.7, 0.6, 0.8),
        ("PPO", "PID", "family", "ramp", 0.5, 0.4, 0.6),
        ("PPO", "PID", "equal_weight", "geometric mean", 0.62, 0.6, 0.64),
        ("other", "PID", "all", "", 9.0, 8.0, 10.0),
    ],
    columns=["controller", "against", "group", "value", "ratio", "low", "high"],
)
RATES = pd.DataFrame(
    [("PID", "class", "healthy", 0.002, 0.001, 0.005), ("PID", "range", "0.1–0.2", 0.95, 0.92, 0.97)],
    columns=["controller", "group", "value", "flagged_share", "low", "high"],
)
EVALUATION = SimpleNamespace(ratios=RATIOS, detection_rates=RATES)


@pytest.fixture(scope="module")
def policy():
    return shipped("ppo", TaskConfig())


def parts(card):
    _, front, text = card.split("---\n", 2)
    return yaml.safe_load(front), text


def test_the_card_of_a_policy_holds_its_ratios(policy):
    front, text = parts(controller_card("PPO", policy, EVALUATION, "hydro study"))
    assert front["library_name"] == "stable-baselines3"
    (result,) = front["model-index"][0]["results"]
    assert [one["value"] for one in result["metrics"]] == [0.689, 0.7, 0.5, 0.62]
    assert result["metrics"][1]["name"] == "mean error / PID's, leak of 0.3 l/min"
    assert len({one["type"] for one in result["metrics"]}) == 4
    assert "| mean error / PID's, all | 0.689 | 0.6692 to 0.7072 |" in text
    training, task = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.S))
    assert training == policy.training
    assert TaskConfig(**task) == policy.features.config


def test_the_card_of_a_head_holds_its_rates():
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    front, text = parts(head_card(head, EVALUATION, "hydro evaluate"))
    names = [one["name"] for one in front["model-index"][0]["results"][0]["metrics"]]
    assert names == ["false alarms under PID, healthy seal", "leaks flagged under PID, 0.1–0.2 l/min"]
    assert "| 0.95 | 0.92 to 0.97 |" in text


def test_a_controller_without_training_has_no_card():
    assert controller_card("PID", shipped("pid", TaskConfig()), EVALUATION, "") is None


def test_the_code_on_the_cards_runs(policy, monkeypatch):
    monkeypatch.chdir(pretrained_folder())
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    for card in (controller_card("PPO", policy, EVALUATION, ""), head_card(head, EVALUATION, "")):
        (code,) = re.findall(r"```python\n(.*?)```", card, re.S)
        exec(code.replace("PPO/policy", "policy"), {})


@pytest.mark.parametrize(("name", "file"), [("PPO", "PPO.md"), ("../a b", "_a_b.md"), ("PPO 2.5", "PPO_2.5.md")])
def test_any_name_gives_a_file_in_its_folder(name, file):
    assert card_file(name) == file
