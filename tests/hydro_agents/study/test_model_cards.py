"""A model card holds the numbers of the tables, in a head that hubs read, and code that runs."""

import json
import re
from types import SimpleNamespace

import pandas as pd
import pytest
import yaml

from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.study.model_cards import card_file, controller_card, head_card
from hydro_env import TaskConfig

SHIPPED = sorted(pretrained_folder().glob("*.safetensors"))
NAME = "PPO on flow linearisation"
RATIOS = pd.DataFrame(
    [
        (NAME, "PID", "all", "", 0.68895443, 0.66924653, 0.70719858),
        (NAME, "PID", "level", "0.3", 0.7, 0.6, 0.8),
        (NAME, "PID", "family", "ramp", 0.5, 0.4, 0.6),
        (NAME, "PID", "equal_weight", "geometric mean", 0.62, 0.6, 0.64),
        ("other", "PID", "all", "", 9.0, 8.0, 10.0),
    ],
    columns=["controller", "against", "group", "value", "ratio", "low", "high"],
)
RATIOS[["ratio_sensor", "ratio_sensor_low", "ratio_sensor_high"]] = RATIOS[["ratio", "low", "high"]] / 2.0
SCORE = pd.DataFrame({"controller": ["PID", NAME], "score": [0.0, 64.0], "low": [0.0, 61.0], "high": [0.0, 67.0]})
RATES = pd.DataFrame(
    [("PID", "class", "healthy", 0.002, 0.001, 0.005), ("PID", "range", "0.1–0.2", 0.95, 0.92, 0.97)],
    columns=["controller", "group", "value", "flagged_share", "low", "high"],
)
ERRORS = {
    "PID": (1.0, 2.0, 3.0),
    "Flow linearisation": (0.5, 1.0, 1.5),
    NAME: (0.4, 0.8, 1.2),
    "other": (9.0, 9.0, 9.0),
}
CASES = pd.DataFrame(
    [
        (name, family, plant, error, 0.5 if name == NAME else 1.0, float((name, plant, family) == (NAME, 2, "step")))
        for name, errors in ERRORS.items()
        for family in ("step", "ramp")
        for plant, error in enumerate(errors)
    ],
    columns=["controller", "family", "plant", "mean_error_mm", "valve_travel_per_s", "failed"],
).assign(
    mean_error_sensor_mm=lambda table: table["mean_error_mm"] / 2.0,
    leakage_flow_lpm=0.3,
    supply_energy_j=300.0,
    steady_state_error_sensor_mm=0.1,
    reversals_per_s=2.0,
    peak_error_sensor_mm=1.0,
)
EVALUATION = SimpleNamespace(ratios=RATIOS, detection_rates=RATES, cases=CASES, score=SCORE, controllers=list(ERRORS))


@pytest.fixture(scope="module")
def policy():
    return shipped("ppo", TaskConfig())


def parts(card):
    _, front, text = card.split("---\n", 2)
    return yaml.safe_load(front), text


def rows_of(text):
    """The figures of the table on a card, by name."""
    return {name: float(value) for name, value in re.findall(r"^\| (.+?) \| ([\d.e-]+) \|", text, re.M)}


def test_the_card_of_a_policy_holds_errors_and_their_price(policy):
    front, text = parts(controller_card(NAME, policy, EVALUATION, "hydro study", "Flow linearisation"))
    assert front["library_name"] == "hydro_env"
    values = rows_of(text)
    assert values == {
        "score (0: PID, 100: best found)": 64.0,
        "mean error / PID's, all": 0.689,
        "mean error / PID's, leak of 0.3 l/min": 0.7,
        "mean error / PID's, reference ramp": 0.5,
        "mean error in the sensor's frame / PID's, all": 0.3445,
        "mean error / PID's, every kind of reference weighs the same": 0.62,
        "mean error in the sensor's frame / PID's, every kind of reference weighs the same": 0.31,
        "mean error / Flow linearisation's, all": 0.8,
        "mean error in the sensor's frame / Flow linearisation's, all": 0.8,
        "mean error / Flow linearisation's, every kind of reference weighs the same": 0.8,
        "mean error in the sensor's frame / Flow linearisation's, every kind of reference weighs the same": 0.8,
        "valve travel / PID's, all": 0.5,
        "reversals / PID's, all": 1.0,
        "energy from the supply / PID's, all": 1.0,
        "share of runs that failed": 0.1667,
    }
    assert "| mean error / PID's, all | 0.689 | 0.6692 to 0.7072 |" in text
    assert "bore 40 mm, stroke" in text
    assert "control period of 5 ms" in text
    (training,) = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.S))
    assert training == policy.training


def test_the_card_of_a_head_holds_its_rates():
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    front, text = parts(head_card(head, EVALUATION, "hydro evaluate"))
    assert front["pipeline_tag"] == "tabular-classification"
    assert list(rows_of(text)) == ["false alarms under PID, healthy seal", "leaks flagged under PID, 0.1–0.2 l/min"]
    assert "| 0.95 | 0.92 to 0.97 |" in text


def test_a_controller_without_training_has_no_card():
    assert controller_card("PID", shipped("pid", TaskConfig()), EVALUATION, "") is None


def run(card):
    """Run the code on a card; returns the loaded weights."""
    (code,) = re.findall(r"```python\n(.*?)```", card, re.S)
    space = {}
    exec(code, space)
    if "policy" in space:
        assert space["over"]
        return space["policy"]
    assert space["probability"] > 0.5
    least = 0.4 if space["head"].rig.size == 0 else 0.2  # one for any axis reads small leaks too small
    assert least < space["flow_lpm"] < 0.65  # 0.5 l/min
    return space["head"].settings


def test_the_code_on_the_cards_runs(policy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy.save(tmp_path / "controllers" / "PPO" / "policy")
    card = controller_card(NAME, policy, EVALUATION, "", weights="controllers/PPO/policy")
    assert run(card).training == policy.training
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    head.save(tmp_path / "leakage_head")
    assert run(head_card(head, EVALUATION, "", weights="leakage_head")) == head.settings


@pytest.mark.parametrize("weights", SHIPPED, ids=lambda path: path.stem)
def test_the_card_beside_shipped_weights_is_theirs_and_its_code_runs(weights):
    _, text = parts(weights.with_suffix(".md").read_text(encoding="utf-8"))
    stored = json.loads(weights.with_suffix(".json").read_text())
    (training,) = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.S))
    assert training == stored["training"], "run: python benchmarks/model_cards.py"
    assert len(rows_of(text)) > 10
    assert "python benchmarks/model_cards.py policy" in text
    assert run(text).training == training


@pytest.mark.parametrize(
    ("name", "file"), [(NAME, "PPO_on_flow_linearisation.md"), ("../a b", "_a_b.md"), ("PPO 2.5", "PPO_2.5.md")]
)
def test_any_name_gives_a_file_in_its_folder(name, file):
    assert card_file(name) == file
