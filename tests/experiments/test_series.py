"""All experiments on several controllers: independent jobs, and a broken controller among them."""

from functools import partial

import numpy as np
import pandas as pd
from joblib import parallel_config
from proportional import Proportional
from published import TABLES, assert_published

from hydro_agents.evaluation import experiments
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.robustness_protocol import EXPERIMENTS, RobustnessProtocol
from hydro_agents.evaluation.runner import run


class Broken:
    """A controller that returns NaN."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), np.nan), None


def test_a_broken_controller_loses_its_own_rows_only(monkeypatch):
    for name, experiment in experiments.EXPERIMENTS.items():
        monkeypatch.setitem(experiments.EXPERIMENTS, name, partial(experiment, plants=1))
    protocol = RobustnessProtocol(parts=EXPERIMENTS, conditions={"plain": {}})
    good = Proportional(100.0, protocol.task)
    results = run(protocol, Participants({"P#0": good, "P#1": good, "broken": Broken()}), jobs=1)
    assert {error.partition(":")[0] for error in results.errors} == {
        f"broken under {name}" for name in EXPERIMENTS if name != "leak_price"
    }
    tables = {name: results.table(name) for name in TABLES["experiments"]}
    assert_published("experiments", tables)
    assert all(set(table["controller"]) == {"P"} for name, table in tables.items() if name != "leak_price")

    with parallel_config(backend="threading", n_jobs=2):
        alone = run(protocol, Participants({"P": good}))
    for name, table in tables.items():
        pd.testing.assert_frame_equal(alone.table(name), table, check_exact=True)
