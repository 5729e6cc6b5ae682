"""All experiments on several controllers: independent jobs, and a broken controller among them."""

import numpy as np
import pandas as pd
from proportional import Proportional
from published import assert_published

from hydro_agents.evaluation.experiments import EXPERIMENTS, run_experiments
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig


class Broken:
    """A controller that returns NaN."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), np.nan), None


def test_a_broken_controller_loses_its_own_rows_only():
    config, seen = TaskConfig(), []
    controllers = {"broken": Broken(), "P": Proportional(100.0, config)}
    first = VALIDATION_SEEDS.start
    tables, errors = run_experiments(config, controllers, 1, first, progress=lambda *args: seen.append(args))
    assert set(errors) == {"broken"}
    assert errors["broken"].startswith("broken: frequency: ")
    assert_published("experiments", tables)
    assert all(set(tables[name]["controller"]) == {"P"} for name in EXPERIMENTS)
    assert seen[-1][1:] == (2 * len(EXPERIMENTS), 2 * len(EXPERIMENTS))

    alone, _ = run_experiments(config, {"P": controllers["P"]}, 1, first, jobs=2)
    for name, table in tables.items():
        pd.testing.assert_frame_equal(alone[name], table, check_exact=True)
