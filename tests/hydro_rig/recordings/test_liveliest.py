"""The liveliest windows of a long recording."""

import numpy as np
import pandas as pd
import pytest

from hydro_env import TaskConfig
from hydro_rig.recordings.liveliest import liveliest, sampled_windows
from hydro_rig.recordings.recording import read_recording

TASK = TaskConfig()
SECONDS = 620.0


def table(random=None, seconds=SECONDS):
    """A log of an axis that moves for 20 s in each minute, most at 310 s."""
    time = np.arange(0.0, seconds, 0.005)
    busy = (time % 60.0 < 20.0) * (1.0 + (np.abs(time - 310.0) < 5.0))
    swing = busy * np.sin(4.0 * time)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (3, len(time)))
    found = pd.DataFrame(
        {
            "time [s]": np.round(1.79e9 + time, 3),
            "position [mm]": 20.0 * swing + noise[0],
            "pressure_a [bar]": 35.0 + 5.0 * swing + noise[1],
            "command [V]": np.round(2.0 * swing + noise[2], 4),
        }
    )
    return found if random is None else found[random.random(len(found)) >= 0.05]


def chosen(path):
    return liveliest(read_recording(path), 2.0, TASK, 12)


def test_of_each_section_the_window_with_the_most_motion_is_kept(tmp_path):
    table().to_csv(tmp_path / "a.csv", index=False)
    found = chosen(tmp_path / "a.csv")
    assert (found.first, found.last) == pytest.approx((1.79e9, 1.79e9 + 619.995), abs=1e-3)
    assert len(found.windows) == 3  # of 0 to 300 s, to 600 s, and to 620 s
    assert 1.79e9 + 304.0 <= found.windows[1].begin <= 1.79e9 + 314.0


def test_windows_with_lost_commands_come_last(tmp_path):
    rows = table(seconds=290.0)
    best = (rows["time [s]"] > 1.79e9 + 120.0) & (rows["time [s]"] < 1.79e9 + 140.0)
    rows.loc[best, "command [V]"] *= 2.0
    gap = (rows["time [s]"] > 1.79e9 + 120.0) & (rows["time [s]"] % 2.0 < 0.1)
    for name in ("a", "b"):
        rows[~gap if name == "b" else slice(None)].to_csv(tmp_path / f"{name}.csv", index=False)
    assert 120.0 <= chosen(tmp_path / "a.csv").windows[0].begin - 1.79e9 < 140.0
    assert chosen(tmp_path / "b.csv").windows[0].begin - 1.79e9 < 120.0


def test_a_clock_that_runs_back_is_told_and_no_window_crosses_it(tmp_path):
    rows = table(seconds=100.0)
    rows.loc[rows.index >= 10_000, "time [s]"] -= 30.0  # at 50 s
    rows.to_csv(tmp_path / "a.csv", index=False)
    found = chosen(tmp_path / "a.csv")
    [line] = [finding.line() for finding in found.findings if finding.signal == "clock"]
    assert line.startswith("clock runs back by 30.0 s, 50.0 s after the first row")
    assert all((np.diff(one.rows.time) > 0.0).all() for one in found.windows)


def test_samples_of_chosen_windows_lie_in_their_places(tmp_path):
    table(np.random.default_rng(4), 310.0).to_csv(tmp_path / "a.csv", index=False)
    windows = chosen(tmp_path / "a.csv").windows
    samples = sampled_windows(windows, 2.0, TASK)
    assert (np.diff(samples.place) > 0).all()
    for number, one in enumerate(windows):
        inside = samples.place // 400 == 1 + 2 * number
        assert 350 <= inside.sum() <= 400
        first = samples.signals[0, inside][0]
        place = int(np.flatnonzero(one.rows.signals[0] == first)[0])
        assert one.rows.begin + one.rows.time[place] - one.begin == pytest.approx(
            0.005 * (samples.place[inside][0] % 400), abs=1e-3
        )
