"""Jobs: side by side as alone, bit for bit; interrupted work goes on; thresholds, verdicts and failures."""

import numpy as np
import pandas as pd
import pytest
from joblib import parallel_config
from small_leaks import SMALL, Spread, ran, small

from hydro_agents.detection.detector import Cause
from hydro_agents.evaluation.leak_tables import judged
from hydro_agents.running.jobs import JOBS_FOLDER
from hydro_env import ConfigurationError


@pytest.fixture(scope="module")
def alone():
    return ran()


def assert_same(run, other):
    pd.testing.assert_frame_equal(run.table("windows"), other.table("windows"), check_exact=True)
    pd.testing.assert_frame_equal(run.table("thresholds"), other.table("thresholds"), check_exact=True)
    pd.testing.assert_frame_equal(run.status, other.status)


def test_every_window_has_its_row(alone):
    assert len(alone.table("windows")) == 10 * (3 + 2)
    assert (alone.status["status"] == "done").all()
    plain = alone.table("windows")[alone.table("windows")["condition"] == "plain"]
    np.testing.assert_allclose(plain.loc[plain["level"] == 1.0, "leak_lpm"], 1.0, rtol=1e-6)
    assert (alone.table("windows")["error_mm"] > 0.0).all()


@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_jobs_side_by_side_give_the_same_bits(alone, backend):
    with parallel_config(backend=backend, n_jobs=2):
        assert_same(ran(jobs=None), alone)


def test_an_interrupted_run_goes_on_and_another_detector_begins_anew(alone, tmp_path):
    class StopError(Exception):
        pass

    def stop(phase, done, total):
        if done == 3:
            raise StopError

    with pytest.raises(StopError):
        ran(folder=tmp_path, progress=stop)
    assert len(list((tmp_path / JOBS_FOLDER).iterdir())) == 3
    run = ran(folder=tmp_path)
    assert run.reused == 3
    assert_same(run, alone)
    assert ran(detectors={"D": Spread(2.0)}, folder=tmp_path).reused == 0


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
    thresholds = pd.DataFrame({"detector": ["D"], "used": [1.0], "at_1_percent": [3.0]})
    found = judged(windows, thresholds, 0.05)
    assert found["verdict"].tolist() == [Cause.INTERNAL_LEAK, Cause.VALVE, Cause.UNKNOWN]
    assert found["flagged"].tolist() == [True, False, False]
    assert found["at_1_percent"].tolist() == [False, False, False]
    assert found["leaking"].tolist() == [True, False, True]


def test_what_cannot_run_is_told_and_the_rest_stays():
    conditions = {**SMALL["conditions"], "long": {"duration": 0.5}}
    run = ran(small(conditions=conditions))
    status = run.status.set_index("condition")
    assert status.loc["long", "status"] == "not applicable"
    assert status.loc["long", "message"] == "reads 60 samples"
    assert set(run.table("windows")["condition"]) == {"plain", "null"}


def test_no_detector_for_any_window_is_an_error():
    with pytest.raises(ConfigurationError, match="no detector ran under any condition"):
        ran(detectors={"D": Spread(samples=1)})


def test_a_detector_without_threshold_has_no_figures():
    conditions = {**SMALL["conditions"], "short": {"duration": 0.2}}
    detectors = dict.fromkeys(("D", "E"), SMALL["detectors"]["D"])
    both = {"D": Spread(), "E": Spread(samples=40)}
    run = ran(small(conditions=conditions, detectors=detectors), both)
    assert set(run.table("windows")["detector"]) == {"D"}
    assert "no threshold" in run.status.set_index(["detector", "condition"]).loc[("E", "plain"), "message"]
