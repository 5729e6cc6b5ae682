"""``hydro trend``: rows, table, dates, page and exit codes."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import problems_everywhere
from command_line import assert_one_clear_line, hydro, own_lines
from matplotlib.figure import Figure
from recorded import recorded_file
from refusal import refused

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.report.content import Content
from hydro_agents.report.sections import Text
from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.monitoring import trend_job, trend_page
from hydro_rig.monitoring.oil import Oil
from hydro_rig.monitoring.trend import Settings, row_of_file
from hydro_rig.monitoring.trend_job import Watch, watch
from hydro_rig.monitoring.trend_summary import State, exit_code, trends_of
from hydro_rig.monitoring.trend_table import (
    COLUMNS,
    File,
    files_of,
    read_table,
    seconds,
    stamp,
    unread,
    with_rows,
    write_table,
)

OIL, DAY = Oil.of("46"), 86400.0
START = 1.79e9


@pytest.fixture(autouse=True)
def today(monkeypatch):
    """The command runs in the hours after the 20th day."""
    monkeypatch.setattr(trend_job, "time", lambda: START + 20 * DAY)


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


AXES = {
    "press/a.csv": "press",
    "press/2026-10-03.csv": "press",
    "press/2026/10/03.csv": "press",
    "hall1/axis01/a.csv": "hall1/axis01",
    "hall1/axis02/a.csv": "hall1/axis02",
    "axis=3/date=2026-10-03/part.parquet": "3",
    "line=1/axis=3/year=2026/month=10/part.parquet": "1/3",
    "2026-10-01/axis01.csv": "axis01",
    "2026-10-01/hall1/axis02/a.csv": "hall1/axis02",
    "2026-10-01/4/a.csv": "4",
    "axis05_2026.csv": "axis05",
    "axis06 2026-10-03T0600.csv": "axis06",
    "20261003_axis07.csv": "axis07",
    "axis08.csv": "axis08",
    "2026-10-03_06-00-00.csv": "given",
    "017.csv": "given",
}


def written(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    return folder


def test_the_path_below_the_folder_names_the_axis_without_dates(tmp_path):
    given = written(tmp_path / "given", *AXES)
    files, others = files_of([given], tmp_path / "trend.csv")
    assert {str(file.path.relative_to(given)): file.axis for file in files} == AXES
    assert all(file.name.startswith(f"{file.axis}/") for file in files)
    assert {file.name for file in files} >= {"press/2026-10-03.csv", "3/date=2026-10-03/part.parquet"}
    assert not others
    single, _ = files_of([given / "press/2026-10-03.csv"], tmp_path / "trend.csv")
    assert [file.name for file in single] == ["press/2026-10-03.csv"]


def test_files_that_are_no_recordings_are_told_and_hidden_ones_are_not(tmp_path):
    given = written(tmp_path, "a/1.csv", "a/2.csv.gz", "a/3.csv.gz", "b/4.dat", "a/_5.csv", ".git/6.csv", "t.html")
    assert files_of([given], tmp_path / "t.csv")[1] == "files that are no recordings: 1 .dat, 2 .gz"


def test_two_files_of_one_name_are_refused(tmp_path):
    given = written(tmp_path, "hall1/axis01/a.csv", "hall2/axis01/a.csv")
    with refused("is 'axis01/a.csv' as well; give the folder above both"):
        files_of([given / "hall1", given / "hall2"], tmp_path / "t.csv")


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "", f"{','.join(COLUMNS)}\n,\n", "\x00\x01"])
def test_another_table_is_not_touched(tmp_path, text):
    (tmp_path / "t.csv").write_text(text)
    with refused("is no table of hydro trend"):
        read_table(tmp_path / "t.csv")


# States and dates ----------------------------------------------------------------------------------------------------


def noisy(sizes, spread=0.02):
    return np.asarray(sizes) * 10.0 ** np.random.default_rng(5).normal(0.0, spread, len(sizes))


def trend(table, late=0.0, limit=0.3):
    """The trend of an axis, so many days after its last reading."""
    return trends_of(table, {"a": limit}, OIL, now=seconds(table["until"]).max() + late * DAY)[0]


def test_the_sentence_tells_date_interval_and_not_before(tmp_path):
    sizes = 0.03 * 10.0 ** (np.arange(30) / 40.0)  # 0.3 on day 40
    one = trend(table_of(noisy(sizes), tmp_path))
    assert one.state is State.LEAK
    assert one.dated
    assert one.growth.ahead.low <= 11.0 <= one.growth.ahead.high
    assert one.growth.not_before < one.growth.ahead.low
    date = one.date(one.growth.ahead.value)
    assert one.sentence().startswith("a leaks 0.16 l/min (")
    assert f" and will reach 0.30 l/min about {date} (90 %: " in one.sentence()
    assert one.sentence().endswith(f"; not before {one.date(one.growth.not_before)}.")
    assert one.json()["limit_reached"]["expected"] == stamp(one.now + DAY * one.growth.ahead.value)[:10]


def test_a_healthy_axis_gets_no_date_and_one_at_the_limit_is_told(tmp_path):
    healthy = trend(table_of(noisy(np.full(30, 0.015), 0.1), tmp_path))
    assert (healthy.state, healthy.dated) == (State.HEALTHY, False)
    assert "does not grow measurably" in healthy.sentence()
    reached = trend(table_of(noisy(0.1 * 10.0 ** (np.arange(30) / 40.0)), tmp_path))
    assert reached.sentence().startswith("a has reached 0.30 l/min: it leaks 0.5")
    few = trend(table_of([0.01, 0.02, 0.01], tmp_path))
    assert "too few readings" in few.sentence()
    assert few.json()["limit_reached"] is None


def test_only_readings_since_the_repair_count(tmp_path):
    before, after = 0.05 * 10.0 ** (np.arange(20) / 30.0), np.full(12, 0.012)
    table = table_of(noisy([*before, *after]), tmp_path)
    day = stamp(START + 20 * DAY)
    marked = table.assign(repaired=["x" if when == day else "" for when in table["time"]])
    assert trend(marked).growth.level.high < 0.02
    assert trend(marked).repairs == (START + 20 * DAY,)


def test_two_odd_verdicts_change_no_state(tmp_path):
    table = table_of(np.full(6, 0.015), tmp_path)
    for row, state in ((5, State.HEALTHY), (3, State.HEALTHY), (4, State.LEAK)):
        table.loc[row, "verdict"] = Kind.LEAK
        assert trend(table).state is state
    assert trend(table[2:5]).state is State.UNKNOWN  # two of three, as after a repair
    assert trend(table.assign(verdict=[*Kind, *Kind][:6])).state is State.UNKNOWN


@pytest.mark.parametrize(
    ("states", "code"),
    [
        ("healthy, healthy", 0),
        ("healthy, cannot tell", 12),
        ("cannot tell, stale", 14),
        ("stale, unread", 13),
        ("unread, something else", 11),
        ("something else, internal leak, stale", 10),
    ],
)
def test_the_most_serious_state_gives_the_exit_code(states, code):
    assert exit_code([State(state) for state in states.split(", ")]) == code


def test_an_axis_without_a_new_reading_is_stale_and_gets_no_date(tmp_path):
    days = np.arange(30)
    for sizes in (noisy(np.full(30, 0.009), 0.1), noisy(0.03 * 10.0 ** (days / 40.0))):
        table = table_of(sizes, tmp_path)
        after = {late: trend(table, late) for late in (2.9, 3.1, 46.0)}
        assert [State.STALE in one.states for one in after.values()] == [False, True, True]
        assert "Now: healthy" not in after[46.0].line()
        assert f"leaked {sizes[-1]:.2g}" in after[46.0].line()
        assert after[46.0].line().count("2026") == 1  # the day of the last reading
        assert after[46.0].line().endswith("Last reading: 20 Oct 2026, 46 d ago.")
        assert after[46.0].json()["limit_reached"] is None
    assert after[46.0].states == (State.LEAK, State.STALE)  # what leaked before is not forgotten
    weekly = table_of(np.full(9, 0.009), tmp_path, step=7 * DAY)
    assert [trend(weekly, late).state for late in (20.0, 22.0, -22.0)] == [State.HEALTHY, State.STALE, State.STALE]


def test_dates_lie_ahead_of_today(tmp_path):
    table = table_of(noisy(0.03 * 10.0 ** (np.arange(30) / 40.0)), tmp_path)
    at_once, later = trend(table), trend(table, 2.5)
    assert at_once.growth.ahead.value - later.growth.ahead.value == pytest.approx(2.5, abs=0.1)
    assert trend(table_of(noisy(np.full(30, 0.1)), tmp_path, verdict=Kind.HEALTHY), 2.5).growth.not_before > 0.0


def burst(tmp_path, size, count, kind=Kind.LEAK):
    """A healthy axis whose last readings are others."""
    table = table_of([*noisy(np.full(57, 0.009), 0.1), *np.full(count, size)], tmp_path)
    table.loc[table["size"] > 0.05, "verdict"] = kind
    return table


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6])
def test_a_reading_above_the_limit_alarms_at_once(tmp_path, count):
    one = trend(burst(tmp_path, 3.4, count))
    assert one.state is State.LEAK
    assert one.leak.value > 0.3
    assert one.urgency[0] == 0
    assert re.match("a leaks 3.4 l/min .* in its last reading, above 0.30|a has reached 0.30", one.sentence())
    assert "does not reach" not in one.sentence()
    assert one.json()["leak_40"]["value"] > 0.3
    odd = pd.concat(
        [burst(tmp_path, 3.4, count), table_of([np.nan], tmp_path, verdict=Kind.UNKNOWN, first=START + 70 * DAY)]
    )
    assert trend(odd).state is State.LEAK  # an undecided reading takes nothing back
    assert trend(burst(tmp_path, 3.4, 1, Kind.UNKNOWN)).state is State.HEALTHY  # no reading of a leak


def test_the_sentence_of_a_leak_below_the_limit_does_not_contradict_its_last_readings(tmp_path):
    for count, state in ((1, State.HEALTHY), (2, State.HEALTHY), (3, State.LEAK), (4, State.LEAK)):
        assert trend(burst(tmp_path, 0.15, count)).state is state
    one = trend(burst(tmp_path, 0.15, 3))
    assert one.sentence().startswith("a leaks 0.1")
    assert "does not reach" not in one.sentence()
    back = trend(table_of([*np.full(20, 0.009), 3.4, 0.009], tmp_path))
    assert back.state is State.HEALTHY  # a single odd reading


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
    assert any(" and will reach 0.30 l/min about " in line for line in lines)
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


def test_silence_is_told_with_its_exit_code_on_console_page_and_in_json(tmp_path, monkeypatch, browser):
    monkeypatch.setattr(trend_job, "read_row", made_up)
    monkeypatch.setattr(trend_job, "USUAL_LIMIT", 30.0)
    folder, line = recordings(tmp_path / "data", 9), ("trend", tmp_path / "data", "--append", tmp_path / "t.csv")
    monkeypatch.setattr(trend_job, "time", lambda: START + 8.5 * DAY)
    assert hydro(*line).returncode == 0
    monkeypatch.setattr(trend_job, "time", lambda: START + 54.0 * DAY)
    written(folder, "one/09.csv.gz")
    stale = hydro(*line)
    assert stale.returncode == 14
    assert "hydro: left out: files that are no recordings: 1 .gz" in stale.stderr
    assert stale.stdout.count("Now: stale (no reading within 3 d). Last reading: 29 Sep 2026, 46 d ago.") == 2
    recordings(folder, 10, broken=[("one", 9), ("new", 0)], axes=("one",))
    recordings(folder, 1, broken=[("new", 0)], axes=("new",))
    unread = hydro(*line, "--json")
    assert unread.returncode == 13
    found = {axis["axis"]: axis for axis in json.loads(unread.stdout)["axes"]}
    assert {name: axis["states"] for name, axis in found.items()} == {
        "new": ["unread"],
        "one": ["unread", "stale"],
        "two": ["stale"],
    }
    assert found["one"]["reason"].startswith(f"{folder}/one/09.csv: holds no table; no reading within 3 d")
    assert (found["new"]["last"], found["new"]["age_days"], found["new"]["readings"]) == (None, None, 0)
    assert found["two"]["last"].startswith("2026-09-29T")
    assert found["two"]["age_days"] == pytest.approx(46.0, abs=0.01)
    page = (tmp_path / "t.html").read_text(encoding="utf-8")
    assert "No axis is known to leak, but 3 of 3 are not known to be healthy." in page
    rows = re.findall(r'<tr><th scope="row">(.*?)</tr>', page)
    assert [row.split("</th>")[0] for row in rows] == ["new", "one", "two"]  # the worst first
    assert [re.findall("<td>(.*?)</td>", row)[0] for row in rows] == ["unread", "unread, stale", "stale"]
    assert [re.findall("<td>(.*?)</td>", row)[2:] for row in rows[1:]] == [["29 Sep 2026", "46 d", "9"]] * 2
    assert problems_everywhere(browser, tmp_path / "t.html") == []


def test_an_old_file_that_cannot_be_read_does_not_hide_newer_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(trend_job, "read_row", made_up)
    folder = recordings(tmp_path / "data", 20, axes=("one",), broken=[("one", 3)])
    os.utime(folder / "one" / "03.csv", (START, START))
    done = watch([folder], Watch(tmp_path / "trend.csv"))
    assert len(done.left_out) == 1
    assert State.UNREAD not in done.trends[0].states


def test_no_reading_lies_beyond_the_figure(tmp_path, monkeypatch):
    """The panels share their scale, whatever axis comes last."""
    figures = []
    monkeypatch.setattr(trend_page, "make_plot", lambda *given: figures.append(given[4]) or Text(""))
    tables = [table_of(sizes, tmp_path).assign(axis=name) for name, sizes in {"a": [4.0] * 5, "b": [0.01] * 5}.items()]
    trends = trends_of(pd.concat(tables), {"a": 0.3, "b": 0.3}, OIL)
    for ordered in (trends, trends[::-1]):
        figure = Figure()
        trend_page.sizes_over_time(Content({}, others={"trends": ordered}))
        figures[-1](figure)
        assert all(axes.get_ylim()[1] > 4.0 for axes in figure.axes)


def test_a_guessed_map_is_said_to_stand_above_only_where_it_does(tmp_path, monkeypatch):
    folder, line = recordings(tmp_path / "data", 2), ("trend", tmp_path / "data", "--append", tmp_path / "t.csv")
    with monkeypatch.context() as patch:
        patch.setattr(trend_job, "read_row", made_up)
        hydro(*line)
    (folder / "one" / "02.csv").write_text("Zeit,Stellgröße\n1,2\n2,3\n3,4\n4,5\n")
    answer = hydro(*line)
    assert "no column has the heading 'time'; --map FILE" in answer.stderr
    assert "stands above" not in answer.stderr
    assert answer.returncode == 13


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
    assert "a map guessed from the headings stands above: save it as FILE, check it, add --map FILE" in answer.stderr
    assert "command:" in answer.stdout  # the guessed map
    assert not (tmp_path / "t.csv").exists()
