"""Reading a recording: columns, units, time stamps, and what is no recording."""

import numpy as np
import pytest
from recorded import recorded_file
from refusal import refused

from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.recordings.columns import read_map
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import cut, sampled
from hydro_rig.recordings.simulated import recording_csv

TIME = np.arange(5) * 0.005
SIGNALS = np.array([np.linspace(-0.1, 0.1, 5), np.linspace(1e6, 5e6, 5), np.full(5, 3e6), np.zeros(5), np.full(5, 0.5)])
PLAIN = recording_csv(TIME, SIGNALS, "hydro record")


def written(folder, text, name="a.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_record_keeps_every_step_of_the_sensors(tmp_path):
    done = recorded_file(tmp_path / "a.csv", duration=0.5)
    found = read_recording(tmp_path / "a.csv")
    assert done.rows == found.signals.shape[1] == 100
    step = 0.4 / (65536 * 8.0 / 20.0)
    places = (found.signals[0] + 0.2) / step
    assert np.abs(places - np.rint(places)).max() < 0.1


def test_columns_between_spaces_have_their_headings_in_a_comment(tmp_path):
    rows = [line.replace(",", "   ") for line in PLAIN.splitlines() if not line.startswith("#")]
    head = "#" + ",".join(PLAIN.splitlines()[1].split(","))
    found = read_recording(written(tmp_path, "\n".join(["# of a test bench", head, *("  " + row for row in rows[1:])])))
    np.testing.assert_allclose(found.signals, SIGNALS, rtol=1e-6)
    spaced = written(tmp_path, "\n".join(["time command position", *(" ".join(row.split()[:3]) for row in rows[1:])]))
    (tmp_path / "map.yaml").write_text(
        "time: time\nposition: {column: command, unit: mm}\ncommand: {column: 3, unit: bar}"
    )
    with refused("bar"):
        read_recording(spaced, read_map(tmp_path / "map.yaml"))


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", ";").replace(".", ","),
        PLAIN.replace(",", "\t"),
        "\n# more\n" + PLAIN,
        "\ufeff" + PLAIN,
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("time [s]", "time").replace("command [V]", "Voltage (V)"),
    ],
)
def test_other_writings_hold_the_same(tmp_path, text):
    np.testing.assert_allclose(read_recording(written(tmp_path, text)).signals, SIGNALS, rtol=1e-6)


def test_a_logger_writes_a_head_a_line_of_units_dates_and_decimal_commas_in_its_own_encoding(tmp_path):
    """As German measuring programs do, in Windows-1252."""
    names = "Zeit;Weg;Druck A;Druck B;Schieber;Stellgröße"
    head = ["Anlage;Gerüst 3", "Rate;200;Hz", "Kanäle;6", "", names, ";mm;bar;bar;%;V"]
    scale = np.array([1e3, 1e-5, 1e-5, 100.0, 10.0])[:, None]
    rows = [
        ";".join([f"01.03.2026 08:00:00,{round(1e3 * t):03d}", *(f"{value:.4f}".replace(".", ",") for value in row)])
        for t, row in zip(TIME, (scale * SIGNALS).T, strict=True)
    ]
    (tmp_path / "a.csv").write_bytes("\r\n".join([*head, *rows]).encode("cp1252"))
    signals = ("time", "position", "pressure_a", "pressure_b", "spool_position", "command")
    lines = [f"{signal}: {name}" for signal, name in zip(signals, names.split(";"), strict=True)]
    found = read_recording(tmp_path / "a.csv", read_map(written(tmp_path, "\n".join(lines), "map.yaml")))
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)
    np.testing.assert_allclose(found.signals, SIGNALS, rtol=1e-6)
    assert found.findings == []


def test_a_map_gives_columns_units_signs_and_offsets(tmp_path):
    rows = [
        f"2026-11-21T10:00:00.{5 * k:03d},{200 + 1e3 * x:.4f},{-u:.3f}" for k, (x, u) in enumerate(SIGNALS[[0, 4]].T)
    ]
    file = written(tmp_path, "\n".join(["When,Pos,Y", *rows]))
    columns = written(
        tmp_path,
        "time: When\nposition: {column: 2, unit: mm, offset: -200}\n"
        "command: {column: Y, unit: '-', gain: -1, rows_early: 1}",
        "map.yaml",
    )
    found = read_recording(file, read_map(columns))
    np.testing.assert_allclose(found.time, TIME)
    np.testing.assert_allclose(found.signals[0], SIGNALS[0], atol=1e-9)
    np.testing.assert_allclose(found.signals[4], [np.nan, *SIGNALS[4, :-1]])
    assert [finding.signal for finding in found.findings] == ["pressure_a", "pressure_b", "spool_position"]
    steady = written(tmp_path, "time: {column: When, equidistant: 5 ms}\ncommand: {column: Y, unit: '-'}", "even.yaml")
    file.write_text(file.read_text().replace(":00.010,", ":00.005,"))  # a stamp that came late
    np.testing.assert_allclose(read_recording(file, read_map(steady)).time, TIME)


JITTER = np.random.default_rng(0).uniform(-4e-3, 4e-3, 30_000)
STAMPS = {
    "whole seconds": (0.005, lambda t: np.floor(t + 0.3)),
    "late stamps": (0.005, lambda t: t + JITTER),
    "a clock of its own in tenths of a second": (1.0 / 204.8, lambda t: np.floor(10.0 * t) / 10.0),
    "five digits": (0.001, lambda t: np.where(t < 10.0, t, np.round(t, 2))),
    "the end of summer time": (None, lambda t: t - 3600.0 * (t > 60.0)),
    "lost rows": (None, lambda t: t + 0.005 * np.floor(t / 0.1)),
    "minutes": (None, lambda t: 60.0 * np.floor((t + 55.0) / 60.0)),
}
"""What the stamps of 30 000 rows tell of their distance (None: nothing), and the stamps, by name."""


@pytest.mark.parametrize("case", STAMPS)
def test_equidistant_rows_lie_as_far_apart_as_rounded_stamps_tell(tmp_path, case):
    distance, stamp = STAMPS[case]
    time = stamp((distance or 0.005) * np.arange(30_000))
    file = written(tmp_path, "t,u\n" + "".join(f"{t:.9g},{np.sin(k):.6g}\n" for k, t in enumerate(time)))
    columns = written(tmp_path, "time: {column: t, equidistant: true}\ncommand: {column: u, unit: '-'}", "map.yaml")
    if distance is None:
        with refused("do not tell the distance of the rows.*'equidistant: 5 ms'"):
            read_recording(file, read_map(columns))
        return
    recording = read_recording(file, read_map(columns))
    assert any("taken as equidistant" in finding.line() for finding in recording.findings)
    found = sampled(recording, TaskConfig())
    assert found.period == pytest.approx(distance, rel=0.01 * (distance == 1.0 / 204.8))


def test_text_becomes_a_finding_with_its_line(tmp_path):
    lines = PLAIN.split("\n")
    lines[3] = lines[3].replace(lines[3].split(",")[2], "Error")
    found = read_recording(written(tmp_path, "\n".join(lines)))
    assert np.isnan(found.signals[1, 1])
    assert "'Error' in line 4" in found.findings[0].line()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["holds no table"]),
        ("time [s],command [V]\n", ["no rows"]),
        ("time [s],command [V]\n0,1,2\n1,1,2\n", ["line 1 with the headings has 2 cells, the rows below it 3"]),
        (
            "of 2026\nNo.,time [s],command [V]\n0,1\n1,1\n2,1\n",
            ["line 2 with the headings has 3 cells, the rows below it 2"],
        ),
        ("time [s],command [V]\n0,1,2\n1,1\n2,1\n", ["more columns than the line of headings"]),
        ("a,b\n1,2\n", ["no column has the heading 'time'", "--map"]),
        (PLAIN.replace("[bar]", "[bars]", 1), ["pressure_a", "'bars'", "MPa"]),
        (PLAIN.replace(" [mm]", ""), ["position", "no unit"]),
        (PLAIN.replace("pressure_b", "position"), ["two columns", "'position'"]),
        ("time [s],command [V]\nx,1\ny,2\n0.1,2\n", ["time stamp"]),
    ],
)
def test_what_is_no_recording_is_told_in_one_line(tmp_path, text, parts):
    with pytest.raises(ConfigurationError) as error:
        read_recording(written(tmp_path, text))
    for part in parts:
        assert part in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("time: t", "command: is missing"),
        ("time: t\ncommand: {column: u, unit: bar}", "'bar': must be one of V"),
        ("time: t\ncommand: {column: absent, unit: V}", "no column has the heading 'absent'"),
        ("time: {column: t, equidistant: 5 mm}\ncommand: u", "time.equidistant = '5 mm': unit 'mm': must be one of s"),
        ("time: t\ncommand: {column: u, units: V}", "unknown key; did you mean unit?"),
        ("{time: t, command: u, pressure_a: p, pressure_b: p}", "pressure_b: column 'p' is already pressure_a"),
    ],
)
def test_a_wrong_map_is_told_in_one_line(tmp_path, text, part):
    file = written(tmp_path, "t,u\n0,1\n1,1\n2,1\n")
    with refused(part.replace("?", r"\?")):
        read_recording(file, read_map(written(tmp_path, text, "map.yaml")))


def test_a_file_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("hydro_rig.recordings.files.LARGEST_RECORDING", 100)
    with refused("larger than"):
        read_recording(written(tmp_path, PLAIN))


def test_pressures_of_the_supply_a_flow_and_a_temperature_may_stand_beside_the_signals(tmp_path):
    file = tmp_path / "axis.csv"
    headings = "time [s],command [V],supply_pressure [bar],flow [l/min],oil_temperature [°C],tank_pressure"
    rows = "\n".join(f"{0.005 * k},0.0,{70 + k},6,41,9" for k in range(10))
    file.write_text(f"{headings}\n{rows}\n", encoding="utf-8")
    found = read_recording(file)
    np.testing.assert_allclose(found.auxiliary["supply_pressure"], 1e5 * (70 + np.arange(10)))
    assert "tank_pressure" not in found.auxiliary  # a heading without a unit is another program's column
    np.testing.assert_allclose(found.auxiliary["flow"], 1e-4)
    np.testing.assert_allclose(found.auxiliary["oil_temperature"], 41.0)
    windows = cut(sampled(found, TaskConfig()), 5)
    assert set(windows.auxiliary) == {"supply_pressure", "flow", "oil_temperature"}
    np.testing.assert_allclose(windows.auxiliary_signal("flow"), np.full((2, 5), 1e-4))
    assert np.isnan(windows.auxiliary_signal("tank_pressure")).all()
    assert windows.part(np.array([1])).auxiliary_signal("supply_pressure")[0, 0] == pytest.approx(75e5)
    file.write_text("time [s],command [V],flow [furlong]\n0,0,1\n1,0,1\n2,0,1\n", encoding="utf-8")
    with refused(r"flow: .*furlong"):
        read_recording(file)


@pytest.mark.parametrize(
    ("readings", "counts"),
    [
        ([40.0] * 40, 40),
        ([45.0] * 39 + [-999.0], 39),  # a single spike
        ([0.0] * 40, 0),  # a dead input
        ([850.0] * 40, 0),  # a broken Pt100
        (np.linspace(72.0, 136.0, 40), 0),  # °F
        (np.linspace(295.0, 331.0, 40), 0),  # K
    ],
)
def test_temperatures_that_no_oil_has_count_as_not_measured(readings, counts, tmp_path):
    rows = [f"{0.005 * number},0,0.1,{reading}" for number, reading in enumerate(readings)]
    file = tmp_path / "axis.csv"
    file.write_text("\n".join(["time [s],position [mm],command [V],oil_temperature [°C]", *rows]), encoding="utf-8")
    found = read_recording(file)
    assert np.isfinite(found.auxiliary["oil_temperature"]).sum() == counts
    told = [one.share for one in found.findings if one.signal == "oil_temperature"]
    assert told == ([] if counts == 40 else [pytest.approx(1.0 - counts / 40)])
