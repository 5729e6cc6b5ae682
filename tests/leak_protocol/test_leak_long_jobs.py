"""Long jobs on made-up detectors and short times: alarms at work, and the bound of a few windows."""

import numpy as np
import pytest
from small_leaks import SMALL, Spread, small

from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.detector import Reading
from hydro_agents.evaluation import leak_alarm_jobs as alarm_jobs
from hydro_agents.evaluation.leak_alarm_jobs import AlarmJob, alarm_plan
from hydro_agents.evaluation.leak_bound_jobs import bound_plan
from hydro_agents.evaluation.leak_running import run_leak_protocol
from hydro_agents.running.jobs import JOBS_FOLDER

SCALE = {"highest_baseline": 0.0, "spread": 1.0, "shift": 1.0}
SETTINGS = AlarmSettings(
    interval=0.5,
    learning=1,
    scales=dict.fromkeys(("standing", "slow", "moving"), SCALE),
    sums=[{"method": "mean", "threshold": 1.0}],
)


class Level:
    """A score that does not depend on the signals."""

    threshold, window = None, 60

    def __init__(self, score):
        self.score = score

    def refuses(self, task, samples):
        return "" if samples == self.window else f"reads {self.window} samples"

    def read(self, windows, task):
        return Reading.of(np.full(len(windows), self.score))


@pytest.fixture
def short(monkeypatch):
    for name, seconds in {"SHIFT": 4.0, "PAST": 2.0, "AFTER": 2.0}.items():
        monkeypatch.setattr(alarm_jobs, name, seconds)


def job(score, leaks):
    return AlarmJob("D", Level(score), SETTINGS, small().task, 2_450_000, 2, leaks, "1")


def test_an_alarm_that_never_rises_misses_everything(short):
    healthy, leaking = job(-5.0, False).run().metrics, job(-5.0, True).run().metrics
    assert healthy["alarms"].tolist() == [0.0, 0.0]
    assert 0.0 < healthy["hours"][0] <= 4.0 / 3600.0
    assert set(leaking) == set(job(-5.0, True).columns)
    assert np.isinf(leaking["1 all"]).all()
    assert (leaking["early"] == 0.0).all()


def test_an_alarm_that_always_rises_counts_as_early(short):
    assert job(9.0, False).run().metrics["alarms"].tolist() == [1.0, 1.0]
    assert (job(9.0, True).run().metrics["early"] == 1.0).all()


def test_hours_are_split_into_jobs_of_their_own_seeds():
    jobs = list(alarm_plan("D", Level(0.0), SETTINGS, small().task, 15.0, "1"))
    assert sum(each.axes for each in jobs if not each.leaks) == 90  # 600 s each
    seeds = [seed for each in jobs for seed in range(each.first_seed, each.first_seed + each.axes)]
    assert len(set(seeds)) == len(seeds)
    assert len({each.key for each in jobs} | {each.file for each in jobs}) == 2 * len(jobs)


def test_alarms_and_bound_stand_beside_the_windows_and_are_kept(short, tmp_path):
    protocol = small(bound_conditions=["plain"], bound_windows=2, conditions={"plain": SMALL["conditions"]["plain"]})
    jobs = [job(-5.0, False), job(-5.0, True)]
    run = run_leak_protocol(protocol, {"D": Spread()}, {"D": "1"}, jobs, tmp_path, jobs=1)
    assert run.alarms.iloc[0]["alarms"] == 0
    assert (run.alarms["missed"].dropna() == 1.0).all()
    assert set(run.bound["level"]) == {0.0, 1.0}
    assert (run.bound["sigma_lpm"] > 0.0).all()
    assert run.bound["sigma_lpm"].max() < 2.0  # far below the prior's: the window tells something
    kept = {file.name for file in (tmp_path / JOBS_FOLDER).iterdir()}
    assert {each.file for each in (*jobs, *bound_plan(protocol))} < kept
    again = run_leak_protocol(protocol, {"D": Spread()}, {"D": "1"}, jobs, tmp_path, jobs=1)
    assert again.reused == len(kept)
    assert again.bound.equals(run.bound)
