"""Long jobs on made-up detectors and short times: alarms at work, and the bound of a few windows."""

import numpy as np
import pandas as pd
import pytest
from small_leaks import SMALL, ran, small

from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.alarm_simulation import Work
from hydro_agents.detection.detector import Reading
from hydro_agents.evaluation import leak_alarm
from hydro_agents.evaluation.leak_alarm import LEAKS, alarm, at_healthy_axes, at_onsets
from hydro_agents.evaluation.leak_protocol import Detectors, LeakProtocol, Watch
from hydro_agents.running.jobs import JOBS_FOLDER
from hydro_env import ConfigurationError
from hydro_env.files import validate

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
        monkeypatch.setattr(leak_alarm, name, seconds)


def rows(measure, score, **times):
    onsets = LEAKS if measure is at_onsets else ()
    work = Work(2_450_000, 2, **times, interval=SETTINGS.interval, onsets=onsets)
    return measure(Level(score), small().task, SETTINGS, work)


def test_an_alarm_that_never_rises_misses_everything():
    healthy, leaking = rows(at_healthy_axes, -5.0, duration=4.0), rows(at_onsets, -5.0, duration=2.0, after=2.0)
    assert healthy["alarms"].tolist() == [0.0, 0.0]
    assert 0.0 < healthy["hours"][0] <= 4.0 / 3600.0
    assert len(leaking["delay_s"]) == 2 * len(LEAKS)
    assert np.isinf(leaking["delay_s"]).all()
    assert (leaking["early"] == 0.0).all()


def test_an_alarm_that_always_rises_counts_as_early():
    assert rows(at_healthy_axes, 9.0, duration=4.0)["alarms"].tolist() == [1.0, 1.0]
    assert (rows(at_onsets, 9.0, duration=2.0, after=2.0)["early"] == 1.0).all()


def test_hours_are_split_into_jobs_of_their_own_seeds():
    cells = list(alarm(small(alarm_hours=15.0), Detectors({}, {"D": Watch(Level(0.0), SETTINGS)})))
    healthy, leaking = ([job.arguments[-1] for job in cell.jobs] for cell in cells)
    assert sum(each.axes for each in healthy) == sum(each.axes for each in leaking) == 90  # 600 s each
    seeds = [each.first_seed + axis for each in (*healthy, *leaking) for axis in range(each.axes)]
    assert len(set(seeds)) == len(seeds)
    assert len({job.file for cell in cells for job in cell.jobs}) == 4


def test_alarms_and_bound_stand_beside_the_windows_and_are_kept(short, tmp_path):
    protocol = small(
        bound_conditions=["plain"],
        bound_windows=2,
        conditions={"plain": SMALL["conditions"]["plain"]},
        alarms={"D": "alarm.yaml"},
        alarm_hours=0.001,
    )
    alarms = {"D": Watch(Level(-5.0), SETTINGS)}
    run = ran(protocol, alarms=alarms, folder=tmp_path)
    found = run.table("alarms")
    assert found.iloc[0]["alarms"] == 0
    assert found.iloc[0]["hours"] > 0.0
    assert (found["missed"].dropna() == 1.0).all()
    assert len(found) == 1 + len(LEAKS)
    bound = run.table("bound")
    assert set(bound["level"]) == {0.0, 1.0}
    assert (bound["sigma_lpm"] > 0.0).all()
    assert bound["sigma_lpm"].max() < 2.0  # far below the prior's: the window tells something
    again = ran(protocol, alarms=alarms, folder=tmp_path)
    assert again.reused == len(list((tmp_path / JOBS_FOLDER).iterdir())) > 4
    for name in ("alarms", "bound"):
        pd.testing.assert_frame_equal(again.table(name), run.table(name), check_exact=True)


def test_the_parts_can_be_chosen():
    assert small(bound_conditions=["plain"]).measured == ("windows", "leak_bound")
    assert small(alarms={"D": "alarm.yaml"}, alarm_hours=1.0).measured == ("windows", "alarm")
    run = ran(small(parts=["leak_bound"], bound_conditions=["null"], bound_windows=1))
    assert set(run.tables()) == {"bound", "conditions", "status", "protocol"}
    with pytest.raises(ConfigurationError, match="unknown part 'tracking'; known: windows, alarm, leak_bound"):
        validate(LeakProtocol, {**SMALL, "parts": ["tracking"]}, "own.yaml")
