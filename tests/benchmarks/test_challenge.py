"""The challenge: its recordings and labels agree, and its scores have known answers."""

import numpy as np
import pandas as pd
import pytest

from challenge import recordings
from challenge.axes import FIRST_NEW, read_task, task_of
from challenge.recordings import SHARES, labels_folder, write_challenge
from challenge.score import BUDGETS, outcomes_of, score
from hydro_agents.learning import stable_gain

pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small challenge with recordings of 3 s."""
    place = tmp_path_factory.mktemp("axes")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recordings, "DURATION", 3.0)
        patch.setattr(stable_gain, "DRAWN", 8)
        write_challenge(place, 30)
    return place


def made_up(leaks=40, sound=60, onset=20.0):
    """Labels of recordings of a minute, of which the first ones leak from ``onset`` on."""
    number = np.arange(leaks + sound)
    leak = number < leaks
    table = pd.DataFrame({"recording": number, "tier": 1 + number % 3, "seconds": 60.0, "leak": leak})
    return table.assign(onset=np.where(leak, onset, np.nan), size=np.where(leak, 0.4, 0.01), new_axis=number % 2 == 1)


def looks(labels, value, every=1.0):
    """Predictions whose score is a function of the row of the labels and the time."""
    rows = []
    for row in labels.itertuples():
        for time in np.arange(every, row.seconds + 1e-9, every):
            rows.append({"recording": row.recording, "time": time, "score": float(value(row, time))})
    return pd.DataFrame(rows)


def leaking(row, time):
    return row.leak and time >= row.onset


def test_a_perfect_detector_finds_all_leaks_at_once_and_a_silent_one_none():
    labels = made_up()
    row = score(looks(labels, leaking), labels)
    assert (row["found"], row["missed"], row["delay"]) == (1.0, 0.0, 0.0)
    silent = score(looks(labels, lambda row, time: np.nan, every=30.0), labels)
    assert (silent["found"], silent["missed"], silent["delay"]) == (0.0, 1.0, np.inf)


def test_a_detector_without_knowledge_finds_what_its_false_alarms_allow():
    """Scores that are drawn anew per recording: the share found is the share of recordings that give a false alarm."""
    labels, generator = made_up(leaks=2000, sound=2000, onset=30.0), np.random.default_rng(1)
    before, after = generator.random(4000), generator.random(4000)
    table = looks(labels, lambda row, time: (after if leaking(row, time) else before)[row.recording], every=15.0)
    found = outcomes_of(table, labels)
    for rate in BUDGETS:
        allowed = rate * found.free.sum() / 4000  # share of recordings with a false alarm
        share = found.found(found.threshold(rate))[found.leak].mean()
        assert share == pytest.approx(allowed * (1.0 - allowed), abs=0.02)


def test_rows_that_cannot_count_change_no_score_and_a_missing_recording_is_a_miss():
    labels = made_up(leaks=4, sound=6)
    table = looks(labels, leaking, every=30.0)
    strange = table.assign(score=9.0)
    odd = pd.concat([table, strange, strange.assign(recording=77), strange.assign(time=61.0)])
    assert score(odd, labels)["found"] == score(table, labels)["found"] == 1.0
    assert score(table[table["recording"] != 0], labels)["found"] == 0.75


def test_recordings_labels_and_axes_agree(folder):
    tasks = pd.read_parquet(folder / "axes.parquet").set_index("axis")["task"]
    for split, share in SHARES.items():
        labels = pd.read_parquet(labels_folder(folder, split)).set_index("recording")
        rows = pd.read_parquet(folder / split).groupby("recording")
        assert len(labels) == round(30 * share)
        assert (rows["time [s]"].max() < labels["seconds"]).all()
        assert (rows["axis"].first() == labels["axis"]).all()
        assert ((labels["axis"] >= FIRST_NEW) == labels["new_axis"]).all()
        assert labels["new_axis"].any() == (split == "test")
        assert (labels["size_share"][labels["leak"]] > 1.0).all()
        assert (labels["onset"].dropna() < labels["seconds"][labels["leak"]]).all()
        assert (labels["fault"][labels["leak"]] == "").all()
        for axis in labels["axis"]:
            assert read_task(tasks[axis]) == task_of(axis)


def test_sizes_and_their_intervals_count_at_the_last_look():
    labels = made_up(leaks=50, sound=50)
    table = looks(labels, leaking, every=20.0).assign(size=0.2, low=0.1)
    row = score(table.assign(high=np.where(table["recording"] < 25, 0.5, 0.3)), labels)
    assert (row["90 % interval holds"], row["size off by"]) == pytest.approx((0.5, 2.0))
