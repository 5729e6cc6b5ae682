"""The benchmark of leaking axes: its files, and its scores against answers that are known."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import hydro

from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.challenge import axes as benchmark_axes
from hydro_rig.challenge.axes import LABELS, SPLITS, Benchmark
from hydro_rig.challenge.files import digest_of_labels, labels_folder, read_labels, write_benchmark
from hydro_rig.challenge.scores import BUDGETS, labels_of, poisson_interval, score, text_of

pytest.importorskip("pyarrow")
SIZE = 30


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small benchmark with recordings of 3 s."""
    place = tmp_path_factory.mktemp("axes") / "data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark_axes, "DURATION", 3.0)
        write_benchmark(place, TaskConfig(), Benchmark(SIZE), jobs=1)
    return place


def made_up(leaks=40, sound=60, seconds=60.0, onset=20.0):
    """Labels of recordings of which the first ones leak from ``onset`` on."""
    count = leaks + sound
    leak = np.arange(count) < leaks
    table = pd.DataFrame({"recording": np.arange(count), "tier": 1 + np.arange(count) % 3, "seconds": seconds})
    table["leak"], table["onset"] = leak, np.where(leak, onset, np.nan)
    table["size"], table["cause"] = np.where(leak, 0.4, 0.01), np.where(leak, "internal leak", "none")
    return table


def looks(labels, value, every=1.0):
    """Predictions whose score is a function of the row of the labels and the time."""
    rows = [
        {"recording": row.recording, "time": time, "score": value(row, time)}
        for row in labels.itertuples()
        for time in np.arange(every, row.seconds + 1e-9, every)
    ]
    return pd.DataFrame(rows)


def leaking(row, time):
    return bool(row.leak and time >= row.onset)


def test_a_perfect_detector_finds_all_leaks_at_once():
    labels = made_up()
    found = score("perfect", looks(labels, leaking).astype({"score": float}), labels)
    assert found.row["found_share"] == 1.0
    assert found.row["missed"] == 0.0
    assert found.row["per_100_h"] == 0.0
    assert found.row["delay"] == 0.0
    assert found.row["hours"] == pytest.approx((40 * 20 + 60 * 60) / 3600.0)


def test_a_detector_without_knowledge_finds_what_its_false_alarms_allow():
    """Scores that are drawn anew per recording: the share found is the share of recordings that give a false alarm."""
    labels = made_up(leaks=2000, sound=2000, onset=30.0)
    generator = np.random.default_rng(1)
    drawn = generator.random(4000)
    table = looks(labels, lambda row, time: drawn[row.recording], every=15.0)
    found = score("chance", table, labels).outcomes
    for rate in BUDGETS:  # the same score before and after the onset: an alarm always comes too early
        assert not found.found(found.threshold(rate)).any()
    later = generator.random(4000)
    table = looks(labels, lambda row, time: (later if leaking(row, time) else drawn)[row.recording], every=15.0)
    found = score("chance", table, labels).outcomes
    for rate in BUDGETS:
        allowed = rate * found.free.sum() / 4000  # share of recordings with a false alarm
        assert found.found(found.threshold(rate))[found.leak].mean() == pytest.approx(
            allowed * (1.0 - allowed), abs=0.02
        )


def test_the_delay_is_counted_from_the_onset_and_an_early_alarm_is_a_false_one():
    labels = made_up(leaks=4, sound=1)
    table = looks(labels, lambda row, time: 0.0)
    begins = {0: 27.0, 1: 29.0, 2: 5.0, 3: 31.0}  # the third one is early
    table["alarm"] = [
        time >= begins.get(number, np.inf) for number, time in zip(table.recording, table.time, strict=True)
    ]
    row = score("own", table, labels).row
    assert row["alarm"] == "its own"
    assert row["missed"] == 0.25
    assert row["per_100_h"] == pytest.approx(100.0 / row["hours"])
    assert row["delay"] == pytest.approx(np.median([7.0, 9.0, np.inf, 11.0]))


@pytest.mark.parametrize(("count", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)])
def test_the_interval_of_a_rate_is_that_of_the_tables(count, low, high):
    interval = poisson_interval(count, 2.0)
    assert interval.value == count / 2.0
    assert (interval.low, interval.high) == pytest.approx((low / 2.0, high / 2.0), rel=1e-3)


def test_calibration_causes_and_sizes():
    labels = made_up(leaks=50, sound=50)
    table = looks(labels, leaking, every=20.0).astype({"score": float})
    truth = table["recording"] < 50
    table["probability"] = np.where(truth, 0.8, 0.2)
    table["cause"] = np.where(truth, "internal leak", "valve fault")
    table["size"] = 0.2
    table["low"], table["high"] = 0.1, np.where(table["recording"] < 25, 0.5, 0.3)
    found = score("half right", table, labels)
    assert found.row["brier"] == pytest.approx(0.04)
    assert found.row["size_factor"] == pytest.approx(2.0)
    assert found.row["interval_holds"] == pytest.approx(0.5)
    assert found.row["cause_right"] == pytest.approx(0.5)
    assert "| half right |" in text_of([found])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="score"), "has no column score"),
        (lambda t: t.assign(recording=t.recording + 1), "is not in this split"),
        (lambda t: t[t.recording != 3], "1 of 10 recordings have no row, such as 3"),
        (lambda t: t.assign(time=61.0), "must be within the recording, 0 to 60 s"),
        (lambda t: t.assign(score="high"), "column 'score' must hold numbers"),
        (lambda t: t.assign(probability=1.5), "probability must be within 0 to 1"),
        (lambda t: t.assign(cause="leak"), "cause 'leak': must be one of none, internal leak"),
    ],
)
def test_impossible_predictions_are_refused(change, message):
    labels = made_up(leaks=4, sound=6)
    table = change(looks(labels, lambda row, time: 0.5, every=30.0))
    with pytest.raises(ConfigurationError, match=message):
        score("x", table, labels)


def test_the_files_agree_with_the_labels(folder):
    manifest = json.loads((folder / "benchmark.json").read_text())
    assert sum(manifest["recordings"].values()) == SIZE
    for split in SPLITS:
        labels, rows = read_labels(folder, split), pd.read_parquet(folder / split)
        assert list(labels) == list(LABELS)
        assert digest_of_labels(labels) == manifest["labels_sha256"][split]
        lengths = rows.groupby("recording")["time [s]"].max()
        assert sorted(lengths.index) == labels["recording"].tolist()
        assert (lengths.to_numpy() < labels["seconds"].to_numpy()).all()
        assert (labels["size"] > 0.03).to_numpy()[labels["leak"]].all()
        assert (labels["onset"].dropna() < labels["seconds"][labels["leak"]]).all()
        assert (labels["fault"] == "").to_numpy()[labels["leak"]].all()
    assert not (folder / "test_labels").exists()
    assert "| 3 |" in (folder / "README.md").read_text()


def test_an_interrupted_benchmark_goes_on_and_another_one_is_refused(folder, monkeypatch):
    before = labels_of(folder, "validation")
    monkeypatch.setattr(benchmark_axes, "DURATION", 3.0)
    signals = (folder / "validation/0000.parquet").read_bytes()
    (folder / "validation_labels/0000.parquet").unlink()
    write_benchmark(folder, TaskConfig(), Benchmark(SIZE), jobs=1)
    pd.testing.assert_frame_equal(labels_of(folder, "validation"), before)
    assert (folder / "validation/0000.parquet").read_bytes() == signals
    with pytest.raises(ConfigurationError, match="holds another benchmark"):
        write_benchmark(folder, TaskConfig(), Benchmark(SIZE + 3), jobs=1)


def test_a_key_changes_the_test_recordings_only():
    open_, secret = Benchmark(SIZE), Benchmark(SIZE, "a secret")
    assert open_.seeds("train", 0, 5).tolist() == secret.seeds("train", 0, 5).tolist()
    assert not set(open_.seeds("test", 0, 5)) & set(secret.seeds("test", 0, 5))
    assert secret.seeds("test", 0, 5).tolist() != Benchmark(SIZE, "another").seeds("test", 0, 5).tolist()
    assert secret.seeds("test", 0, 500).min() >= 2**31  # above every seed of the ledger


def test_changed_labels_are_noticed(folder, tmp_path):
    labels = labels_of(folder, "test")
    changed = tmp_path / "changed"
    shutil.copytree(folder, changed)
    place = labels_folder(changed, "test")
    shutil.rmtree(place)
    place.mkdir()
    labels.assign(size=0.5).to_parquet(place / "0.parquet")
    with pytest.raises(ConfigurationError, match="are not those of"):
        labels_of(changed, "test")


def test_the_command_scores_several_detectors(folder, tmp_path):
    labels = read_labels(folder, "test")
    for name, good in (("good", True), ("bad", False)):
        table = looks(labels, lambda row, time, good=good: float(leaking(row, time) == good), every=0.25)
        short = labels[~labels["recording"].isin(table["recording"])]
        extra = pd.DataFrame({"recording": short["recording"], "time": 0.0, "score": np.nan})
        pd.concat([table, extra]).to_parquet(tmp_path / f"{name}.parquet")
    files = [str(tmp_path / "bad.parquet"), str(tmp_path / "good.parquet")]
    shown = hydro("score", *files, "--data", str(folder), "--json")
    rows = json.loads(shown.stdout)
    assert [row["detector"] for row in rows] == ["good", "bad"]
    assert rows[0]["found_share"] > rows[1]["found_share"]
    refused = hydro("score", files[0], "--data", str(folder), "--split", "all")
    assert refused.returncode == 2
    assert "--split all: must be one of train, validation, test" in refused.stderr


def test_the_outsider_predicts_with_none_of_our_code(folder, tmp_path):
    script = Path(__file__).parents[3] / "benchmarks/outsider.py"
    assert "hydro" not in script.read_text(encoding="utf-8").split('"""', 2)[2]
    output = tmp_path / "outsider.parquet"
    subprocess.run([sys.executable, script, str(folder), "--split", "validation", "--output", str(output)], check=True)
    labels = labels_of(folder, "validation")
    assert 0.0 <= score("outsider", pd.read_parquet(output), labels).row["brier"] <= 1.0
