"""``hydro watch``: rows become looks; the wiring is named before an alarm; a restart and a kill lose nothing."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
from refusal import refused

from hydro_agents.learning.loading import shipped
from hydro_env import TaskConfig, task_config
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.diagnosis.verdict import Leak
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.simulated import record_axis
from hydro_rig.watching.fleet import Axis, Fleet
from hydro_rig.watching.rows import MOST_LINES, SIGNALS, RowError, RowReader, broker, in_protocol, lines_of
from hydro_rig.watching.stream import KEPT, FleetWatch, Look
from hydro_rig.watching.table import read_table, write_table
from hydro_rig.watching.trend import Condition

TASK = TaskConfig(episode_duration=32.0)
POSITION, PRESSURE_A, COMMAND = (SIGNALS.index(name) for name in ("position", "pressure_a", "command"))


def rows_of(leak, folder):
    """The lines of a moving axis."""
    file = folder / "axis.csv"
    record_axis(file, TASK, shipped("pid", TASK), 1, leak, "multi_sine")
    return file.read_text().splitlines()


@pytest.fixture(scope="module")
def leaking(tmp_path_factory):
    return rows_of(0.3, tmp_path_factory.mktemp("leaking"))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    return rows_of(0.01, tmp_path_factory.mktemp("healthy"))


FLEET = Fleet(Axis(TASK, None, Oil.of("46"), 0.5))


def fleet_in(folder):
    return FleetWatch(FLEET, folder / "watch.csv")


def cells(lines):
    """Time and cells of the rows, (n, 6)."""
    return np.array([line.split(",") for line in lines[1:]], float)


def in_csv(lines, values):
    return [lines[0], *(",".join(f"{value:.9g}" for value in row) for row in values)]


# Lines ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "lines",
    [
        ["time [ms];axis;position [mm];pressure_a [bar];command [%]", "1500;lift;-12.5;31;25"],
        ["time [s];axis;position [mm];pressure_a [bar];command [V]", "1,5;lift;-12,5;31,0;2,5"],
        ["\ufefftime [s],pressure_a [MPa],axis,position [m],command [V]\r\n", '"1.5",3.1,"lift",-0.0125,2.5\r\n'],
    ],
)
def test_a_csv_row_holds_its_signals_in_si_and_its_axis(lines):
    reader = RowReader(FLEET)
    assert reader.row(lines[0]) is None
    row = reader.row(lines[1])
    assert (row.axis, row.time) == ("lift", 1.5)
    assert row.values[[POSITION, PRESSURE_A, COMMAND]] == pytest.approx([-0.0125, 31e5, 0.25])
    assert np.isnan(row.values).sum() == len(SIGNALS) - 3


def test_line_protocol_is_read_with_escaped_names_and_a_map():
    columns = {"time": "time", "command": {"column": "u", "unit": "V"}, "position": {"column": "pos x", "unit": "mm"}}
    fleet = Fleet(Axis(TASK, ColumnMap(**columns), Oil.of("46"), 0.5))
    reader = RowReader(fleet, tag="machine")
    at = 1700000000250000000
    assert reader.row(rf'plc,machine=lift\ 3,site=a pos\ x=-12.5,note="a, b=c d" {at}') is None
    assert reader.row(rf"plc,machine=lift\ 3 u=5i {at}") is None  # another field at the same time
    row = reader.row(rf"plc,machine=lift\ 3 u=1 {at + 5000000}")
    assert row.axis == "lift 3"
    assert row.time == pytest.approx(1700000000.25, abs=1e-6)
    assert row.values[[POSITION, COMMAND]] == pytest.approx([-0.0125, 0.5])
    other = RowReader(fleet)
    sent = [in_protocol("m", "lift 3", {r"pos\ x": -12.5, "u": 5.0}, time) for time in (2.5, 3.0)]
    back = [other.row(line) for line in sent][1]
    assert (back.axis, back.time, back.values[COMMAND]) == ("lift 3", 2.5, 0.5)


def test_a_truncated_line_of_line_protocol_is_left_out():
    reader = RowReader(FLEET)
    for line in ("plc,axis=lift", "plc,axis=lift u=5"):
        with pytest.raises(RowError, match="line "):
            reader.row(line)
    assert reader.row("plc,axis=lift u=5 1700000000250000000") is None
    with pytest.raises(RowError, match="line 4: "):
        reader.row("plc")


@pytest.mark.parametrize("count", [0, 1, 4])
def test_rows_that_do_not_fill_a_look_are_counted(count, healthy, tmp_path, capsys):
    assert not list(fleet_in(tmp_path).looks(healthy[:count]))
    assert f"{max(count - 1, 0)} rows" in capsys.readouterr().err


def test_what_is_no_row_is_refused_with_its_line():
    with refused("no column has the heading 'command'"):
        RowReader(FLEET).row("time [s],position [mm]")
    reader = RowReader(FLEET)
    reader.row("time [s],position [mm],command [V]")
    for line, what in (("", ""), ("noon,1,2", "line 3: time 'noon': must be a number or")):
        if not what:
            assert reader.row(line) is None
            continue
        with pytest.raises(RowError, match=what):
            reader.row(line)


def test_a_slow_reader_holds_the_source_back():
    put_so_far = []

    def fill(put):
        for number in range(3 * MOST_LINES):
            put(str(number))
            put_so_far.append(number)

    lines = lines_of(fill)
    assert next(lines) == "0"
    time.sleep(0.5)
    assert len(put_so_far) <= MOST_LINES + 2
    assert [next(lines) for _ in range(3)] == ["1", "2", "3"]


def test_an_address_of_a_broker_is_checked():
    with refused("must be HOST"):
        broker("localhost")


@pytest.mark.skipif(shutil.which("mosquitto") is None, reason="needs the broker mosquitto")
def test_rows_come_from_a_broker_that_goes_and_comes_back():
    publish = pytest.importorskip("paho.mqtt.publish")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    def begun():
        process = subprocess.Popen(["mosquitto", "-p", str(port)], stderr=subprocess.DEVNULL)
        for _ in range(100):
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), 0.1):
                return process
            time.sleep(0.05)
        raise AssertionError("mosquitto does not begin")

    process = begun()
    lines = lines_of(broker(f"127.0.0.1:{port}/hall/#"))
    heard = []
    for sent in ("first\nsecond", "third\nfourth"):
        for _ in range(30):  # until the client is there, again
            publish.single("hall/lift", sent, qos=1, hostname="127.0.0.1", port=port)
            heard.append(next(lines))
            if heard[-1] in sent.split("\n"):
                break
        process.terminate()
        process.wait()
        process = begun()
    process.terminate()
    process.wait()
    assert {"first", "third"} <= set(heard)


# Axes ----------------------------------------------------------------------------------------------------------------


def test_a_leak_of_a_moving_axis_is_told_within_30_s_and_a_healthy_one_is_good(leaking, healthy, tmp_path):
    fleet = fleet_in(tmp_path)
    found = {}
    later = in_csv(healthy, np.add(cells(healthy), [32.0, 0, 0, 0, 0, 0]))
    for axis, lines in (("wet", leaking), ("dry", later)):
        found[axis] = list(fleet.looks([lines[0] + ",axis", *(f"{line},{axis}" for line in lines[1:])]))
    wet = [look for look in found["wet"] if look.condition is Condition.MAINTENANCE]
    assert wet[0].time - float(leaking[1].split(",")[0]) <= 30.0
    assert wet[0].cause == "leak past the piston"
    assert wet[-1].since == wet[0].time
    sizes = [look.leak.value for look in found["wet"] if np.isfinite(look.leak.value)]
    assert np.median(sizes) == pytest.approx(0.3, rel=0.1)
    assert {look.condition for look in found["dry"] if look.axis == "dry"} == {Condition.GOOD}
    assert Condition.NO_DATA in [look.condition for look in found["dry"] if look.axis == "wet"]
    table = read_table(tmp_path / "watch.csv")
    assert set(table["axis"]) == {"wet", "dry"}
    assert table["verdict"][table["axis"] == "wet"].iloc[-1] == "internal leak"
    assert json.loads(wet[0].line(protocol=False))["state"] == "maintenance required"
    assert wet[0].line(protocol=True).startswith('hydro_watch,axis=wet state="maintenance required",since=')


WIRING = {
    "position of the wrong sign": lambda rows: rows * [1, -1, 1, 1, 1, 1],
    "chambers exchanged": lambda rows: rows[:, [0, 1, 3, 2, 4, 5]],
    "valve of the wrong sign": lambda rows: rows * [1, 1, 1, 1, -1, -1],
    "pressures in MPa": lambda rows: rows * [1, 1, 0.1, 0.1, 1, 1],
    "position in cm": lambda rows: rows * [1, 0.1, 1, 1, 1, 1],
    "position in µm": lambda rows: rows * [1, 1000, 1, 1, 1, 1],
    "time in ms": lambda rows: rows * [1000, 1, 1, 1, 1, 1],
    "pressure a stands still": lambda rows: np.where(np.arange(6) == 2, 30.0, rows),
    "position stands still": lambda rows: np.where(np.arange(6) == 1, 1.0, rows),
    "every fifth row alone": lambda rows: rows[::5],
}


def test_a_size_below_zero_is_told_as_zero():
    fields = Look("lift", 4.0, Condition.GOOD, 4.0, "", Leak(0.01, -0.02, np.nan), 40.0).fields()
    assert (fields["value"], fields["low"], fields["high"]) == (0.01, 0.0, None)


def test_a_first_look_above_the_limit_has_another_reason_than_one_about_it(leaking, tmp_path):
    causes = set()
    for limit in (0.01, 0.3):
        usual = FLEET.usual._replace(limit=limit)
        look = next(FleetWatch(Fleet(usual), tmp_path / f"{limit}.csv").looks(leaking))
        assert look.condition is Condition.CHECK
        assert (look.leak.low > limit) == (limit == 0.01)
        causes.add(look.cause)
    assert len(causes) == 2


def test_a_sensor_that_stops_is_a_failure_also_when_all_rows_are_of_one_value(healthy, tmp_path):
    rows = cells(healthy)
    rows[1600:, 2] = rows[1600, 2]
    looks = list(fleet_in(tmp_path).looks(in_csv(healthy, rows)))
    begun = [look.condition for look in looks].index(Condition.FAILURE)
    assert looks[-1].time > looks[begun].time + KEPT
    assert {look.condition for look in looks[begun:]} == {Condition.FAILURE}


@pytest.mark.parametrize("fault", WIRING)
def test_a_fault_of_the_wiring_is_named_before_an_alarm(fault, healthy, tmp_path):
    looks = list(fleet_in(tmp_path).looks(in_csv(healthy, WIRING[fault](cells(healthy)[:3000]))))
    assert looks
    assert {look.condition for look in looks} <= {Condition.CHECK, Condition.FAILURE}
    assert all(look.cause for look in looks)


def test_an_impossible_temperature_of_the_oil_is_told_at_each_look(healthy, tmp_path):
    lines = [f"{healthy[0]},oil_temperature [°C]", *(f"{line},310" for line in healthy[1:1000])]
    (look,) = fleet_in(tmp_path).looks(lines)
    assert "oil_temperature" in look.cause
    assert np.isnan(look.temperature)


def test_rows_that_do_not_tell_the_leak_are_never_good(healthy, tmp_path):
    """Time and command alone; no pressures; the clock in another unit, or set back; a heading between the rows."""
    rows = cells(healthy)[:2400]
    alone = rows.copy()
    alone[:, 1:5] = np.nan
    slow = rows * [1e-6, 1, 1, 1, 1, 1]
    for given in (alone, np.where(np.isin(np.arange(6), (2, 3)), np.nan, rows), slow):
        looks = list(fleet_in(tmp_path).looks(in_csv(healthy, given)))
        assert looks
        assert Condition.GOOD not in {look.condition for look in looks}
    looks = list(fleet_in(tmp_path).looks(in_csv(healthy, np.concatenate([rows, rows[500:]]))))
    assert "the clock was set back" in {look.cause for look in looks}
    assert not list(fleet_in(tmp_path).looks([*healthy[:3], healthy[0], *healthy[3:6]]))
    (tmp_path / "watch.json").write_text('{"axis": {"condition": "fine"}}')
    with refused("memory of hydro watch: axis 'axis'"):
        list(fleet_in(tmp_path).looks(healthy[:3]))


def test_a_source_that_fails_ends_the_watch_with_one_line():
    def fill(put):
        put("first")
        raise UnicodeDecodeError("utf-8", b"\\xb0", 0, 1, "invalid")

    lines = lines_of(fill)
    assert next(lines) == "first"
    with refused("rows: cannot be read: "):
        next(lines)


def test_an_axis_alone_that_falls_silent_has_no_data(healthy, tmp_path, monkeypatch):
    clock = iter(np.arange(0.0, 1e6, 0.5))
    monkeypatch.setattr("hydro_rig.watching.stream.monotonic", lambda: next(clock))
    looks = list(fleet_in(tmp_path).looks([*healthy[:1000], *[None] * 60]))
    assert [look.condition for look in looks] == [Condition.GOOD, Condition.NO_DATA]
    assert json.loads((tmp_path / "watch.json").read_text())["axis"]["condition"] == "no data"


def test_a_restart_goes_on_where_it_was(leaking, tmp_path):
    first = list(fleet_in(tmp_path).looks(leaking[:5400]))
    assert first[-1].condition is Condition.MAINTENANCE
    second = next(fleet_in(tmp_path).looks([leaking[0], *leaking[5400:]]))
    assert (second.condition, second.since) == (Condition.MAINTENANCE, first[-1].since)
    table = read_table(tmp_path / "watch.csv")
    table.loc[table.index[-1], "repaired"] = "new seal"
    write_table(tmp_path / "watch.csv", table)
    third = next(fleet_in(tmp_path).looks([leaking[0], *leaking[5400:]]))
    assert third.condition is not Condition.MAINTENANCE  # a repair ends the alarm
    assert read_table(tmp_path / "watch.csv")["repaired"].tolist()[len(table) - 1] == "new seal"


def test_the_memory_of_another_rig_is_not_taken_up(leaking, tmp_path, capsys):
    first = list(fleet_in(tmp_path).looks(leaking[:5400]))
    assert first[-1].condition is Condition.MAINTENANCE
    other = task_config(TASK, plant={"load": {"mass": 2.0 * TASK.plant.load.mass}})
    second = next(FleetWatch(Fleet(FLEET.usual._replace(task=other)), tmp_path / "watch.csv").looks(leaking))
    assert (second.condition, second.since) != (Condition.MAINTENANCE, first[-1].since)
    assert "a second axis needs another --append" in capsys.readouterr().err


def test_a_kill_and_a_broken_pipe_leave_a_whole_table(leaking, tmp_path):
    """The process is killed right after it printed a look: table and memory are those of that look."""
    program = "from hydro_agents.commands.launcher import main; main()"
    run = [sys.executable, "-c", program, "watch", "--task", "default", "--append", str(tmp_path / "watch.csv")]
    process = subprocess.Popen(run, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    process.stdin.write("\n".join(leaking[:1200]) + "\n")
    process.stdin.flush()
    told = json.loads(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert json.loads((tmp_path / "watch.json").read_text())["axis"]["since"] == told["since"]
    assert len(read_table(tmp_path / "watch.csv")) == 1
    rows = "\n".join(leaking[:2600]) + "\n"
    with subprocess.Popen(
        run, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as piped:
        piped.stdout.close()  # the next program has gone
        _, told = piped.communicate(rows)
    assert len(told.splitlines()) == 1  # from which memory it goes on
    assert (tmp_path / "watch.json").exists()
    assert len(read_table(tmp_path / "watch.csv")) >= 1
