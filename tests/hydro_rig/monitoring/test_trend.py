"""``hydro trend``: rows, table, dates, page and exit codes."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import problems_everywhere
from command_line import assert_one_clear_line, hydro, own_lines
from recorded import recorded_file
from refusal import refused

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.monitoring import trend_job
from hydro_rig.monitoring.oil import Oil
from hydro_rig.monitoring.trend import Settings, row_of_file
from hydro_rig.monitoring.trend_job import Watch, watch
from hydro_rig.monitoring.trend_summary import exit_code, trends_of
from hydro_rig.monitoring.trend_table import COLUMNS, File, files_of, read_table, stamp, unread, with_rows, write_table

OIL, DAY = Oil.of("46"), 86400.0
START = 1.79e9


def found(sizes, verdict=None, first=START, reason="", step=DAY):
    """Columns of rows with sizes."""
    sizes = np.asarray(sizes, dtype=np.float64)
    time = first + step * np.arange(len(sizes))
    verdicts = [verdict or (Kind.LEAK if size > 0.05 else Kind.HEALTHY).value for size in sizes]
    parts = {"size": sizes, "low": 0.9 * sizes, "high": 1.1 * sizes}
    texts = {
        "axis": np.array(["a"] * len(sizes)),
        "verdict": np.array(verdicts),
        "reason": np.array([reason] * len(sizes)),
    }
    alike = {"moving": 0.3, "temperature": 40.0, "clock_back": 0.0}
    alike = {name: np.full(len(sizes), value) for name, value in alike.items()}
    return {"time": time, "until": time + 10.0, **texts, **alike, **parts, **{f"{k}_40": v for k, v in parts.items()}}


def table_of(sizes, tmp_path, **how):
    file = File(tmp_path / "a.csv", "a", "a/a.csv", 100)
    return with_rows(read_table(tmp_path / "absent.csv"), file, found(sizes, **how), OIL)


def made_up(_, path, axis, *others):
    """Stands for the reading of a file."""
    del others
    text = Path(path).read_text(encoding="utf-8")
    if "broken" in text:
        raise ConfigurationError(f"{path}: holds no table")
    day = int(path[-6:-4])
    rows = found([0.02 * 10.0 ** (day / 20.0)], first=START + DAY * day)
    return {**rows, "axis": np.array([axis])}


def recordings(folder, days=10, axes=("one", "two"), broken=()):
    for axis in axes:
        (folder / axis).mkdir(parents=True, exist_ok=True)
        for day in range(days):
            text = "broken" if (axis, day) in broken else "numbers"
            (folder / axis / f"{day:02d}.csv").write_text(text)
    return folder


# One file ------------------------------------------------------------------------------------------------------------


def test_a_file_becomes_one_row_with_the_leak_at_40_degrees(tmp_path):
    path = tmp_path / "press_2026-10-03T0600.csv"
    recorded_file(path, leakage=0.3, duration=4.0)
    rows = pd.read_csv(path, comment="#").assign(**{"oil_temperature [°C]": 55.0})
    rows.to_csv(path, index=False)
    row = row_of_file(path, "press", TaskConfig(), None, Settings(OIL, (20.0, 60.0)))
    assert stamp(row.time) == "2026-10-03T06:00:00"
    assert row.until - row.time == pytest.approx(3.995)
    assert row.verdict == Kind.LEAK
    assert row.temperature == pytest.approx(55.0)
    assert row.low < 0.3 < row.high
    assert row.size_40 == pytest.approx(row.size * float(OIL.factor(55.0)))


# The table -----------------------------------------------------------------------------------------------------------


def test_nothing_is_appended_twice_and_a_file_that_grew_is_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(trend_job, "read_row", made_up)
    folder, table = recordings(tmp_path / "data"), tmp_path / "out" / "trend.csv"
    first = watch([folder], Watch(table))
    assert (first.read, first.known, len(first.left_out)) == (20, 0, 0)
    text = table.read_text()
    again = watch([folder], Watch(table))
    assert (again.read, again.known) == (0, 20)
    assert table.read_text() == text
    recordings(folder, days=11)
    (folder / "one" / "03.csv").write_text("numbers and more")
    third = watch([folder], Watch(table))
    assert (third.read, third.known) == (3, 19)
    rows = read_table(table)
    assert len(rows) == 22
    assert not rows.duplicated(["axis", "time"]).any()
    assert list(rows.columns) == list(COLUMNS)


def test_one_broken_file_of_fifty_gives_49_rows_and_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(trend_job, "read_row", made_up)
    folder = recordings(tmp_path / "data", 25, broken=[("two", 7)])
    done = watch([folder], Watch(tmp_path / "trend.csv"))
    assert len(read_table(tmp_path / "trend.csv")) == 49
    assert done.left_out == [f"{folder}/two/07.csv: holds no table"]
    (folder / "two" / "07.csv").write_text("numbers")
    assert watch([folder], Watch(tmp_path / "trend.csv")).read == 1


def test_an_interruption_loses_no_finished_file(tmp_path, monkeypatch):
    calls = []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return made_up(*arguments)

    monkeypatch.setattr(trend_job, "read_row", interrupted)
    folder = recordings(tmp_path / "data")
    with pytest.raises(KeyboardInterrupt):
        watch([folder], Watch(tmp_path / "trend.csv"))
    kept = len(read_table(tmp_path / "trend.csv"))
    assert kept >= 1
    assert watch([folder], Watch(tmp_path / "trend.csv")).read == 20 - kept


def test_marks_and_columns_of_the_user_stay(tmp_path):
    table = table_of([0.02, 0.03, 0.01], tmp_path)
    table = table.assign(note=["", "seal 4711", ""])
    table.loc[2, "repaired"] = "x"
    write_table(tmp_path / "t.csv", table)
    read = read_table(tmp_path / "t.csv")
    assert read["note"].fillna("").tolist() == ["", "seal 4711", ""]
    file = File(tmp_path / "a.csv", "a", "a/a.csv", 200)
    assert unread([file], read) == [file]
    more = with_rows(read, file, found([0.02, 0.03, 0.01, 0.012]), OIL)
    assert more["repaired"].tolist() == ["", "", "x", ""]


def test_folders_name_axes(tmp_path):
    for name in ("axis=3/date=2026-10-03/part.parquet", "press/a.csv", "press/_tmp.csv", "press/readme.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    files = files_of([tmp_path], tmp_path / "trend.csv")
    assert [(file.axis, file.name) for file in files] == [
        ("3", "3/date=2026-10-03/part.parquet"),
        ("press", "press/a.csv"),
    ]
    single = files_of([tmp_path / "press" / "a.csv"], tmp_path / "trend.csv")
    inside = files_of([tmp_path / "press"], tmp_path / "trend.csv")
    assert [file.name for file in single + inside] == ["press/a.csv", "press/a.csv"]


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "", f"{','.join(COLUMNS)}\n,\n", "\x00\x01"])
def test_another_table_is_not_touched(tmp_path, text):
    (tmp_path / "t.csv").write_text(text)
    with refused("is no table of hydro trend"):
        read_table(tmp_path / "t.csv")


# States and dates ----------------------------------------------------------------------------------------------------


def noisy(sizes, spread=0.02):
    return np.asarray(sizes) * 10.0 ** np.random.default_rng(5).normal(0.0, spread, len(sizes))


def trend(table, limit=0.3):
    return trends_of(table, {"a": limit}, OIL)[0]


def test_the_sentence_tells_date_interval_and_not_before(tmp_path):
    sizes = 0.03 * 10.0 ** (np.arange(30) / 40.0)  # 0.3 on day 40
    one = trend(table_of(noisy(sizes), tmp_path))
    assert one.state is Kind.LEAK
    assert one.dated
    assert one.growth.ahead.low <= 11.0 <= one.growth.ahead.high
    assert one.growth.not_before < one.growth.ahead.low
    date = one.date(one.growth.ahead.value)
    assert one.sentence().startswith(f"a will reach 0.30 l/min about {date} (90 %: ")
    assert one.sentence().endswith(f"; not before {one.date(one.growth.not_before)}.")
    assert one.json()["limit_reached"]["expected"] == stamp(one.time[-1] + DAY * one.growth.ahead.value)[:10]


def test_a_healthy_axis_gets_no_date_and_one_at_the_limit_is_told(tmp_path):
    healthy = trend(table_of(noisy(np.full(30, 0.015), 0.1), tmp_path))
    assert (healthy.state, healthy.dated) == (Kind.HEALTHY, False)
    assert "does not grow measurably" in healthy.sentence()
    reached = trend(table_of(noisy(0.1 * 10.0 ** (np.arange(30) / 40.0)), tmp_path))
    assert reached.sentence().startswith("a has reached 0.30 l/min: it leaks 0.5")
    few = trend(table_of([0.1, 0.2, 0.1], tmp_path))
    assert "too few readings" in few.sentence()
    assert few.json()["leak_40"]["value"] is None


def test_only_readings_since_the_repair_count(tmp_path):
    before, after = 0.05 * 10.0 ** (np.arange(20) / 30.0), np.full(12, 0.012)
    table = table_of(noisy([*before, *after]), tmp_path)
    day = stamp(START + 20 * DAY)
    marked = table.assign(repaired=["x" if when == day else "" for when in table["time"]])
    assert trend(marked).growth.level.high < 0.02
    assert trend(marked).repairs == (START + 20 * DAY,)


def test_two_odd_verdicts_change_no_state(tmp_path):
    table = table_of(np.full(6, 0.015), tmp_path)
    for row, state in ((5, Kind.HEALTHY), (3, Kind.HEALTHY), (4, Kind.LEAK)):
        table.loc[row, "verdict"] = Kind.LEAK
        assert trend(table).state is state
    assert trend(table[2:5]).state is Kind.UNKNOWN  # two of three, as after a repair
    assert trend(table.assign(verdict=[*Kind, *Kind][:6])).state is Kind.UNKNOWN


def test_the_most_serious_state_gives_the_exit_code():
    assert exit_code([Kind.HEALTHY, Kind.HEALTHY]) == 0
    assert exit_code([Kind.HEALTHY, Kind.UNKNOWN]) == 12
    assert exit_code([Kind.UNKNOWN, Kind.OTHER]) == 11
    assert exit_code([Kind.OTHER, Kind.LEAK, Kind.UNKNOWN]) == 10


def test_sizes_have_the_error_of_the_thermometer_in_common(tmp_path):
    table = table_of(noisy(0.03 * 10.0 ** (np.arange(30) / 40.0), 0.005), tmp_path)
    level = trend(table).growth.level
    width = np.log10(level.high / level.low) / (2.0 * HALF_WIDTH)
    assert width > 0.02  # decades; 1.5 K alone are 0.024


# The command ---------------------------------------------------------------------------------------------------------


def test_the_command_writes_table_and_page_and_ends_with_the_code(tmp_path, monkeypatch, browser):
    monkeypatch.setattr(trend_job, "read_row", made_up)
    folder = recordings(tmp_path / "data", 20, broken=[("one", 3)])
    line = ("trend", folder, "--append", tmp_path / "out" / "t.csv", "--jobs", 1)
    answer = hydro(*line)
    assert answer.returncode == 10
    assert "left out: " in answer.stderr
    lines = [line for line in own_lines(answer.stdout) if not line.startswith("files:")]
    assert any(line.startswith("one will reach 0.30 l/min about ") for line in lines)
    assert answer.stdout.splitlines()[-2].endswith("t.csv: 39 files read, 0 known, 1 left out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"t.csv", "t.html", "figures", ".hydro.json"}
    page = (tmp_path / "out" / "t.html").read_text(encoding="utf-8")
    assert "not before" in page
    assert "Files that were not read" in page
    assert problems_everywhere(browser, tmp_path / "out" / "t.html") == []
    found = json.loads(hydro(*line, "--json").stdout)
    assert (found["exit_code"], found["files"]["known"]) == (10, 39)
    assert [axis["axis"] for axis in found["axes"]] == ["one", "two"]


def test_a_clock_that_jumped_back_between_files_is_told(tmp_path, monkeypatch):
    def long_days(*arguments):
        rows = made_up(*arguments)
        late = 1.5 * DAY if "03.csv" in arguments[1] else 100.0
        return {**rows, "until": rows["time"] + late}

    monkeypatch.setattr(trend_job, "read_row", long_days)
    done = watch([recordings(tmp_path / "data", axes=("one",))], Watch(tmp_path / "trend.csv"))
    assert [line.split(" begins")[0] for line in done.notes] == ["one: one/04.csv"]
    assert "a clock ran back" in done.notes[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--oil", "45"), "--oil 45"),
        (("--temperature", "60..20"), "--temperature"),
        (("--rig", "three=kovari_2015"), "known: one, two"),
        (("--map", "*.txt=map.yaml"), "matches none"),
    ],
)
def test_wrong_options_are_told_in_one_line(tmp_path, monkeypatch, options, words):
    monkeypatch.setattr(trend_job, "read_row", made_up)
    folder = recordings(tmp_path / "data", 1)
    assert_one_clear_line(hydro("trend", folder, "--append", tmp_path / "t.csv", "--jobs", 1, *options), words)


def test_nothing_to_read_is_told_in_one_line(tmp_path):
    assert_one_clear_line(hydro("trend", tmp_path / "absent"), "does not exist")
    (tmp_path / "empty").mkdir()
    assert_one_clear_line(hydro("trend", tmp_path / "empty"), "holds no recording")
    (tmp_path / "a.csv").write_text("Zeit,Stellgröße\n1,2\n2,3\n3,4\n4,5\n")
    answer = hydro("trend", tmp_path / "a.csv", "--append", tmp_path / "t.csv", "--jobs", 1)
    assert answer.returncode == 2
    assert "--map FILE" in answer.stderr
    assert "command:" in answer.stdout  # the guessed map
    assert not (tmp_path / "t.csv").exists()
