"""``hydro trend``: rows, table, dates, page and exit codes."""

import json
import os
import re

import numpy as np
import pandas as pd
import pytest
from browser import SIZES, open_page, problems_everywhere
from command_line import assert_one_clear_line, hydro
from recorded import recorded_file
from refusal import refused

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.report.kit import panel
from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.watching import watch as job
from hydro_rig.watching.fleet import Axis, Fleet
from hydro_rig.watching.page import draw_axis, trend_page
from hydro_rig.watching.table import COLUMNS, File, files_of, read_table, seconds, stamp, with_row
from hydro_rig.watching.trend import State, trend_of
from hydro_rig.watching.watch import Watched, row_of_file, watch

OIL, DAY = Oil.of("46"), 86400.0
AXIS = Axis(TaskConfig(), None, OIL, 0.3)
FLEET = Fleet(AXIS)
START = 1.79e9


@pytest.fixture(autouse=True)
def today(monkeypatch):
    """The command runs in the hours after the 20th day."""
    monkeypatch.setattr(job, "time", lambda: START + 20 * DAY)


def row(size, begin=START, verdict=None):
    """What the reading of a file gives."""
    kind = verdict or (Kind.LEAK if size > 0.05 else Kind.HEALTHY)
    sizes = {"size_40": size, "low_40": 0.9 * size, "high_40": 1.1 * size}
    return {"time": begin, "until": begin + 10.0, "verdict": kind.value, **sizes, "temperature": 40.0, "reason": ""}


def table_of(sizes, verdict=None, first=START, step=DAY):
    """The table of an axis with a reading a day."""
    rows = pd.DataFrame([row(size, first + step * day, verdict) for day, size in enumerate(sizes)], columns=[*row(0.0)])
    times = {name: rows[name].map(stamp) for name in ("time", "until")}
    return rows.assign(**times, axis="a", file="a/a.csv", bytes=100.0, repaired="")[list(COLUMNS)]


def made_up(path, *others):
    """Stands for the reading of a file."""
    del others
    if "broken" in path.read_text(encoding="utf-8"):
        raise ConfigurationError(f"{path}: holds no table")
    day = int(path.name[:2])
    return row(0.02 * 10.0 ** (day / 20.0), START + DAY * day)


def recordings(folder, days=10, axes=("one", "two"), broken=()):
    for axis in axes:
        (folder / axis).mkdir(parents=True, exist_ok=True)
        for day in range(days):
            (folder / axis / f"{day:02d}.csv").write_text("broken" if (axis, day) in broken else "numbers")
    return folder


# One file ------------------------------------------------------------------------------------------------------------


def test_a_file_becomes_one_row_with_the_leak_at_40_degrees(tmp_path):
    path = tmp_path / "press_2026-10-03T0600.csv"
    recorded_file(path, leakage=0.3, duration=4.0)
    rows = pd.read_csv(path, comment="#").assign(**{"oil_temperature [°C]": 55.0})
    rows.to_csv(path, index=False)
    found = row_of_file(path, AXIS)
    assert stamp(found["time"]) == "2026-10-03T06:00:00"
    assert found["until"] - found["time"] == pytest.approx(3.995)
    assert found["verdict"] == Kind.LEAK
    assert found["temperature"] == pytest.approx(55.0)
    assert found["low_40"] < 0.3 * float(OIL.factor(55.0)) < found["high_40"]


def test_an_impossible_temperature_of_the_oil_is_told_and_does_not_count(tmp_path):
    path = tmp_path / "press_2026-10-03T0600.csv"
    recorded_file(path, leakage=0.3, duration=4.0)
    rows, found = pd.read_csv(path, comment="#"), []
    for temperature in (np.nan, 310.0):  # kelvin under the heading of °C
        rows.assign(**{"oil_temperature [°C]": temperature}).to_csv(path, index=False)
        found.append(row_of_file(path, AXIS))
    sizes = [[row[name] for name in ("size_40", "low_40", "high_40")] for row in found]
    assert sizes[1] == sizes[0]
    assert np.isnan(found[1]["temperature"])
    assert "oil_temperature" in found[1]["reason"]
    table = table_of([0.01] * 5).assign(reason=found[1]["reason"])
    assert "oil_temperature" in trend_of("a", table, AXIS, "").line()


# The table -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(job, "row_of_file", made_up)


def test_nothing_is_appended_twice_and_a_file_that_grew_is_read_again(tmp_path, quick):
    folder, table = recordings(tmp_path / "data", 5), tmp_path / "out" / "trend.csv"
    first = watch([folder], table, FLEET)
    assert (first.read, first.known, len(first.left_out)) == (10, 0, 0)
    text = table.read_text()
    again = watch([folder], table, FLEET)
    assert (again.read, again.known) == (0, 10)
    assert table.read_text() == text
    recordings(folder, days=6)
    (folder / "one" / "03.csv").write_text("numbers and more")
    third = watch([folder], table, FLEET)
    assert (third.read, third.known) == (3, 9)
    rows = read_table(table)
    assert len(rows) == 12
    assert not rows.duplicated(["axis", "time"]).any()
    assert list(rows.columns) == list(COLUMNS)


def test_a_fleet_lists_axes_without_recordings_and_tells_of_recordings_without_an_axis(tmp_path, quick):
    folder, fleet = recordings(tmp_path / "data", 20), Fleet(AXIS, {"one": AXIS, "three": AXIS}, "fleet.yaml")
    done = watch([folder], tmp_path / "trend.csv", fleet)
    assert {one.axis: one.states[0] for one in done.trends} == {
        "one": "internal leak",
        "two": "unread",
        "three": "stale",
    }
    assert (done.read, len(done.left_out), done.exit_code) == (20, 1, 10)
    before = (tmp_path / "trend.csv").stat().st_mtime_ns
    assert watch([], tmp_path / "trend.csv", fleet).trends[0].axis == "one"  # the table alone
    assert (tmp_path / "trend.csv").stat().st_mtime_ns == before


def test_a_broken_file_costs_one_line_and_is_read_once_it_is_whole(tmp_path, quick):
    folder = recordings(tmp_path / "data", 4, broken=[("two", 2)])
    done = watch([folder], tmp_path / "trend.csv", FLEET)
    assert len(read_table(tmp_path / "trend.csv")) == 7
    assert done.left_out == [f"{folder}/two/02.csv: holds no table"]
    (folder / "two" / "02.csv").write_text("numbers")
    assert watch([folder], tmp_path / "trend.csv", FLEET).read == 1


def test_an_interruption_loses_no_finished_file(tmp_path, monkeypatch):
    calls = []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return made_up(*arguments)

    monkeypatch.setattr(job, "row_of_file", interrupted)
    folder = recordings(tmp_path / "data")
    with pytest.raises(KeyboardInterrupt):
        watch([folder], tmp_path / "trend.csv", FLEET)
    kept = len(read_table(tmp_path / "trend.csv"))
    assert kept >= 1
    assert watch([folder], tmp_path / "trend.csv", FLEET).read == 20 - kept


def test_marks_and_columns_of_the_user_stay(tmp_path):
    table_of([0.02]).assign(note="seal 4711", repaired="x").to_csv(tmp_path / "t.csv", index=False)
    file = File(tmp_path / "a.csv", "a", "a/a.csv", 200)
    read = with_row(read_table(tmp_path / "t.csv"), file, row(0.03))
    assert read[["size_40", "bytes", "repaired"]].to_numpy().tolist() == [[0.03, 200, "x"]]
    other = with_row(read_table(tmp_path / "t.csv"), file._replace(name="a/b.csv"), row(0.03, START + DAY))
    assert other["note"].fillna("").tolist() == ["seal 4711", ""]


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
    "axis09.csv.gz": "axis09",
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
    given = written(tmp_path, "a/1.csv", "a/2.log", "a/3.log", "b/4.dat", "a/_5.csv", ".git/6.csv", "t.html")
    assert files_of([given], tmp_path / "t.csv")[1] == "files that are no recordings: 1 .dat, 2 .log"


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


GROWING = noisy(0.03 * 10.0 ** (np.arange(30) / 40.0))  # 0.3 on day 40


def trend(table, late=0.0, limit=0.3):
    """The trend of an axis, so many days after its last reading."""
    return trend_of("a", table, AXIS._replace(limit=limit), "", seconds(table["until"]).max() + late * DAY)


def test_a_growing_leak_has_a_date_with_an_interval():
    one = trend(table_of(GROWING))
    assert one.states == [State.LEAK]
    assert one.growth.not_before < one.growth.ahead.low <= 11.0 <= one.growth.ahead.high
    dates = one.facts()["limit_reached"]
    assert dates["value"] == stamp(one.now + DAY * one.growth.ahead.value)[:10]
    assert f"reached about {dates['value']} ({dates['low']} to {dates['high']})" in one.line()
    later = trend(table_of(GROWING), 2.5)
    assert one.growth.ahead.value - later.growth.ahead.value == pytest.approx(2.5, abs=0.1)  # ahead of today


def test_a_healthy_axis_gets_no_date_and_one_at_the_limit_comes_first():
    healthy = trend(table_of(noisy(np.full(30, 0.015), 0.1)))
    assert (healthy.states, healthy.dated) == ([State.HEALTHY], False)
    reached = trend(table_of(noisy(0.1 * 10.0 ** (np.arange(30) / 40.0))))
    assert reached.growth.ahead.value == 0.0
    assert reached.urgency < trend(table_of(GROWING)).urgency < healthy.urgency
    assert trend(table_of([0.01, 0.02, 0.01])).facts()["limit_reached"] is None


def test_only_readings_since_the_repair_count():
    before, after = 0.05 * 10.0 ** (np.arange(20) / 30.0), np.full(12, 0.012)
    table = table_of(noisy([*before, *after]))
    day = stamp(START + 20 * DAY)
    marked = table.assign(repaired=["x" if when == day else "" for when in table["time"]])
    assert trend(marked).growth.level.high < 0.02


def test_two_odd_verdicts_change_no_state():
    table = table_of(np.full(6, 0.015))
    for place, state in ((5, State.HEALTHY), (3, State.HEALTHY), (4, State.LEAK)):
        table.loc[place, "verdict"] = Kind.LEAK.value
        assert trend(table).states == [state]
    assert trend(table[2:5]).states == [State.UNKNOWN]  # two of three, as after a repair
    assert trend(table.assign(verdict=[*Kind, *Kind][:6])).states == [State.UNKNOWN]


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
    axis = trend(table_of([0.01]))
    trends = [axis._replace(states=[State(state)]) for state in states.split(", ")]
    assert Watched(trends, 0, 0, []).exit_code == code


@pytest.mark.parametrize(("sizes", "state"), [(noisy(np.full(30, 0.009), 0.1), State.HEALTHY), (GROWING, State.LEAK)])
def test_an_axis_without_a_new_reading_is_stale_and_gets_no_date(sizes, state):
    table = table_of(sizes)
    after = {late: trend(table, late) for late in (2.9, 3.1, 46.0)}
    assert [State.STALE in one.states for one in after.values()] == [False, True, True]
    old = after[46.0]
    assert (State.LEAK in old.states) == (state is State.LEAK)  # what leaked before is not forgotten
    assert State.HEALTHY not in old.states
    assert old.line().endswith("last reading 2026-10-20, 46.0 d ago")
    assert old.facts()["limit_reached"] is None
    weekly = table_of(np.full(9, 0.009), step=7 * DAY)
    assert [trend(weekly, late).states[0] for late in (20.0, 22.0, -22.0)] == [State.HEALTHY, State.STALE, State.STALE]


def burst(size, count, kind=Kind.LEAK):
    """A healthy axis whose last readings are others."""
    table = table_of([*noisy(np.full(57, 0.009), 0.1), *np.full(count, size)])
    table.loc[table["size_40"] > 0.05, "verdict"] = kind.value
    return table


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6])
def test_a_reading_above_the_limit_alarms_at_once(count):
    one = trend(burst(3.4, count))
    assert one.states == [State.LEAK]
    assert one.leak.value > 0.3
    assert one.urgency[0] == 0
    assert one.facts()["leak_40"]["value"] > 0.3
    undecided = table_of([np.nan], verdict=Kind.UNKNOWN, first=START + 70 * DAY)
    assert State.LEAK in trend(pd.concat([burst(3.4, count), undecided])).states  # it takes nothing back
    assert trend(burst(3.4, 1, Kind.UNKNOWN)).states == [State.HEALTHY]  # no reading of a leak


def test_a_leak_below_the_limit_needs_three_readings():
    for count, state in ((1, State.HEALTHY), (2, State.HEALTHY), (3, State.LEAK), (4, State.LEAK)):
        assert trend(burst(0.15, count)).states == [state]
    assert trend(burst(0.15, 3)).leak.value > 0.1
    back = trend(table_of([*np.full(20, 0.009), 3.4, 0.009]))
    assert back.states == [State.HEALTHY]  # a single odd reading


def test_sizes_have_the_error_of_the_thermometer_in_common():
    level = trend(table_of(noisy(GROWING, 0.005))).growth.level
    assert np.log10(level.high / level.low) / (2.0 * HALF_WIDTH) > 0.02  # decades; 1.5 K alone are 0.024


def test_a_single_reading_has_an_axis_of_hours():
    for size in (3.4, np.nan):
        axes = panel(height=2.6)
        draw_axis(axes, trend(table_of([size])))
        begin, end = axes.get_xlim()
        assert begin < START / DAY < end < begin + 1.0


def test_the_page_for_monday_is_read_on_a_phone_and_a_click_leads_to_the_axis(browser, tmp_path):
    tables = {"burst": burst(3.4, 2), "growing": table_of(GROWING), "quiet": table_of(np.full(9, 0.009))}
    now = START + 60 * DAY
    trends = [trend_of(name, table, AXIS, "", now) for name, table in tables.items()]
    trends.append(trend_of("hall2/absent", table_of([]), AXIS, "", now))
    trends.sort(key=lambda one: one.urgency)
    assert [one.condition for one in trends] == ["out of specification", "maintenance required", "no data", "no data"]
    trend_page(trends, "t.csv", []).write(tmp_path / "t.html")
    assert problems_everywhere(browser, tmp_path / "t.html") == []
    with open_page(browser, tmp_path / "t.html", width=SIZES[0]) as page:
        page.click(".links a:has-text('hall2/absent')")
        assert page.evaluate("document.querySelector(':target').textContent") == "hall2/absent"


# The command ---------------------------------------------------------------------------------------------------------


def test_the_command_writes_table_and_page_and_ends_with_the_code(tmp_path, quick):
    folder = recordings(tmp_path / "data", 20, broken=[("one", 3)])
    line = ("trend", folder, "--append", tmp_path / "out" / "t.csv")
    answer = hydro(*line)
    assert answer.returncode == 10
    assert "left out: " in answer.stderr
    assert "limit 0.30, reached about " in answer.stdout
    assert f"{tmp_path}/out/t.csv: 39 files read, 0 known, 1 left out" in answer.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"t.csv", "t.html"}
    assert "03.csv: holds no table" in (tmp_path / "out" / "t.html").read_text(encoding="utf-8")
    found = json.loads(hydro(*line, "--json").stdout)
    assert (found["exit_code"], found["files"]["known"]) == (10, 39)
    assert sorted(axis["axis"] for axis in found["axes"]) == ["one", "two"]


def test_silence_is_told_with_its_exit_code_on_console_page_and_in_json(tmp_path, quick, monkeypatch):
    folder, line = (
        recordings(tmp_path / "data", 9),
        ("trend", tmp_path / "data", "--append", tmp_path / "t.csv", "--limit", 30),
    )
    monkeypatch.setattr(job, "time", lambda: START + 8.5 * DAY)
    assert hydro(*line).returncode == 0
    monkeypatch.setattr(job, "time", lambda: START + 54.0 * DAY)
    written(folder, "one/09.rtf")
    stale = hydro(*line)
    assert stale.returncode == 14
    assert "hydro: left out: files that are no recordings: 1 .rtf" in stale.stderr
    assert stale.stdout.count("stale (no reading within 3 d); leak 0.05") == 2
    recordings(folder, 10, broken=[("one", 9)], axes=("one",))
    recordings(folder, 1, broken=[("new", 0)], axes=("new",))
    unread = hydro(*line, "--json")
    assert unread.returncode == 13
    found = {axis["axis"]: axis for axis in json.loads(unread.stdout)["axes"]}
    states = {"new": ["unread"], "one": ["unread", "stale"], "two": ["stale"]}
    assert {name: axis["states"] for name, axis in found.items()} == states
    assert found["one"]["reason"].startswith(f"{folder}/one/09.csv: holds no table; no reading within 3 d")
    assert (found["new"]["last"], found["new"]["age_days"], found["new"]["readings"]) == (None, None, 0)
    assert found["two"]["last"].startswith("2026-09-29T")
    assert found["two"]["age_days"] == pytest.approx(46.0, abs=0.01)
    page = (tmp_path / "t.html").read_text(encoding="utf-8")
    assert re.findall(r'<a class="\w*" href="#\w*"><b>(.*?)</b>', page) == [*states]


def test_an_old_file_that_cannot_be_read_does_not_hide_newer_ones(tmp_path, quick):
    folder = recordings(tmp_path / "data", 20, axes=("one",), broken=[("one", 3)])
    os.utime(folder / "one" / "03.csv", (START, START))
    done = watch([folder], tmp_path / "trend.csv", FLEET)
    assert len(done.left_out) == 1
    assert State.UNREAD not in done.trends[0].states


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--oil", "45"), "oil 45"),
        (("--map", "absent.yaml"), "absent.yaml"),
        (("--fleet", "absent.yaml", "--limit", "0.2"), "holds limit itself"),
    ],
)
def test_wrong_options_are_told_in_one_line(tmp_path, options, words):
    folder = recordings(tmp_path / "data", 1)
    assert_one_clear_line(hydro("trend", folder, "--append", tmp_path / "t.csv", *options), words)


def test_nothing_to_read_is_told_in_one_line(tmp_path):
    assert_one_clear_line(hydro("trend", tmp_path / "absent"), "does not exist")
    (tmp_path / "empty").mkdir()
    assert_one_clear_line(hydro("trend", tmp_path / "empty"), "holds no recording")
    (tmp_path / "a.csv").write_text("Zeit,Stellgröße\n1,2\n2,3\n3,4\n4,5\n")
    answer = hydro("trend", tmp_path / "a.csv", "--append", tmp_path / "t.csv")
    assert answer.returncode == 2
    assert "--map FILE names the columns" in answer.stderr
    assert "headings: Zeit, Stellgröße" in answer.stderr
    assert not (tmp_path / "t.csv").exists()
