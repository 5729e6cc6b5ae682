"""``hydro evaluate --protocol``: tables, resumption, own agents, and one line for what is wrong."""

import pandas as pd
import pytest
import yaml
from command_line import assert_one_clear_line, done, hydro
from published import assert_published
from small_protocol import SMALL

OWN = ("evaluate", "--protocol", "own.yaml", "-c", "study.yaml", "-j", "1")

AGENTS = """
import numpy as np

class Calm:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), None

class Wild(Calm):
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), np.nan), None

class Telling(Calm):
    def __init__(self, task):
        raise ValueError(f"{task.law.count} rigs, {task.law.split}")
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a small protocol and a module of agents."""
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(SMALL, sort_keys=False))
    (tmp_path / "study.yaml").write_text("controllers:\n  PID: {kind: pid}\n")
    (tmp_path / "robust_agents.py").write_text(AGENTS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_own_agents_and_training_seeds_stand_in_every_table(place):
    (place / "own.yaml").write_text(yaml.safe_dump({**SMALL, "standstill_plants": 1}, sort_keys=False))
    answer = done(*OWN, "--agent", "calm#0=robust_agents:Calm", "--agent", "calm#1=robust_agents:Calm")
    tables = place / "results" / "own" / "tables"
    assert_published("robustness+seeds", tables)
    assert set(pd.read_csv(tables / "ranking.csv")["controller"]) == {"PID", "calm"}
    cases = pd.read_csv(tables / "cases.csv")
    assert set(cases.loc[cases["controller"] == "calm", "training_seed"]) == {0, 1}
    assert set(pd.read_csv(tables / "comparison.csv")["group"]) == {"all", "condition", "family"}
    facts = pd.read_csv(tables / "protocol.csv").set_index("key")["value"]
    assert len(facts["sha256"]) == 64
    assert facts["command"].startswith("hydro evaluate --protocol own.yaml")
    assert "calm" in answer.stdout
    assert (place / "results" / "own" / "robustness.html").is_file()


def test_a_failing_agent_is_named_and_resuming_uses_the_finished_jobs(place):
    answer = hydro(*OWN, "-o", "out", "--agent", "wild=robust_agents:Wild")
    assert_one_clear_line(answer, "wild under plain", "seed 22", "predict returned nan", "status.csv", "out holds")
    first = pd.read_csv("out/tables/cases.csv")
    assert set(first["controller"]) == {"PID"}
    assert_one_clear_line(hydro(*OWN, "-o", "out"), "holds results already", "--resume continues")
    done(*OWN, "-o", "out", "--resume", "--agent", "calm=robust_agents:Calm")
    cases = pd.read_csv("out/tables/cases.csv")
    pd.testing.assert_frame_equal(cases[cases["controller"] == "PID"].reset_index(drop=True), first, check_exact=True)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--protocol", "robst"), ("protocol 'robst': unknown", "quick, robustness")),
        (("--rig", "drawn", "--period", "1ms"), ("--period: has no meaning on drawn rigs",)),
        (("--rig", "drawn", "--agent", "x=robust_agents:Telling"), ("100 rigs, test",)),
        (("--protocol", "own.yaml", "--plants", "9"), ("--plants", "from its file")),
        (("--protocol", "leakage_quick", "--agent", "x=pid"), ("--agent: a protocol takes it from its file",)),
    ],
)
def test_what_is_wrong_is_one_line_and_writes_nothing(place, arguments, parts):
    before = sorted(place.iterdir())
    assert_one_clear_line(hydro("evaluate", *arguments), *parts)
    assert sorted(place.iterdir()) == before
