"""Recordings as Parquet, MDF4, TDMS and MAT files: written by the libraries themselves, read as the CSV file is."""

import numpy as np
import pandas as pd
import pytest
import scipy.io
from optional_libraries import library
from refusal import refused

from hydro_env import ConfigurationError
from hydro_rig.recordings.columns import read_map
from hydro_rig.recordings.recording import read_recording

TIME = np.arange(200) * 0.005
POSITION, COMMAND = 40.0 * np.sin(3.0 * TIME), np.cos(5.0 * TIME)  # mm, V


def same_as_written(path, columns=None):
    found = read_recording(path, columns)
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)
    np.testing.assert_allclose(found.signals[0], 1e-3 * POSITION, rtol=1e-6)
    np.testing.assert_allclose(found.signals[4], 0.1 * COMMAND, rtol=1e-6)
    assert not [finding for finding in found.findings if finding.signal in ("time", "position", "command")]


def test_parquet(tmp_path):
    library("pyarrow")
    table = pd.DataFrame({"time [s]": TIME, "position [mm]": POSITION, "command [V]": COMMAND})
    table.to_parquet(tmp_path / "a.parquet")
    same_as_written(tmp_path / "a.parquet")


def write_mdf(path, channels):
    asammdf = library("asammdf")
    with asammdf.MDF(version="4.10") as file:
        for name, unit, stamps, values in channels:
            file.append([asammdf.Signal(values, stamps, name=name, unit=unit)])
        file.save(path)


def test_mdf4_with_one_time(tmp_path):
    write_mdf(tmp_path / "a.mf4", [("position", "mm", TIME, POSITION), ("command", "V", TIME, COMMAND)])
    same_as_written(tmp_path / "a.mf4")


def test_channels_as_fast_as_the_command_are_interpolated_and_told(tmp_path):
    own = np.arange(0.0025, 0.9, 0.005)  # it begins later, ends earlier, and has a gap
    own = own[(own < 0.4) | (own > 0.5)]
    values = 100.0 * own  # mm; a line, which linear interpolation meets exactly
    write_mdf(tmp_path / "a.mf4", [("position", "mm", own, values), ("command", "V", TIME, COMMAND)])
    found = read_recording(tmp_path / "a.mf4")
    np.testing.assert_allclose(found.time, TIME)
    np.testing.assert_allclose(found.signals[4], 0.1 * COMMAND, rtol=1e-6)
    position = found.signals[0]
    known = np.isfinite(position)
    np.testing.assert_allclose(position[known], 0.1 * TIME[known], rtol=1e-9)
    assert not known[own[0] > TIME].any()
    assert not known[own[-1] < TIME].any()
    assert not known[(TIME > 0.401) & (TIME < 0.499)].any()
    assert known[(TIME > 0.01) & (TIME < 0.39)].all()
    assert [f.signal for f in found.findings if "its own time stamps, one every 5 ms" in f.line()] == ["position"]


def test_readings_of_a_slower_channel_stand_where_their_stamps_are(tmp_path):
    write_mdf(
        tmp_path / "a.mf4",
        [("position", "mm", TIME[2::4] + 1e-4, POSITION[2::4]), ("command", "V", TIME, COMMAND)],
    )
    found = read_recording(tmp_path / "a.mf4")
    np.testing.assert_allclose(found.signals[0, 2::4], 1e-3 * POSITION[2::4], rtol=1e-6)
    assert np.isfinite(found.signals[0]).sum() == len(TIME[2::4])
    assert [f.signal for f in found.findings if "one every 20 ms; its readings stand" in f.line()] == ["position"]


def test_tdms_channels_begin_at_their_own_start(tmp_path):
    """Two tasks of one program: the second begins 10 ms later; a third channel has a start in 1904, which is none."""
    nptdms = library("nptdms")
    start = np.datetime64("2026-03-01T08:00:00.000000")
    channels = [
        nptdms.ChannelObject("daq", name, values, {"unit_string": unit, "wf_increment": 0.005, "wf_start_time": begin})
        for name, values, unit, begin in [
            ("position", POSITION[2:], "mm", start + np.timedelta64(10, "ms")),
            ("spool", COMMAND, "V", np.datetime64("1904-01-01T00:00:00.000000")),
            ("command", COMMAND, "V", start),
        ]
    ]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment(channels)
    found = read_recording(tmp_path / "a.tdms")
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)
    np.testing.assert_allclose(found.signals[0, 2:], 1e-3 * POSITION[2:], rtol=1e-6)
    assert np.isnan(found.signals[0, :2]).all()
    np.testing.assert_allclose(found.signals[3], 0.1 * COMMAND, rtol=1e-6)


def test_tdms_waveforms_and_columns(tmp_path):
    nptdms = library("nptdms")
    wave = {"wf_increment": 0.005, "wf_start_offset": 0.0}
    channels = [
        nptdms.ChannelObject("daq", "position", POSITION, {"unit_string": "mm", **wave}),
        nptdms.ChannelObject("daq", "command", COMMAND, {"unit_string": "V", **wave}),
    ]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment(channels)
    same_as_written(tmp_path / "a.tdms")
    plain = [("time", TIME, "s"), ("position", POSITION, "mm"), ("command", COMMAND, "V")]
    with nptdms.TdmsWriter(tmp_path / "b.tdms") as file:
        file.write_segment([nptdms.ChannelObject("g", name, v, {"unit_string": unit}) for name, v, unit in plain])
    same_as_written(tmp_path / "b.tdms")


MAP = "time: {column: t, unit: s}\nposition: {column: x, unit: mm}\ncommand: {column: u, unit: V}\n"


def test_mat_files_with_a_map(tmp_path):
    content = {"t": TIME[:, None], "x": POSITION[None], "u": COMMAND[:, None], "note": "text", "gain": 3.0}
    scipy.io.savemat(tmp_path / "a.mat", content)
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    same_as_written(tmp_path / "a.mat", read_map(tmp_path / "map.yaml"))


def test_mat_files_with_a_struct_per_channel_and_unequal_lengths(tmp_path):
    own = TIME[:-20:2]
    content = {
        "position": {"Time": own, "Data": 100.0 * own, "Unit": "mm"},
        "command": {"time": TIME, "signals": {"values": COMMAND, "dimensions": 1.0}, "unit": "V"},
        "note": "text",
        "other": np.arange(7.0),
    }
    scipy.io.savemat(tmp_path / "a.mat", content)
    found = read_recording(tmp_path / "a.mat")
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    np.testing.assert_allclose(found.signals[4], 0.1 * COMMAND, rtol=1e-9)
    known = np.isfinite(found.signals[0])
    np.testing.assert_allclose(found.signals[0, known], 0.1 * TIME[known], rtol=1e-9)
    assert known.sum() == len(own)


def test_vectors_of_unequal_length_are_told(tmp_path):
    content = {"t": TIME, "u": COMMAND, "x": np.arange(5.0)}
    scipy.io.savemat(tmp_path / "a.mat", content)
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    with refused("'x' has 5 values, that of the command has 200"):
        read_recording(tmp_path / "a.mat", read_map(tmp_path / "map.yaml"))


@pytest.mark.parametrize(
    ("kind", "name"), [("parquet", "pyarrow"), ("mf4", "asammdf"), ("tdms", "nptdms"), ("mat", "scipy.io")]
)
def test_a_damaged_file_is_told_in_one_line(tmp_path, kind, name):
    library(name)
    path = tmp_path / f"a.{kind}"
    version_7_3 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    for content in (b"no such format" * 20, version_7_3 + bytes(400)):
        path.write_bytes(content)
        with pytest.raises(ConfigurationError) as error:
            read_recording(path)
        assert str(error.value).startswith(f"{path}: ")
        assert "\n" not in str(error.value)
    assert kind != "mat" or "v7.3" in str(error.value)
    with refused("cannot be read"):
        read_recording(tmp_path / f"none.{kind}")


def test_an_absent_library_is_named_with_the_way_to_install_it(tmp_path, monkeypatch):
    def absent(name):
        raise ImportError(name)

    (tmp_path / "a.tdms").write_bytes(b"")
    monkeypatch.setattr("hydro_rig.recordings.files.importlib.import_module", absent)
    with refused(r"nptdms: pip install 'hydro_env\[recordings\]'"):
        read_recording(tmp_path / "a.tdms")
