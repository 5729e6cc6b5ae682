"""Files of any length: pieces, and the liveliest windows."""

import numpy as np
import pandas as pd
import pytest
from optional_libraries import library

from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.recordings.files import pieces
from hydro_rig.recordings.liveliest import Liveliest, sampled_windows
from hydro_rig.recordings.recording import read_recording, recording_of

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


def chosen(path, rows, window=2.0):
    live = Liveliest(window, TASK)
    for piece in pieces(path, rows):
        live.add(recording_of(piece, str(path)))
    return live.finish(12)


@pytest.mark.parametrize("lost", [False, True])
def test_the_windows_do_not_depend_on_the_size_of_the_pieces(tmp_path, lost):
    path = tmp_path / "a.csv"
    table(np.random.default_rng(1) if lost else None).to_csv(path, index=False)
    (whole, about), (some, same) = chosen(path, 10**9), chosen(path, 7001)
    assert about == same
    assert about.windows == 310
    assert about.moving == pytest.approx(110 / 310, abs=0.02)
    assert [one.begin for one in whole] == [one.begin for one in some]
    for one, other in zip(whole, some, strict=True):
        np.testing.assert_array_equal(one.rows.signals, other.rows.signals)
        np.testing.assert_allclose(one.rows.time, other.rows.time, atol=1e-6)
    assert len(whole) == 3  # of 0 to 300 s, to 600 s, and to 620 s
    assert 1.79e9 + 304.0 <= whole[1].begin <= 1.79e9 + 314.0


def test_pieces_are_the_rows_of_the_whole_file(tmp_path):
    library("pyarrow")
    rows = table(seconds=60.0)
    rows.to_csv(tmp_path / "a.csv", index=False)
    rows.to_parquet(tmp_path / "a.parquet")
    whole = read_recording(tmp_path / "a.csv")
    assert whole.begin == 1.79e9
    for name in ("a.csv", "a.parquet"):
        parts = [recording_of(piece, name) for piece in pieces(tmp_path / name, 1000)]
        assert len(parts) == 12
        np.testing.assert_allclose(np.concatenate([part.signals for part in parts], axis=1), whole.signals, rtol=1e-9)
        stamps = np.concatenate([part.begin - whole.begin + part.time for part in parts])
        np.testing.assert_allclose(stamps, whole.time, atol=1e-6)


def test_windows_with_lost_commands_come_last(tmp_path):
    rows = table(seconds=290.0)
    best = (rows["time [s]"] > 1.79e9 + 120.0) & (rows["time [s]"] < 1.79e9 + 140.0)
    rows.loc[best, "command [V]"] *= 2.0
    gap = (rows["time [s]"] > 1.79e9 + 120.0) & (rows["time [s]"] % 2.0 < 0.1)
    for name in ("a", "b"):
        rows[~gap if name == "b" else slice(None)].to_csv(tmp_path / f"{name}.csv", index=False)
    assert 120.0 <= chosen(tmp_path / "a.csv", 9999)[0][0].begin - 1.79e9 < 140.0
    assert chosen(tmp_path / "b.csv", 9999)[0][0].begin - 1.79e9 < 120.0


def test_a_clock_that_runs_back_is_told_and_no_window_crosses_it(tmp_path):
    rows = table(seconds=100.0)
    rows.loc[rows.index >= 10_000, "time [s]"] -= 30.0  # at 50 s
    rows.to_csv(tmp_path / "a.csv", index=False)
    (whole, about), (some, same) = chosen(tmp_path / "a.csv", 10**9), chosen(tmp_path / "a.csv", 3001)
    assert [one.begin for one in whole] == [one.begin for one in some]
    lines = [finding.line() for finding in about.findings if finding.signal == "clock"]
    assert lines == [finding.line() for finding in same.findings if finding.signal == "clock"]
    assert lines[0].startswith("clock runs back by 30.0 s, 50.0 s after the first row")
    assert all((np.diff(one.rows.time) > 0.0).all() for one in whole)


def test_samples_of_chosen_windows_lie_in_their_places(tmp_path):
    table(np.random.default_rng(4), 310.0).to_csv(tmp_path / "a.csv", index=False)
    windows, _ = chosen(tmp_path / "a.csv", 5000)
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


def test_a_file_that_cannot_be_read_in_pieces_is_told(tmp_path):
    (tmp_path / "a.csv").write_text("")
    (tmp_path / "b.parquet").write_bytes(b"nothing of the kind")
    for name in ("a.csv", "b.parquet", "absent.csv", "absent.parquet"):
        with pytest.raises(ConfigurationError) as error:
            list(pieces(tmp_path / name))
        assert str(error.value).startswith(f"{tmp_path / name}: ")
        assert "\n" not in str(error.value)
