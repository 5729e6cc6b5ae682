"""The protocol: which cases are run, who is compared with whom, and what a failing controller costs."""

import warnings

import numpy as np
import pandas as pd
import pytest
from published import assert_published
from refusal import refused
from untrained import untrained_head

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.detection.head import AT_REST
from hydro_agents.evaluation.detection import detection_cases
from hydro_agents.evaluation.evaluate import ProtocolSettings, evaluate
from hydro_agents.running.cases import ControllerError, run_cases
from hydro_agents.running.seeds import TEST_SEEDS
from hydro_env import REFERENCE_FAMILIES, TaskConfig
from hydro_env.task.reference_signals import MOVING_FAMILIES

CONFIG = TaskConfig(episode_duration=0.4)
LAYOUT = ObservationLayout.of(CONFIG)
SETTINGS = ProtocolSettings(plants=3, leak_levels=(0.01, 4.0), families=("step", "sine"), detection_episodes=100)
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
    watched = detection_cases(CONFIG, 200_000).seeds
    assert watched[0] == 2_500_000
    assert not set(largest.seeds) & set(watched)
    assert max(watched) < TEST_SEEDS.stop


def test_every_part_of_the_result_is_made_from_its_own_cases(evaluation):
    result, phases, _ = evaluation
    assert_published("study", result.tables())
    assert result.controllers == ["strong", "weak"]
    compared = result.table("comparison")
    assert (set(compared["controller"]), set(compared["against"])) == ({"weak"}, {"strong"})
    assert len(result.table("detection")) == 2 * 100
    for name in ("cases", "detection_rates", "limit_cycle_summary"):
        assert list(result.table(name)["controller"].unique()) == ["strong", "weak"]
    assert result.errors == []
    assert [done for _, done, _ in phases] == list(range(7))  # both controllers track, rest and are watched


def test_detection_cases_are_healthy_and_leaking_in_turn():
    cases = detection_cases(CONFIG, 1000)
    flow = cases.leakage_flow_lpm
    assert cases.families is None
    assert np.all((flow[::2] >= 0.003) & (flow[::2] <= 0.03))
    assert np.all((flow[1::2] >= 0.1) & (flow[1::2] <= 4.0))
    assert np.median(flow[::2]) == pytest.approx(np.sqrt(0.003 * 0.03), rel=0.15)  # log-uniform
    assert np.median(flow[1::2]) == pytest.approx(np.sqrt(0.1 * 4.0), rel=0.2)
    np.testing.assert_array_equal(flow, detection_cases(CONFIG, 1000).leakage_flow_lpm)
    other = TaskConfig(leakage={"healthy_range": [0.01, 0.02], "faulty_range": [0.5, 0.6]})
    flow = detection_cases(other, 100).leakage_flow_lpm
    assert flow[::2].max() <= 0.02
    assert flow[1::2].min() >= 0.5


@pytest.fixture(scope="module")
def evaluation():
    head = untrained_head(CONFIG)
    phases = []
    result = evaluate(CONFIG, {"strong": STRONG, "weak": WEAK}, head, SETTINGS, lambda *args: phases.append(args))
    return result, phases, head


@pytest.mark.parametrize(("name", "controller"), [("strong", STRONG), ("weak", WEAK)])
def test_every_case_is_in_the_table_with_its_own_error_and_seen_by_the_head(evaluation, name, controller):
    result, _, head = evaluation
    cases, table = cases_of(**SETTINGS.model_dump())
    own = result.table("cases").query("controller == @name").reset_index(drop=True)
    np.testing.assert_array_equal(own["seed"], cases.seeds)
    pd.testing.assert_frame_equal(own[list(table)], table, check_dtype=False)
    run = run_cases(CONFIG, controller, cases)
    error = 1e3 * np.abs(run.reference.astype(np.float64) - run.position).mean(axis=1)
    np.testing.assert_allclose(own["mean_error_mm"], error, rtol=1e-12)

    own, watched = result.table("detection").query("controller == @name"), detection_cases(CONFIG, 100)
    signals = ("position", "pressure_a", "pressure_b", "spool_position", "previous_command")
    run = run_cases(CONFIG, controller, watched, [LAYOUT.index(signal) for signal in signals], states=False)
    estimate = head.estimate_windows(run.signals.astype(float) * head.scale[:, None])
    np.testing.assert_array_equal(own["probability"], estimate.probability)
    np.testing.assert_array_equal(own["estimated_flow_lpm"], estimate.flow_lpm)
    moving = estimate.outside != AT_REST  # at rest the head does not answer
    np.testing.assert_array_equal(own["flagged"], (estimate.probability >= head.settings.threshold) & moving)
    np.testing.assert_array_equal(own["leakage_flow_lpm"], watched.leakage_flow_lpm)
    np.testing.assert_array_equal(own["seed"], watched.seeds)
    flow = own["leakage_flow_lpm"]
    assert set(own["class"][flow <= 0.03]) == {"healthy"}
    assert set(own["class"][(flow > 0.3) & (flow <= 1.0)]) == {"moderate"}


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
    for name in ("detection", "detection_rates"):
        assert alone.table(name).empty  # there is no head
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ControllerError, match=r"bad: .*returned nan.*worse: .*returned nan"):
            evaluate(CONFIG, {"bad": NotANumber(), "worse": NotANumber()}, settings=SETTINGS)


def test_what_cannot_take_part_is_refused_at_once():
    head = untrained_head(TaskConfig(episode_duration=0.405))
    for controllers, watching, message in (
        ({"PID": STRONG, "mine": lambda observation: 0.0}, None, "mine: function has no method predict"),
        ({"mine": PID}, None, "mine: PID is a class"),
        ({"mine": "model.zip"}, None, "mine: model.zip: a zip file of stable-baselines3 runs code"),
        ({}, None, "at least one controller"),
        ({"PID": STRONG}, head, "leakage head: reads at least 81 observations, an episode has 80"),
    ):
        with refused(message):
            evaluate(CONFIG, controllers, watching, SETTINGS)
    other = TaskConfig(episode_duration=0.4, control_period=0.004)
    with refused("PID: was trained on other observations"):
        evaluate(other, {"PID": STRONG}, settings=SETTINGS)
