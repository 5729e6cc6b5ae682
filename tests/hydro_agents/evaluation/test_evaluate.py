"""The protocol: which cases are run, who is compared with whom, and what a failing controller costs."""

import warnings

import numpy as np
import pandas as pd
import pytest
from published import assert_published
from refusal import refused

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.evaluation.evaluate import ProtocolSettings, evaluate
from hydro_agents.running.cases import ControllerError, run_cases
from hydro_agents.running.seeds import TEST_SEEDS
from hydro_env import REFERENCE_FAMILIES, TaskConfig
from hydro_env.task.reference_signals import MOVING_FAMILIES

CONFIG = TaskConfig(episode_duration=0.4)
LAYOUT = ObservationLayout.of(CONFIG)
SETTINGS = ProtocolSettings(plants=3, leak_levels=(0.01, 4.0), families=("step", "sine"))
STRONG, WEAK = PID(PIDGains(proportional=200.0), CONFIG), PID(PIDGains(proportional=40.0), CONFIG)


def cases_of(**settings):
    """The cases of an evaluation, and their table."""
    protocol = ProtocolSettings(**settings).protocol(CONFIG)
    table = protocol.cases_in("task")
    return protocol.cases_of("task", table), table


def test_seeds_of_the_protocol_do_not_move():
    cases, table = cases_of(plants=3)
    assert (len(cases), cases.seeds.dtype) == (7 * 6 * 3, np.int64)
    expected = 2_000_000 + 10_000 * table["family"].map(REFERENCE_FAMILIES.index) + table["plant"]
    np.testing.assert_array_equal(cases.seeds, expected)
    assert list(table["plant"][:3]) == [0, 1, 2]
    assert list(dict.fromkeys(table["family"])) == list(MOVING_FAMILIES)
    largest, _ = cases_of(plants=10_000, leak_levels=(1.0,))
    assert len(set(largest.seeds)) == 60_000
    assert max(largest.seeds) < TEST_SEEDS.stop


def test_every_part_of_the_result_is_made_from_its_own_cases(evaluation):
    result, phases = evaluation
    assert_published("study", result.tables())
    assert result.controllers == ["strong", "weak"]
    compared = result.table("comparison")
    assert (set(compared["controller"]), set(compared["against"])) == ({"weak"}, {"strong"})
    for name in ("cases", "limit_cycle_summary"):
        assert list(result.table(name)["controller"].unique()) == ["strong", "weak"]
    assert result.errors == []
    assert [done for _, done, _ in phases] == list(range(5))  # both controllers track and rest


@pytest.fixture(scope="module")
def evaluation():
    phases = []
    result = evaluate(CONFIG, {"strong": STRONG, "weak": WEAK}, SETTINGS, lambda *args: phases.append(args))
    return result, phases


def test_every_case_is_in_the_table_with_its_own_error(evaluation):
    result, _ = evaluation
    cases, table = cases_of(**SETTINGS.model_dump())
    own = result.table("cases").query("controller == 'weak'").reset_index(drop=True)
    np.testing.assert_array_equal(own["seed"], cases.seeds)
    pd.testing.assert_frame_equal(own[list(table)], table, check_dtype=False)
    run = run_cases(CONFIG, WEAK, cases)
    error = 1e3 * np.abs(run.reference.astype(np.float64) - run.position).mean(axis=1)
    np.testing.assert_allclose(own["mean_error_mm"], error, rtol=1e-12)


class NotANumber:
    """Returns NaN on the second axis of a batch, after ten steps."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = 0 if state is None else state
        command = np.zeros((len(observation), 1))
        command[1] = np.nan if step == 10 else 0.0
        return command, step + 1


def test_a_failing_controller_costs_only_its_own_results_and_is_no_yardstick():
    with pytest.warns(UserWarning, match=r"bad under task: seed 2000001, reference step, leak 0.01 l/min, at 0.050 s"):
        result = evaluate(CONFIG, {"bad": NotANumber(), "strong": STRONG, "weak": WEAK}, settings=SETTINGS)
    assert [error.partition(": seed")[0] for error in result.errors] == ["bad under task"]
    assert set(result.table("comparison")["against"]) == {"strong"}
    alone = evaluate(CONFIG, {"strong": STRONG, "weak": WEAK}, settings=SETTINGS)
    for name in ("cases", "summary", "comparison", "ranking"):
        pd.testing.assert_frame_equal(
            result.table(name).drop(columns="failed_conditions", errors="ignore"),
            alone.table(name).drop(columns="failed_conditions", errors="ignore"),
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ControllerError, match=r"bad: .*returned nan.*worse: .*returned nan"):
            evaluate(CONFIG, {"bad": NotANumber(), "worse": NotANumber()}, settings=SETTINGS)


def test_what_cannot_take_part_is_refused_at_once():
    for controllers, message in (
        ({"PID": STRONG, "mine": lambda observation: 0.0}, "mine: function has no method predict"),
        ({"mine": PID}, "mine: PID is a class"),
        ({"mine": "model.zip"}, "mine: model.zip: a zip file of stable-baselines3 runs code"),
        ({}, "at least one controller"),
    ):
        with refused(message):
            evaluate(CONFIG, controllers, SETTINGS)
    other = TaskConfig(episode_duration=0.4, control_period=0.004)
    with refused("PID: was trained on other observations"):
        evaluate(other, {"PID": STRONG}, settings=SETTINGS)
