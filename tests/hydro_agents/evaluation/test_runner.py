"""Jobs: merged results equal a run alone bit for bit, finished work is used again, failures stay where they are."""

import pandas as pd
import pytest
from command_line import ROOT
from small_protocol import Proportional, small

from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.evaluation.robustness_protocol import Participants, participants
from hydro_agents.evaluation.runner import DONE, FAILED, NOT_APPLICABLE, run
from hydro_agents.running.jobs import JOBS_FOLDER

ROOM = {"standstill_leak_levels": [1.0], "standstill_plants": 3}


def two():
    return Participants({"P": Proportional(), "PID": participants({"PID": "pid"}, small()).controllers["PID"]})


@pytest.fixture(scope="module")
def alone():
    """A protocol whose jobs ran one after another in this process."""
    return run(small(**ROOM), two())


def assert_same(results, other):
    pd.testing.assert_frame_equal(results.part("cases"), other.part("cases"), check_exact=True)
    pd.testing.assert_frame_equal(results.part("limit_cycles"), other.part("limit_cycles"), check_exact=True)
    pd.testing.assert_frame_equal(results.status, other.status)


def test_every_case_has_its_row(alone):
    assert len(alone.part("cases")) == 2 * 2 * 12
    assert set(METRICS) <= set(alone.part("cases").columns)
    assert (alone.status["status"] == DONE).all()
    assert len(alone.part("limit_cycles")) == 2 * 2 * 3


def test_an_interrupted_run_keeps_its_finished_jobs_and_goes_on(alone, tmp_path):
    class InterruptedError(Exception):
        pass

    def stop(phase, done, total):
        if done == 3:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(small(**ROOM), two(), tmp_path, progress=stop)
    assert len(list((tmp_path / JOBS_FOLDER).iterdir())) == 3
    counts = []
    results = run(small(**ROOM), two(), tmp_path, progress=lambda *report: counts.append(report))
    assert counts[0][1] == 3
    assert counts[-1][1] == counts[-1][2]
    assert_same(results, alone)


# Failures ----------------------------------------------------------------------------------------------------------


class Fussy(Proportional):
    """Fails on two axes."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if len(observation) == 2:
            raise RuntimeError("two axes are too few")
        return super().predict(observation, state)


def test_a_controller_that_fails_loses_what_it_fails_under_alone():
    conditions = {"plain": {}, "few": {"plants": 4, "leak_levels": [0.03], "families": ["step", "sine"]}}
    results = run(small(conditions=conditions, chunk=6), Participants({"P": Proportional(), "fussy": Fussy()}))
    assert set(results.part("cases").query("controller == 'fussy'")["condition"]) == {"plain"}
    (error,) = results.errors
    assert results.status.set_index(["controller", "condition"]).loc[("fussy", "few"), "status"] == FAILED
    assert "fussy under few" in error
    assert "RuntimeError: two axes are too few" in error


def test_a_condition_that_cannot_begin_is_told_and_the_others_stay():
    conditions = {"plain": {}, "bent": {"parameters": {"load.external_force": 9e4}}}
    results = run(small(conditions=conditions), Participants({"P": Proportional()}))
    assert set(results.part("cases")["condition"]) == {"plain"}
    assert "P under bent: the run cannot begin:" in results.errors[0]


# Who runs where ------------------------------------------------------------------------------------------------------


def test_other_periods_and_rigs_need_controllers_of_their_own():
    conditions = {
        "plain": {},
        "slow": {"task": {"control_period": 0.01}},
        "rig": {"rig": str(ROOT / "configs" / "rigs" / "symmetric_eha.yaml")},
    }
    protocol = small(conditions=conditions)
    results = run(protocol, participants({"PID": "pid"}, protocol))
    status = results.status.set_index("condition")
    assert status.loc["plain", "status"] == DONE
    assert status.loc["slow", "status"] == status.loc["rig", "status"] == NOT_APPLICABLE
    assert "10 ms" in status.loc["slow", "message"]
    assert not results.errors
    choice = {"PID": {"proportional": 15.0}}
    named = small(conditions={"plain": {}, "slow": {**conditions["slow"], "controllers": choice}})
    ready = participants({"PID": "pid"}, named)
    assert set(run(named, ready).part("cases")["condition"]) == {"plain", "slow"}
    assert ready.of("PID", "slow", named).gains.proportional == 15.0
    assert ready.of("PID", "slow", named).layout.control_period == 0.01
    assert ready.of("PID", "plain", named).layout.control_period == 0.005
