"""The challenge: its files and nameplates, its scores against known answers, and programs that see no answers."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import hydro
from refusal import refused

from hydro_env import TaskConfig
from hydro_rig.challenge import axes as benchmark_axes
from hydro_rig.challenge.axes import LABELS, SPLITS, Benchmark
from hydro_rig.challenge.files import digest_of_labels, labels_folder, read_labels, read_public, write_benchmark
from hydro_rig.challenge.outcomes import BUDGETS, COST_RATIOS, true_alarms
from hydro_rig.challenge.plates import FIRST_NEW, KNOWN, plate_of, plates_table, read_plate, seed_of, task_of
from hydro_rig.challenge.scores import bounds, differences, labels_of, score, text_of
from hydro_rig.challenge.submitted import Limits, run_program

pytest.importorskip("pyarrow")
SIZE = 30
ENTRIES = Path(__file__).parents[3] / "challenge/entries"


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
    table["new_axis"], table["harsh"] = np.arange(count) % 2 == 1, ""
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
    assert found.row["calibration_error"] == pytest.approx(0.2)
    assert found.row["size_factor"] == pytest.approx(2.0)
    assert found.row["interval_holds"] == pytest.approx(0.5)
    assert found.row["cause_right"] == pytest.approx(0.5)
    assert found.confusion.loc["none", "valve fault"] == 1.0
    assert "| half right |" in text_of([found])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="score"), "has no column score"),
        (lambda t: t.assign(score="high"), "column 'score' must hold numbers"),
        (lambda t: t.assign(probability=1.5), "probability must be within 0 to 1"),
        (lambda t: t.assign(cause="leak"), "cause 'leak': must be one of none, internal leak"),
    ],
)
def test_impossible_predictions_are_refused(change, message):
    labels = made_up(leaks=4, sound=6)
    table = change(looks(labels, lambda row, time: 0.5, every=30.0))
    with refused(message):
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
    with refused("holds another benchmark"):
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
    with refused("are not those of"):
        labels_of(changed, "test")
    (changed / "train" / "0000.parquet").unlink()
    with refused("is not what"):
        read_public(changed, "train")


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
    assert [row["detector"] for row in rows if row["detector"] in ("good", "bad")] == ["good", "bad"]
    refused = hydro("score", files[0], "--data", str(folder), "--split", "all")
    assert refused.returncode == 2
    assert "--split all: must be one of train, validation, test" in refused.stderr


def test_rows_that_cannot_count_are_named_and_change_no_score():
    labels = made_up(leaks=4, sound=6)
    table = looks(labels, leaking, every=30.0).astype({"score": float})
    strange = table.assign(score=9.0)
    more = [table, strange, strange.assign(recording=77), strange.assign(time=61.0)]
    clean, odd = score("x", table, labels), score("x", pd.concat(more), labels)
    assert odd.row["found_share"] == clean.row["found_share"] == 1.0
    kinds = ("a recording that is not in this split", "outside the time", "has a row already")
    assert all(any(kind in remark for remark in odd.remarks) for kind in kinds)
    absent = score("x", table[table.recording != 0], labels)
    assert absent.row["found_share"] == 0.75
    assert "1 of 10 recordings have no row" in absent.remarks[0]


def test_the_bounds_of_every_table():
    perfect, silent = bounds(made_up())
    assert perfect.row["found_share"] == perfect.row["interval_holds"] == perfect.row["cause_right"] == 1.0
    assert perfect.row["brier"] == 0.0
    assert silent.row["found_share"] == 0.0
    assert silent.row["missed"] == 1.0
    assert [silent.row[f"cost_{ratio:g}"] for ratio in COST_RATIOS] == [1.0] * len(COST_RATIOS)
    assert perfect.row["cost_10"] == 0.0
    ((_, ahead),) = differences(
        [
            score("a", looks(made_up(), leaking).astype({"score": float}), made_up()),
            score("b", looks(made_up(), lambda row, time: 0.0), made_up()),
        ]
    )
    assert (ahead.value, ahead.low, ahead.high) == (1.0, 1.0, 1.0)


def test_what_a_plant_meets():
    """Half of the leaks found, one false alarm in 4 h: of 0.5 + 2190 alarms a year 0.5 are leaks."""
    assert true_alarms(0.5, 0.25) == pytest.approx(0.5 / 2190.5)
    labels = made_up(leaks=10, sound=240, onset=0.0)  # 4 h without a leak
    table = looks(labels, lambda row, time: float((row.leak and row.recording < 5) or row.recording == 100), every=60.0)
    found = score("half", table.assign(alarm=table["score"] > 0.5), labels).row
    assert found["true_alarms"] == pytest.approx(0.5 / 2190.5)
    assert found["per_month"] == pytest.approx(8760 / 12 / 4)
    # A miss costs a million call-outs: with the alarm 0.5 misses and 2190 call-outs a year.
    assert found["cost_1e+06"] == pytest.approx(0.5, abs=0.003)


def test_an_axis_is_described_by_its_nameplate():
    table = plates_table()
    assert table["axis"].tolist()[KNOWN] == FIRST_NEW
    row = table.to_dict("records")[3]
    task = task_of(TaskConfig(), read_plate(row))
    assert task == task_of(TaskConfig(), plate_of(seed_of(3)))
    assert row["area_a"] == pytest.approx(np.pi / 4 * row["bore"] ** 2)
    assert row["bore plate"] == f"{1e3 * row['bore']:g} mm"
    assert row["control_period"] == task.control_period
    assert seed_of(FIRST_NEW) != seed_of(FIRST_NEW, "a secret") != seed_of(FIRST_NEW, "another")
    assert seed_of(3) == seed_of(3, "a secret")  # axes of the training stay


def test_new_axes_occur_in_the_test_split_alone(folder):
    for split in SPLITS:
        labels = read_labels(folder, split)
        assert (labels["axis"] >= FIRST_NEW).tolist() == labels["new_axis"].tolist()
        assert labels["new_axis"].any() == (split == "test")
        rows = pd.read_parquet(folder / split).groupby("recording")["axis"].first()
        assert rows.tolist() == labels["axis"].tolist()


def test_the_checksums_are_those_of_all_public_files(folder):
    sums = dict(line.split("  ")[::-1] for line in (folder / "SHA256SUMS").read_text().splitlines())
    public = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and "hidden" not in p.parts}
    assert set(sums) == public - {"SHA256SUMS"}
    for name, digest in sums.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


PROGRAM = """
import json, sys
for line in sys.stdin:
    if line.startswith("{"):
        head, rows = json.loads(line), []
        %s
    elif line.strip():
        rows.append(line)
    else:
        size = head.get("axis", {}).get("bore")
        print(json.dumps({"score": float(rows[-1].split(",")[0]), "size": size}), flush=True)
"""


def program(folder, first="pass"):
    folder.mkdir()
    (folder / "detect.py").write_text(PROGRAM % first)
    return folder


def test_a_program_gets_the_rows_in_their_order_and_answers_each_look(folder, tmp_path):
    run = run_program(program(tmp_path / "mine"), folder, "validation")
    recordings = pd.read_parquet(folder / "validation")
    assert sorted(run.predictions["recording"].unique()) == sorted(recordings["recording"].unique())
    # What it saw last is the last row up to the look: nothing of the future.
    np.testing.assert_allclose(run.predictions["score"], run.predictions["time"], atol=1e-6)
    bore = pd.read_parquet(folder / "axes.parquet").set_index("axis")["bore"]
    axis = recordings.groupby("recording")["axis"].first()
    assert run.predictions["size"].tolist() == bore.loc[axis.loc[run.predictions["recording"]]].tolist()
    assert run.remarks == []
    blind = run_program(tmp_path / "mine", folder, "validation", signals_only=True)
    assert "size" not in blind.predictions


@pytest.mark.parametrize(
    ("first", "remark"),
    [
        ("raise SystemExit(3)", "the program ended with code 3"),
        ("import time; time.sleep(60)", "no answer within 1.5 s"),
        ("print('hello', flush=True)", "'hello' is no answer"),
        ("print('{}', flush=True)", "is a second answer to one look"),
        ("x = bytearray(2**33)", "the program ended with code 1"),
    ],
)
def test_a_program_that_fails_has_a_defined_score(folder, tmp_path, first, remark):
    one = f"if head['recording'] == FIRST: {first}"
    labels = labels_of(folder, "validation")
    numbers = sorted(labels["recording"])
    place = program(tmp_path / "mine", one.replace("FIRST", str(numbers[0])))
    run = run_program(place, folder, "validation", Limits(seconds_per_look=1.5, start=0.0, memory=1.0))
    assert any(remark in one for one in run.remarks)
    answered = run.predictions.dropna(subset=["score"])["recording"]
    assert set(numbers[1:]) <= set(answered)
    assert 0.0 <= score("mine", run.predictions, labels).row["missed"] <= 1.0


def test_the_command_runs_a_program_and_writes_a_page(folder, tmp_path):
    done = hydro("score", "--code", str(program(tmp_path / "mine")), "--data", str(folder), "-o", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert "| mine |" in done.stdout
    names = pd.read_csv(tmp_path / "out/scores.csv")["detector"]
    assert set(names) == {"mine", "perfect", "silent"}
    assert "Leaks found over false alarms" in (tmp_path / "out/scores.html").read_text(encoding="utf-8")
    again = hydro("score", str(tmp_path / "out/predictions/mine.parquet"), "--data", str(folder), "--json")
    assert {row["detector"] for row in json.loads(again.stdout)} == {"mine", "perfect", "silent"}
    shutil.copytree(folder, tmp_path / "public", ignore=shutil.ignore_patterns("hidden"))
    line = ["score", "--code", str(tmp_path / "mine"), "--data", str(tmp_path / "public")]
    blind = hydro(*line, "-o", str(tmp_path / "blind"))
    assert "nothing is scored" in blind.stdout
    tables = [pd.read_parquet(tmp_path / place / "predictions/mine.parquet") for place in ("out", "blind")]
    pd.testing.assert_frame_equal(*tables)
    assert "labels of the split 'test' are needed" in hydro(*line).stderr
    empty = hydro("score", "--code", str(tmp_path), "--data", str(folder))
    assert (empty.returncode, "has no detect.py" in empty.stderr) == (2, True)


@pytest.mark.parametrize("entry", sorted(p.name for p in ENTRIES.iterdir()))
def test_the_entries_use_no_code_of_this_project(entry):
    code = (ENTRIES / entry / "detect.py").read_text(encoding="utf-8")
    assert "import hydro" not in code
    assert "from hydro" not in code


def test_the_textbook_answer_runs(folder):
    run = run_program(ENTRIES / "cusum", folder, "validation")
    assert run.remarks == []
    assert run.predictions["score"].notna().any()
