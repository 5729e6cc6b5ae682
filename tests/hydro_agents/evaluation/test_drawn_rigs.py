"""Agents on drawn rigs: the same plants as the baseline's, errors and returns that are those of the episodes."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.evaluation.drawn_rigs import UNTUNED, cases_of, on_drawn_rigs, summary
from hydro_agents.running.cases import run_cases
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.signals import observation_layout

LAW = {"split": "test", "count": 2, "first": 40}
DRAWN = task_config(law=LAW, episode_duration=0.3)


class Still:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), state


class Proportional:
    def __init__(self, task):
        self.column = task.law is not None and list(observation_layout(task)[0]).index("tracking_error")

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.clip(0.3 * observation[:, [self.column]], -1.0, 1.0), state


def test_an_agent_moves_the_plants_of_the_rigs_own_task():
    one = task_config(DRAWN, law={"first": 41, "count": 1})
    own = rig_tasks(task_config(DRAWN, law={"preview_paces": ()}))[1]
    there, here = (run_cases(task, Still(), cases_of(1, 1)) for task in (one, own))
    np.testing.assert_array_equal(there.position, here.position)
    np.testing.assert_array_equal(there.reference, here.reference)
    assert there.time[-1] == pytest.approx(0.3)
    with refused("a run is on one rig"):
        run_cases(DRAWN, Still(), cases_of(0, 1))


def test_errors_are_ratios_to_untuned_flow_linearisation_and_jobs_are_kept(tmp_path):
    agents = dict.fromkeys(("mine#0", "mine#1"), f"{__name__}:Proportional")  # seeds of a training share a row
    rows = on_drawn_rigs(DRAWN, agents, 1, tmp_path)
    assert rows["agent"].tolist() == [UNTUNED] * 2 + ["mine"] * 4
    assert (rows["return"] < 0.0).all()
    first, mine = summary(rows)
    assert first[2].startswith("1.000")
    ratio = rows["error_um"].to_numpy()[2:4] / rows["error_um"].to_numpy()[:2]
    assert (ratio > 1.0).all()
    assert mine[2].startswith(f"{np.median(ratio):.3f}")
    assert on_drawn_rigs(DRAWN, agents, 1, tmp_path).equals(rows)


class Broken(Proportional):
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("my own fault")


def test_an_agent_that_fails_fails_on_the_first_rig(tmp_path):
    seen = []
    with refused("mine, rig 0: .*predict failed: .*my own fault"):
        on_drawn_rigs(DRAWN, {"mine": f"{__name__}:Broken"}, 1, tmp_path, lambda *told: seen.append(told))
    assert not seen
