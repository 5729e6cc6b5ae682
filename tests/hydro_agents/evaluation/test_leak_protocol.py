"""A leakage protocol: its cases, its jobs side by side and again, thresholds, verdicts, bound and failures."""

import numpy as np
import pandas as pd
import pytest
import yaml
from command_line import ROOT
from refusal import refused
from small_leaks import SMALL, Spread, ran, small

from hydro_agents.detection.detector import Cause
from hydro_agents.evaluation.leak_protocol import HEALTHY, LeakProtocol
from hydro_agents.evaluation.leak_tables import judged
from hydro_agents.running.jobs import JOBS_FOLDER
from hydro_agents.running.seeds import LEAKAGE, TEST_SEEDS, VALIDATION_SEEDS
from hydro_env import ConfigurationError


@pytest.fixture(scope="module")
def alone():
    return ran()


def test_every_window_has_its_row(alone):
    assert len(alone.table("windows")) == 10 * (2 + 2)
    assert (alone.status["status"] == "done").all()
    plain = alone.table("windows")[alone.table("windows")["condition"] == "plain"]
    np.testing.assert_allclose(plain.loc[plain["level"] == 1.0, "leak_lpm"], 1.0, rtol=1e-6)
    assert (alone.table("windows")["error_mm"] > 0.0).all()


def test_the_threshold_comes_from_validation_windows_unless_the_detector_has_one(alone):
    row = alone.table("thresholds").iloc[0]
    assert row["windows"] == 20
    assert row["used"] == row["at_1_percent"] > 0.0
    own = Spread()
    own.threshold = 0.5
    other = ran(detectors={"D": own}).table("thresholds").iloc[0]
    assert other["used"] == 0.5
    assert other["at_1_percent"] == row["at_1_percent"]


def test_verdicts_follow_from_score_threshold_and_what_the_detector_says_otherwise():
    windows = pd.DataFrame(
        {
            "detector": "D",
            "failed": [0.0, 0.0, 0.0, 1.0],
            "score": [2.0, 0.0, np.nan, 2.0],
            "otherwise": [Cause.VALVE] * 4,
            "leak_lpm": [1.0, 0.01, 1.0, 1.0],
        }
    )
    found = judged(windows, pd.DataFrame({"detector": ["D"], "used": [1.0], "at_1_percent": [3.0]}))
    assert found["verdict"].tolist() == [Cause.INTERNAL_LEAK, Cause.VALVE, Cause.UNKNOWN]
    assert found["flagged"].tolist() == [True, False, False]
    assert found["at_1_percent"].tolist() == [False, False, False]


def test_what_cannot_run_is_told_and_the_rest_stays():
    run = ran(small(conditions={**SMALL["conditions"], "long": {"duration": 0.5}}))
    told = run.status.set_index("condition").loc["long"]
    assert (told["status"], told["message"]) == ("not applicable", "reads 60 samples")
    assert set(run.table("windows")["condition"]) == {"plain", "null"}
    # A detector without threshold has no figures.
    conditions = {**SMALL["conditions"], "short": {"duration": 0.2}}
    detectors = dict.fromkeys(("D", "E"), SMALL["detectors"]["D"])
    run = ran(small(conditions=conditions, detectors=detectors), {"D": Spread(), "E": Spread(samples=40)})
    assert set(run.table("windows")["detector"]) == {"D"}
    assert "no threshold" in run.status.set_index(["detector", "condition"]).loc[("E", "plain"), "message"]
    with refused("no detector ran under any condition"):
        ran(detectors={"D": Spread(samples=1)})


def test_the_bound_stands_beside_the_windows_and_is_kept(tmp_path):
    conditions = {"plain": SMALL["conditions"]["plain"]}
    protocol = small(bound_conditions=["plain"], bound_windows=2, conditions=conditions)
    run = ran(protocol, folder=tmp_path)
    bound = run.table("bound")
    assert set(bound["level"]) == {0.0, 1.0}
    assert (bound["sigma_lpm"] > 0.0).all()
    assert bound["sigma_lpm"].max() < 2.0  # far below the prior's: the window tells something
    counts = []
    again = ran(protocol, folder=tmp_path, progress=lambda *report: counts.append(report))
    assert counts[0][1] == counts[0][2] == len(list((tmp_path / JOBS_FOLDER).iterdir())) > 0
    pd.testing.assert_frame_equal(again.table("bound"), run.table("bound"), check_exact=True)


def test_every_level_and_condition_has_the_same_plants_and_its_leaks():
    protocol = small()
    cases = [protocol.cases_in(name, level, 40) for name in ("plain", "null") for level in (HEALTHY, 1.0)]
    assert all((each.seeds == cases[0].seeds).all() for each in cases)
    assert set(cases[0].seeds) <= set(TEST_SEEDS)
    assert set(protocol.cases_in("plain", HEALTHY, 10, validation=True).seeds) <= set(VALIDATION_SEEDS)
    assert min(cases[0].seeds) == LEAKAGE.first
    low, high = protocol.task.leakage.healthy_range
    healthy, fixed = (each.leakage_flow_lpm for each in cases[:2])
    assert low <= healthy.min() < healthy.max() <= high
    assert (fixed == 1.0).all()


def test_the_detector_knows_the_rig_and_nothing_else_of_a_condition():
    conditions = {
        **SMALL["conditions"],
        "loud": {"noise_factor": 2.0, "task": {"leakage": {"law": "orifice"}}, "factors": {"load.mass": 2.0}},
        "other": {"rig": str(ROOT / "configs" / "rigs" / "symmetric_eha.yaml")},
    }
    protocol = small(conditions=conditions)
    assert protocol.known_task("loud") == protocol.task
    assert protocol.tasks["loud"].sensors.position.noise == 2.0 * protocol.task.sensors.position.noise
    assert protocol.cases_in("loud", 1.0, 3).parameters["load"]["mass"] == 2.0 * protocol.task.plant.load.mass
    assert protocol.known_task("other").plant == protocol.tasks["other"].plant != protocol.task.plant
    np.testing.assert_array_equal(protocol.cases_in("null", 1.0, 3).faults["valve_null_shift"], [0.02] * 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": "absent"}, "base: unknown condition 'absent'"),
        ({"conditions": {"plain": {"acting": "nobody"}}}, "unknown controller 'nobody'; known: PID"),
        ({"conditions": {"plain": {"faults": {"valve_flow": 3.0}}}}, "must be within -0.9 to 0.9"),
        ({"conditions": {"plain": {"detectors": ["X"]}}}, "unknown detector 'X'"),
        (
            {"conditions": {"plain": {"begins": "anywhere", "task": {"leakage": {"schedule": "onset"}}}}},
            "begin at rest",
        ),
    ],
)
def test_a_wrong_protocol_is_refused_in_one_line(changes, message, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump({**SMALL, "kind": "leakage", **changes}))
    with pytest.raises(ConfigurationError) as error:
        LeakProtocol.from_yaml(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
